"""Cut-outs of an image around every metrology fibre, to be looked at: small, where the image is not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.metrology.pipeline import Reduction
from fiberloom.metrology.transform import FieldTransform
from fiberloom.typing import Array, Floats

HALF_PX = 16
"""Of the side of a cut-out, without its middle."""


@dataclass(frozen=True, eq=False)
class Stamps:
    """Cut-outs of N positioners."""

    pixels: Array
    """(N, s, s) ADU; 0 beyond the edge of the image, and where it is not known where to look."""
    corner_px: Floats
    """(N, 2) x, y of the middle of the first pixel of each; NaN: not known where to look."""
    spot_px: Floats
    """(N, 2) centroids in the image; NaN: not seen."""
    transform: FieldTransform
    """Pixels to focal plane."""
    time_s: float
    """Of the image, as the camera has it."""

    @classmethod
    def of(cls, reduction: Reduction, half_px: int = HALF_PX) -> Stamps:
        """Of the image that was reduced: around each spot, else around the place where one was expected.

        `reduction`: of the image; `half_px`: cut-outs have 2 x `half_px` + 1 pixels a side.
        """
        n = len(reduction.xy_mm)
        spot_px = np.full((n, 2), np.nan)
        spot_px[reduction.seen] = reduction.spots.xy_px[reduction.spot_of_match[reduction.seen]]
        expected = np.isfinite(reduction.expected_mm).all(axis=1) & ~reduction.seen
        around = spot_px.copy()
        if expected.any():
            around[expected] = reduction.transform.to_px(reduction.expected_mm[expected])
        side = 2 * half_px + 1
        pixels = np.zeros((n, side, side), dtype=reduction.image.pixels.dtype.newbyteorder("="))
        corner = np.floor(around + 0.5) - half_px
        for row in np.flatnonzero(np.isfinite(corner).all(axis=1)):
            _cut(reduction.image.pixels, corner[row].astype(int), pixels[row])
        return cls(pixels, corner, spot_px, reduction.transform, reduction.image.time_s)

    def within(self, row: int, place_mm: Floats) -> tuple[float, float]:
        """Column and row in the cut-out of the positioner in `row`, px, of a place (2,) in mm."""
        x, y = self.transform.to_px(np.asarray(place_mm, dtype=float)[None])[0] - self.corner_px[row]
        return float(x), float(y)

    def spot_within(self, row: int) -> tuple[float, float]:
        """Column and row in its cut-out, px, of the centroid of the positioner in `row`; NaN: not seen."""
        x, y = self.spot_px[row] - self.corner_px[row]
        return float(x), float(y)


def _cut(image: Array, corner: Array, into: Array) -> None:
    """Copies what lies within the image."""
    side = len(into)
    (x0, y0), (height, width) = corner, image.shape
    left, top, right, low = max(x0, 0), max(y0, 0), min(x0 + side, width), min(y0 + side, height)
    if left < right and top < low:
        into[top - y0 : low - y0, left - x0 : right - x0] = image[top:low, left:right]
