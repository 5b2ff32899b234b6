"""How far each positioner has to go, and what is wished of a choice."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.assignment.candidates import Candidates, WayRule
from fiberloom.assignment.choose import Wish, levels_of
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats, Ints

POWER = 4
"""Of a way in its cost: the longest ways count most, since the field waits for them."""
TURN_DEG = 360.0


def way_deg(
    start_deg: Floats, goal_deg: Floats, approach_deg: float | Floats, sides: tuple[float, float] = (1.0, 1.0)
) -> Floats:
    """(C,) deg: the longer way of the two axes from `start_deg` to `goal_deg` (C, 2), approach included.

    `approach_deg`: overshoot on both axes, one number or (C,); `sides`: from which each comes, 1 above, -1
    below. Over the speed this is the time below which no plan is (`fiberloom.planning.bound_s`).
    """
    over = np.broadcast_to(approach_deg, len(goal_deg))
    way: Floats = np.abs(goal_deg + over[:, None] * np.array(sides) - start_deg).max(axis=1) + over
    return way


def way_cost(way: Floats) -> Floats:
    """(C,) cost from 0 to about 1 of ways in deg (C,)."""
    cost: Floats = (way / TURN_DEG) ** POWER
    return cost


def checked_start(plane: FocalPlane, start_deg: ArrayLike) -> Floats:
    """(N, 2) deg where the positioners of the `plane` are; InputError for another shape, or no numbers."""
    start = np.asarray(start_deg, dtype=np.float64)
    if start.shape != (plane.n, 2) or not np.isfinite(start).all():
        raise InputError(f"start_deg: must be ({plane.n}, 2) finite numbers, and has shape {start.shape}")
    return start


@dataclass(frozen=True, eq=False)
class Preference:
    """By what a choice is made, beside the priorities."""

    strict: bool = False
    """No number of targets outweighs one of a higher priority."""
    start_deg: Floats | None = None
    """(N, 2) from where the positioners go; None: ways do not matter."""
    sides: tuple[float, float] = (1.0, 1.0)
    """From which side of their goals the axes come: 1 above, -1 below."""
    ways: WayRule | None = None
    """What the drive asks; None: nothing."""

    def wish(self, found: Candidates, approach_deg: float | Floats) -> Wish:
        """For the candidates `found`, with their approaches in deg."""
        if self.start_deg is None:
            return Wish(self.strict)
        way = way_deg(self.start_deg[found.positioner], found.goal_deg, approach_deg, self.sides)
        return Wish(self.strict, way_cost(way))

    def levels(self, priority: Floats) -> Ints:
        """(n,) levels of priorities (n,), dimensionless."""
        return levels_of(priority, Wish(self.strict).most_levels)
