"""What a camera tells about the metrology fibres of a focal plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Measurement:
    """One image's worth of positions, a row for each positioner of the focal plane.

    `seen` is False where no spot belongs to the positioner; its x and y are then NaN, so that
    nobody takes them for a place.
    """

    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    seen: NDArray[np.bool_]
    time_s: float

    @property
    def xy_mm(self) -> NDArray[np.float64]:
        """Positions (N, 2)."""
        return np.column_stack([self.x_mm, self.y_mm])


class Camera(Protocol):
    """Looks at all fibres at once."""

    def measure(self) -> Measurement:
        """Takes an image now."""
        ...
