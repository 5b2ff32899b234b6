"""Is this the image that was asked for? The one place where that is decided.

An image is fresh when its exposure began after the request. The stamp is of the camera's clock, the request
of ours: an offset up to `clock_s` is tolerated. So an exposure that began up to `clock_s` before the
request passes this test; where the clocks agree better, set a smaller one. Whatever the stamps say, an
exposure with the same beginning, or with the same pixels, as the one before it is not a new one.
"""

from __future__ import annotations

import zlib

import numpy as np

from fiberloom.metrology.images import CameraImage, utc_text
from fiberloom.metrology.sources.errors import ImageStale

CLOCK_S = 2.0
"""How far a camera's clock may be off unless told."""
STAMP_S = 1e-3
"""A stamp is cut off at the millisecond (`utc_text`): it may be so much earlier than the exposure was."""


def began_too_early(image: CameraImage, asked_utc_s: float, clock_s: float = CLOCK_S) -> bool:
    """Did the exposure begin before it was asked for at `asked_utc_s`, UTC in s, by what is tolerated?"""
    return image.begun_utc_s is not None and image.begun_utc_s < asked_utc_s - clock_s - STAMP_S


class FreshnessCheck:
    """Of one `camera`, image after image; its clock may be off by `clock_s`."""

    def __init__(self, camera: str, clock_s: float = CLOCK_S) -> None:
        self.camera, self.clock_s = camera, clock_s
        self._digest: tuple[int, ...] | None = None
        self._begun_utc_s: float | None = None

    def check(self, image: CameraImage, asked_utc_s: float, now_utc_s: float) -> None:
        """Raises ImageStale unless the image was exposed after `asked_utc_s`; `now_utc_s`: when it came.

        Times are UTC seconds since 1970.
        """
        begun = image.begun_utc_s
        if begun is not None:
            self._check_stamp(image, begun, asked_utc_s, now_utc_s)
        digest = _digest(image)
        if digest is not None and digest == self._digest:
            raise ImageStale(
                f"{self.camera}: the same image again, pixel by pixel; its program hands out an old one: "
                "restart it, or look at its disk"
            )
        self._digest, self._begun_utc_s = digest, begun

    def _check_stamp(self, image: CameraImage, begun: float, asked: float, now: float) -> None:
        if began_too_early(image, asked, self.clock_s):
            raise ImageStale(
                f"{self.camera}: the exposure began {asked - begun:.1f} s before it was asked for "
                f"({utc_text(begun)}); an old image, or clocks that differ: set them, or give clock=SECONDS"
            )
        if begun > now + self.clock_s:
            raise ImageStale(
                f"{self.camera}: the exposure began {begun - now:.1f} s in the future ({utc_text(begun)}); "
                "set the camera's clock, or give clock=SECONDS"
            )
        if begun == self._begun_utc_s:
            raise ImageStale(
                f"{self.camera}: the exposure of {utc_text(begun)} again; its program took no new one"
            )


def _digest(image: CameraImage) -> tuple[int, ...] | None:
    """Of the pixels; None where all are alike: that is no old image but a dark or saturated one."""
    pixels = np.ascontiguousarray(image.pixels)
    if not pixels.size or (pixels == pixels.flat[0]).all():
        return None
    return (*pixels.shape, zlib.crc32(pixels.data))
