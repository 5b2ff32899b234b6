"""Where the camera sees the fibres."""

from fiberloom.metrology.camera import Camera, Measurement

__all__ = ["Camera", "Measurement"]
