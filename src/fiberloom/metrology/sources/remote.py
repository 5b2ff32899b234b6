"""What all cameras outside of this process have in common: one exposure, its deadline, its checks."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace

from fiberloom.metrology.images import CameraImage
from fiberloom.metrology.sources.deadline import Deadline
from fiberloom.metrology.sources.errors import CameraAborted, CameraError, ImageBroken
from fiberloom.metrology.sources.fresh import CLOCK_S, FreshnessCheck

MARGIN_S = 20.0
"""What an exposure may take beyond its own time, unless told: read-out and transfer."""


@dataclass(frozen=True)
class ExposureSettings:
    """How images are taken, whatever the camera."""

    exposure_s: float = 1.0
    deadline_s: float | None = None
    """From the request to the image; exposure and `MARGIN_S` when left out."""
    retries: int = 2
    """Further exposures where one gives no image that may be used."""
    clock_s: float = CLOCK_S
    """How far the camera's clock may be off ours."""
    size_px: tuple[int, int] | None = None
    """Width and height that the image must have."""
    gain_e_adu: float | None = None
    """Electrons per unit; the camera's own word when left out."""
    saturation_adu: float | None = None
    """Likewise."""


class RemoteSource(ABC):
    """Takes images with a camera that may be silent, refuse, or hand out what is no image.

    Implements `fiberloom.metrology.pipeline.ImageSource`. `expose` blocks; `abort` may be called from any
    thread. An image that is not usable is asked for again, `retries` times; `watchers` are told of each
    reason. Raises CameraError.
    """

    def __init__(self, name: str, settings: ExposureSettings) -> None:
        self.name, self.settings = name, settings
        allowed_s = settings.deadline_s
        self.deadline_s = settings.exposure_s + MARGIN_S if allowed_s is None else allowed_s
        self.watchers: list[Callable[[CameraError], None]] = []
        self._fresh = FreshnessCheck(name, settings.clock_s)
        self._running: Deadline | None = None
        self._busy = threading.Lock()

    def expose(self) -> CameraImage:
        """A new image, exposed from now on."""
        with self._busy:
            for _ in range(self.settings.retries):
                try:
                    return self._once()
                except CameraAborted:
                    raise
                except CameraError as error:
                    for watcher in self.watchers:
                        watcher(error)
            return self._once()

    def abort(self) -> None:
        """Makes a running `expose` raise CameraAborted; nothing where none is running."""
        if (running := self._running) is not None:
            running.abort()

    def close(self) -> None:
        """Gives up what is running and lets go of the camera."""
        self.abort()

    @abstractmethod
    def _take(self, deadline: Deadline) -> CameraImage:
        """One exposure from now on. Raises CameraError."""

    def _once(self) -> CameraImage:
        asked_utc_s = time.time()
        deadline = self._running = Deadline(self.name, self.deadline_s)
        try:
            image = self._take(deadline)
        finally:
            self._running = None
            deadline.close()
        self._check_size(image)
        self._fresh.check(image, asked_utc_s, time.time())
        return self._as_told(image)

    def _check_size(self, image: CameraImage) -> None:
        if image.pixels.ndim != 2:
            raise ImageBroken(f"{self.name}: {image.pixels.ndim} dimensions instead of 2: no plain image")
        height, width = image.pixels.shape
        if self.settings.size_px not in (None, (width, height)):
            wanted = "{} x {}".format(*self.settings.size_px or ())
            raise ImageBroken(
                f"{self.name}: an image of {width} x {height} px instead of {wanted}: another camera, or "
                "binning or a part of the frame is set"
            )

    def _as_told(self, image: CameraImage) -> CameraImage:
        gain, saturation = self.settings.gain_e_adu, self.settings.saturation_adu
        if gain is not None:
            image = replace(image, gain_e_adu=gain)
        return image if saturation is None else replace(image, saturation_adu=saturation)
