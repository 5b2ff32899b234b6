"""What a bench has found of single units: by how much an arm is off the place that its steps say.

The mechanical zero is where an arm stands when its datum switch has closed. A table says what the gear adds
over the range, for either direction of the last motion: the play is in it too.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fiberloom.drive.steppers.found_arms import FoundArms
from fiberloom.drive.steppers.steps import AxisSteps
from fiberloom.typing import Floats, Ints

ROUNDS = 3
"""Of the inversion: errors change by less than 0.05 deg a deg."""


@dataclass(frozen=True, eq=False)
class KnownUnits:
    """Errors of N units, deg: true angle less the nominal one."""

    steps: AxisSteps
    knots_deg: Floats
    """(2, K) nominal angles of alpha and beta, equally spaced; one knot: the same everywhere."""
    error_deg: Floats
    """(N, 2, 2, K) by axis and by direction of the last motion: angle rising, falling."""
    why: dict[int, str] = field(default_factory=dict)
    """Units that cannot be used, by row: what the bench has found."""
    arms: FoundArms | None = None
    """As the bench has found them; None: as in the layout. All angles here are those of the layout's arms."""

    @classmethod
    def nominal(cls, steps: AxisSteps, n: int) -> KnownUnits:
        """Nothing is known: no errors of `n` units that go by `steps`."""
        return cls(steps, steps.home_deg[:, None], np.zeros((n, 2, 2, 1)))

    def of_unit(self, row: int) -> KnownUnits:
        """Of one unit, for any number of places of it."""
        arms = None if self.arms is None else self.arms.of_unit(row)
        return KnownUnits(self.steps, self.knots_deg, self.error_deg[row : row + 1], arms=arms)

    def true_deg(self, counts: Ints | Floats, rising: Floats) -> Floats:
        """(N, 2) angles in deg of the arms after `counts` (N, 2), that came `rising` (N, 2) 1 or -1."""
        nominal = self.steps.angles_deg(counts)
        angles = nominal + self._error_deg(nominal, rising)
        return angles if self.arms is None else self.arms.layout_deg(angles)

    def counts(self, angles_deg: Floats, rising: Floats) -> Ints:
        """(N, 2) counts that bring arms nearest to `angles_deg` (N, 2), coming `rising` (N, 2) 1 or -1."""
        wanted = np.array(angles_deg, dtype=np.float64)
        wanted = wanted if self.arms is None else self.arms.arms_deg(wanted)
        nominal = wanted
        for _ in range(ROUNDS):
            nominal = wanted - self._error_deg(nominal, rising)
        return self.steps.of_angles(nominal)

    def counts_on_way(self, angles_deg: Floats, goal_deg: Floats, rising: Floats) -> Ints:
        """As `counts`, on a way that ends at `goal_deg` (N, 2) or (1, 2).

        An axis that is at its goal is aimed for the arm as it will stand at the end: found arms need other
        angles of both axes, and it would turn again while the other one moves.
        """
        there = np.isclose(angles_deg, goal_deg, rtol=0.0, atol=1e-9)
        end = self.counts(np.broadcast_to(goal_deg, angles_deg.shape), rising)
        return np.where(there, end, self.counts(angles_deg, rising))

    def _error_deg(self, nominal_deg: Floats, rising: Floats) -> Floats:
        unit, axis = np.indices(nominal_deg.shape)
        unit = np.minimum(unit, len(self.error_deg) - 1)
        own = self.error_deg[unit, axis, np.where(rising < 0.0, 1, 0)]
        knots = self.knots_deg.shape[1]
        if knots == 1:
            return np.asarray(own[..., 0])
        low, high = self.knots_deg[:, 0], self.knots_deg[:, -1]
        at = np.clip((nominal_deg - low) / (high - low), 0.0, 1.0) * (knots - 1)
        k = np.minimum(at.astype(np.int64), knots - 2)
        share = at - k
        first, second = (np.take_along_axis(own, (k + s)[..., None], axis=2)[..., 0] for s in (0, 1))
        out: Floats = (1.0 - share) * first + share * second
        return out
