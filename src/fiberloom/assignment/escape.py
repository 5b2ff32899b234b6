"""Can a positioner, alone, get from its goal to its folded place past what does not move?

Between an arm and the fiducials around it there are small pockets of places that are free but
cannot be left: about 0.5 % of the places of one positioner in twelve of SDSS-V. No planner can
serve them.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fiberloom.assignment.clearance import arm_lines, obstacle_gap_mm
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints

STEP_DEG = 3.0
"""Grid of the flood, and the sampling of folds."""
GUARD_MM = 0.05
"""A step of 3 deg passes nearer than its ends by 0.04 mm at most (as `clearance.dip_mm`)."""


@dataclass
class Escape:
    """Answers for one plane and its fixed bodies (K, 7); what was found is kept."""

    plane: FocalPlane
    bodies: Floats
    _turns: dict[int, bool] = field(default_factory=dict)
    _regions: dict[int, NDArray[np.int32]] = field(default_factory=dict)
    _folded_deg: Floats = field(init=False)

    def __post_init__(self) -> None:
        self._folded_deg = self.plane.park_deg

    def can_fold(self, positioner: Ints, goal_deg: Floats) -> Flags:
        """(C,) which of these free places (rows, goals) are connected to the folded place."""
        out = self.folds_straight(positioner, goal_deg)
        for row in np.unique(positioner[~out]).tolist():
            mine = np.flatnonzero((positioner == row) & ~out)
            out[mine] = self.flooded(row, goal_deg[mine])
        return out

    def folds_straight(self, positioner: Ints, goal_deg: Floats) -> Flags:
        """Is the way free on which beta folds the arm, then alpha turns it? Nearly always."""
        folded = self._folded_deg[positioner, 1:]
        span = np.abs(folded - goal_deg[:, 1:]).max(initial=0.0)
        steps = np.linspace(0.0, 1.0, 1 + max(1, int(np.ceil(span / STEP_DEG))))
        # the goal itself was tested before, with its own margin
        beta = goal_deg[:, 1:] + (folded - goal_deg[:, 1:]) * steps[1:]
        alpha = np.broadcast_to(goal_deg[:, :1], beta.shape)
        gap = self._gap_mm(positioner, alpha, beta)
        return (gap > GUARD_MM) & self._turns_folded(positioner)

    def flooded(self, row: int, goal_deg: Floats) -> Flags:
        """(C,) places of one positioner that a flood from the folded one reaches, on a grid. Where
        an offline neighbour lies across the folded place, the largest free region takes over."""
        if row not in self._regions:
            self._regions[row] = self._flood(row)
        region = self._regions[row]
        home = int(region[self._cells(self._folded_deg[[row]])][0])
        if home == 0:
            sizes = np.bincount(region.ravel(), minlength=2)
            home = 1 + int(sizes[1:].argmax())
        free: Flags = region[self._cells(goal_deg)] == home
        return free

    def _turns_folded(self, positioner: Ints) -> Flags:
        """Which positioners can turn alpha over its whole range with the arm folded?"""
        new = np.array([r for r in np.unique(positioner).tolist() if r not in self._turns], int)
        alpha = np.broadcast_to(self._axes()[0], (len(new), len(self._axes()[0])))
        beta = np.broadcast_to(self._folded_deg[new, 1:], alpha.shape)
        free = self._gap_mm(new, alpha, beta) > GUARD_MM
        self._turns.update(zip(new.tolist(), free.tolist(), strict=True))
        return np.array([self._turns[r] for r in positioner.tolist()], dtype=bool)

    def _flood(self, row: int) -> NDArray[np.int32]:
        """(A, B) of the grid: which free region it is in, from 1; 0 where something is in the way."""
        alpha, beta = np.meshgrid(*self._axes(), indexing="ij")
        rows = np.full(alpha.size, row)
        gap = self._gap_mm(rows, alpha.reshape(-1, 1), beta.reshape(-1, 1))
        return connected((gap > 0).reshape(alpha.shape))

    def _gap_mm(self, positioner: Ints, alpha_deg: Floats, beta_deg: Floats) -> Floats:
        """(C,) least gap to the bodies over the P poses (C, P) of each of C positioners."""
        rows = np.repeat(positioner, alpha_deg.shape[1])
        flat = arm_lines(self.plane, np.column_stack([alpha_deg.ravel(), beta_deg.ravel()]), rows)
        segments = flat.reshape(*alpha_deg.shape, *flat.shape[1:])
        return obstacle_gap_mm(self.plane, positioner, segments, self.bodies)

    def _axes(self) -> list[Floats]:
        limits = self.plane.limits_deg
        return [np.linspace(a, b, 1 + int(np.ceil((b - a) / STEP_DEG))) for a, b in limits]

    def _cells(self, places_deg: Floats) -> tuple[Ints, Ints]:
        alpha, beta = self._axes()
        return (
            np.abs(alpha - places_deg[:, :1]).argmin(axis=1),
            np.abs(beta - places_deg[:, 1:]).argmin(axis=1),
        )


def connected(free: Flags) -> NDArray[np.int32]:
    """(A, B) a number of its own, 1 or more, for all `free` (A, B) places that hang together; 0 elsewhere.

    Along the axes: places that touch at a corner do not.
    """
    place = np.arange(free.size).reshape(free.shape)
    along, across = free[1:] & free[:-1], free[:, 1:] & free[:, :-1]
    ends = np.concatenate([place[1:][along], place[:, 1:][across]])
    begins = np.concatenate([place[:-1][along], place[:, :-1][across]])
    steps = coo_array((np.ones(len(ends), dtype=bool), (begins, ends)), shape=(free.size, free.size))
    region: NDArray[np.int32] = connected_components(steps, directed=False)[1]
    return np.where(free, region.reshape(free.shape) + np.int32(1), np.int32(0))
