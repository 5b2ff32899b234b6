"""The inverse of a map of the plane that has none in closed form."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fiberloom.typing import Floats

_STEPS = 8
_STEP = 1e-6
"""Of the derivative, relative to the size of the goal."""


def inverse(forward: Callable[[Floats], Floats], goal: Floats, start: Floats) -> Floats:
    """Points (n, 2) that `forward` maps to `goal` (n, 2, mm), by Newton from `start` (n, 2, ratios).

    The derivative is taken once, at the start: optics bend a field by parts in a hundred, so each step leaves
    a hundredth of the error.
    """
    size = _STEP * max(float(np.abs(start).max(initial=0.0)), 1e-3)
    here = forward(start)
    slope = np.stack([(forward(start + size * axis) - here) / size for axis in np.eye(2)], axis=-1)
    back = np.linalg.inv(slope)
    point = start
    for _ in range(_STEPS):
        point = point + np.einsum("nij,nj->ni", back, goal - forward(point))
    return point
