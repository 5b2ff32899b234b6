"""What a camera tells about the metrology fibres of a focal plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fiberloom.typing import Flags, Floats


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

    @property
    def xy_mm(self) -> Floats:
        """Positions (N, 2)."""
        return np.column_stack([self.x_mm, self.y_mm])


class Camera(Protocol):
    """Looks at all fibres at once."""

    def measure(self, expected_mm: Floats | None = None) -> Measurement:
        """Takes an image now. `expected_mm` (N, 2): where each metrology fibre should be, NaN where
        it is not known; a camera with images needs it to tell the spots apart."""
        ...
