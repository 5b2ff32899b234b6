"""What a camera tells about the metrology fibres of a focal plane, in one image or in several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fiberloom.typing import Flags, Floats
from fiberloom.units import UM_PER_MM

FAR = 6.0
"""Times the scatter: a place in one image that is farther from the median of three and more is none, where
most of the others agree."""
OTHER_MM = 0.1
"""[A] Farther than that from the median is another light, whatever the others say: air moves fibres less."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """One image's worth of positions, a row for each positioner of the focal plane.

    `seen` is False where no spot belongs to the positioner for certain; its x and y are then NaN,
    so that they are never taken for a place.
    """

    x_mm: Floats
    y_mm: Floats
    seen: Flags
    time_s: float
    covariance_mm2: Floats | None = None
    """(N, 2, 2) of the positions, where the camera knows it."""
    ambiguous: Flags | None = None
    """(N,) not seen because its spot cannot be told from others; False: dark."""

    loose_mm: Floats | None = None
    """(n, 2) spots that belong to no positioner for certain; None: the camera takes no images."""
    noise_mm2: Floats | None = None
    """(N, 2, 2) by which positions differ from image to image, where the camera knows it: a part of the
    covariance. The rest is the same in every image, and no average takes it away."""
    images: int = 1
    """Of which it is the mean."""

    @property
    def xy_mm(self) -> Floats:
        """Positions (N, 2)."""
        return np.column_stack([self.x_mm, self.y_mm])


@dataclass(frozen=True)
class SeveralImages:
    """Images of the same fibres, which did not move in between."""

    images: Sequence[Measurement]
    """In the order of time, one or more."""

    def mean(self) -> Measurement:
        """One measurement for all. With two and more their scatter tells the noise, whatever the camera says.

        A fibre counts as seen where half of the images show it. Its noise is that of the mean: as the camera
        tells it, or else alike for all, times by how much the images scatter more or less than that.
        """
        if len(self.images) == 1:
            return self.images[0]
        last, xy_mm = self.images[-1], self._believed_mm()
        count = np.isfinite(xy_mm[..., 0]).sum(axis=0)
        seen = 2 * count >= len(self.images)
        seen &= count > 0
        mean_mm = np.where(seen[:, None], np.nansum(xy_mm, axis=0) / np.maximum(count, 1)[:, None], np.nan)
        told, covariance = self._told_mm2(), self._mean_of([image.covariance_mm2 for image in self.images])
        factor = self._factor(xy_mm, told)
        noise = None if np.isnan(factor) else told * factor / np.maximum(count, 1)[:, None, None]
        if covariance is not None and noise is not None and last.noise_mm2 is not None:
            covariance = covariance - told + noise  # what is the same in every image stays
        unclear = [image.ambiguous for image in self.images if image.ambiguous is not None]
        return Measurement(
            mean_mm[:, 0], mean_mm[:, 1], seen, last.time_s, covariance,
            ~seen & np.any(unclear, axis=0) if unclear else None, last.loose_mm, noise,
            len(self.images),
        )  # fmt: skip

    def noise_um(self) -> float:
        """2-D rms of a fibre in one image, by their scatter; NaN with one image or nothing seen twice."""
        if len(self.images) < 2:
            return float("nan")
        unit = np.broadcast_to(0.5 * np.eye(2), (len(self.images[0].seen), 2, 2))
        return UM_PER_MM * float(np.sqrt(self._factor(self._believed_mm(), unit)))

    def _believed_mm(self) -> Floats:
        """(images, N, 2); NaN where not seen, or far from where the others see it: another light.

        Air moves the fibres of a region alike, and in each image otherwise: there no two images agree, and
        none of them is wrong.
        """
        xy_mm = np.stack([image.xy_mm for image in self.images])
        if len(xy_mm) < 3:
            return xy_mm
        # a fibre that no image shows has no median
        shown = np.asarray(np.isfinite(xy_mm[..., 0]).any(axis=0))
        middle = np.nanmedian(np.where(shown[:, None], xy_mm, 0.0), axis=0)
        off_mm: Floats = np.hypot(*np.moveaxis(xy_mm - middle, -1, 0))
        usual_mm = np.nanmedian(off_mm[:, shown]) if shown.any() else np.inf
        far = off_mm > FAR * usual_mm
        agree = 2 * (np.isfinite(off_mm) & ~far).sum(axis=0) >= len(xy_mm)
        return np.where((far & (agree | (off_mm > OTHER_MM)))[..., None], np.nan, xy_mm)

    def _told_mm2(self) -> Floats:
        """(N, 2, 2) noise of one image as the camera tells it; of rms 1 mm for all where it tells none."""
        told = self._mean_of([image.noise_mm2 for image in self.images])
        if told is None:
            return np.broadcast_to(0.5 * np.eye(2), (len(self.images[0].seen), 2, 2))
        return told

    @staticmethod
    def _mean_of(values: Sequence[Floats | None]) -> Floats | None:
        """(N, 2, 2) over those that have one; NaN where none has."""
        known = [value for value in values if value is not None]
        if len(known) < len(values):
            return None
        count = np.isfinite(known).sum(axis=0)
        total = np.nansum(known, axis=0)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    def _factor(self, xy_mm: Floats, told_mm2: Floats) -> float:
        """By how much the variance is larger than told, of the median fibre; NaN: nothing seen twice."""
        count = np.isfinite(xy_mm[..., 0]).sum(axis=0)
        rows = (count > 1) & np.isfinite(told_mm2).all(axis=(1, 2))
        if not rows.any():
            return float("nan")
        off_mm = np.nan_to_num(xy_mm[:, rows] - np.nanmean(xy_mm[:, rows], axis=0))
        square = np.einsum("kni,nij,knj->n", off_mm, np.linalg.inv(told_mm2[rows]), off_mm)
        freedom = 2.0 * (count[rows] - 1)
        # the median of a chi square (Wilson and Hilferty 1931)
        return float(np.median(square / (freedom * (1.0 - 2.0 / (9.0 * freedom)) ** 3)))


class Camera(Protocol):
    """Looks at all fibres at once."""

    def measure(self, expected_mm: Floats | None = None) -> Measurement:
        """Takes an image now. `expected_mm` (N, 2): where each metrology fibre should be, NaN where
        it is not known; a camera with images needs it to tell the spots apart."""
        ...


class NoCamera:
    """What an instrument without a camera is observed with: nothing is seen. Implements `Camera`."""

    def __init__(self, n: int) -> None:
        """`n` positioners."""
        self._n = n

    def measure(self, expected_mm: Floats | None = None) -> Measurement:
        """No fibre is seen, wherever it is expected."""
        nothing = np.full(self._n, np.nan)
        return Measurement(nothing, nothing, np.zeros(self._n, dtype=bool), 0.0)
