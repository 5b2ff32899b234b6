"""What goes wrong with a camera. Each message names the camera, what happened and what to do."""


class CameraError(RuntimeError):
    """No image came that may be used."""


class CameraSilent(CameraError):
    """No connection, or no answer before the deadline."""


class CameraRefused(CameraError):
    """The camera answered with an error, or with something that is no answer."""


class CameraAborted(CameraError):
    """The exposure was given up because `abort` was called."""


class ImageBroken(CameraError):
    """An image that is cut short, of another size than expected, or no image at all."""


class ImageStale(CameraError):
    """An image whose exposure began before it was asked for, or that has been seen before."""


class CameraGone(CameraError):
    """In the middle of a command no image came, however often it was asked for."""
