"""Can a positioner, alone, get from its goal to its folded place past what does not move?

Between an arm and the fiducials around it there are small pockets of places that are free but
cannot be left: about 0.5 % of the places of one positioner in twelve of SDSS-V. No planner can
serve them.
"""

import numpy as np
from scipy.ndimage import label

from ..instruments import FocalPlane
from .clearance import Bools, Floats, Ints, obstacle_gap_mm

STEP_DEG = 3.0
"""Grid of the flood, and the sampling of folds."""
GUARD_MM = 0.05
"""A step of 3 deg passes nearer than its ends by 0.04 mm at most (as `clearance.dip_mm`)."""


def can_fold(plane: FocalPlane, positioner: Ints, goal_deg: Floats, bodies: Floats) -> Bools:
    """(C,) which of these places (rows, goals) are connected to the folded place."""
    out = _folds_straight(plane, positioner, goal_deg, bodies)
    for row in np.unique(positioner[~out]):
        mine = np.flatnonzero((positioner == row) & ~out)
        out[mine] = _flood(plane, int(row), goal_deg[mine], bodies)
    return out


def _folds_straight(plane: FocalPlane, positioner: Ints, goal_deg: Floats, bodies: Floats) -> Bools:
    """Is the way free on which beta folds the arm, then alpha turns it? Enough for nearly all."""
    folded = plane.instrument.positioner.park_deg[1]
    span = np.abs(folded - goal_deg[:, 1]).max(initial=0.0)
    steps = np.linspace(0.0, 1.0, 1 + max(1, int(np.ceil(span / STEP_DEG))))
    beta = goal_deg[:, 1:] + (folded - goal_deg[:, 1:]) * steps
    segments = _poses(plane, positioner, np.broadcast_to(goal_deg[:, :1], beta.shape), beta)
    # the goal itself was tested before, with its own margin
    folds = obstacle_gap_mm(plane, positioner, segments[:, 1:], bodies) > GUARD_MM
    rows, where = np.unique(positioner, return_inverse=True)
    return folds & _turns_folded(plane, rows, bodies)[where]


def _turns_folded(plane: FocalPlane, rows: Ints, bodies: Floats) -> Bools:
    """(R,) which of these positioners can turn alpha over its whole range with the arm folded?"""
    alpha = _grid(*plane.limits_deg[0])
    shape = (len(rows), len(alpha))
    beta = np.full(shape, plane.instrument.positioner.park_deg[1])
    segments = _poses(plane, rows, np.broadcast_to(alpha, shape), beta)
    return obstacle_gap_mm(plane, rows, segments, bodies) > GUARD_MM


def _poses(plane: FocalPlane, positioner: Ints, alpha_deg: Floats, beta_deg: Floats) -> Floats:
    """(C, P, 4) centre lines of C positioners in P poses each."""
    rows = np.repeat(positioner, alpha_deg.shape[1])
    flat = plane.beta_segments(alpha_deg.ravel(), beta_deg.ravel(), index=rows)
    return flat.reshape(*alpha_deg.shape, 4)


def _flood(plane: FocalPlane, row: int, goal_deg: Floats, bodies: Floats) -> Bools:
    """Flood the free places of one positioner from the folded one, on a grid."""
    axes = [_grid(low, high) for low, high in plane.limits_deg]
    alpha, beta = np.meshgrid(*axes, indexing="ij")
    flat = np.full(alpha.size, row)
    segments = _poses(plane, flat, alpha.reshape(-1, 1), beta.reshape(-1, 1))
    free = (obstacle_gap_mm(plane, flat, segments, bodies) > 0).reshape(alpha.shape)
    region, _ = label(free)
    home = region[_cell(axes, np.array([plane.instrument.positioner.park_deg]))]
    return (region[_cell(axes, goal_deg)] == home) & (home != 0)


def _grid(low: float, high: float) -> Floats:
    return np.linspace(low, high, 1 + int(np.ceil((high - low) / STEP_DEG)))


def _cell(axes: list[Floats], places_deg: Floats) -> tuple[Ints, ...]:
    return tuple(
        np.abs(axis - place[:, None]).argmin(axis=1)
        for axis, place in zip(axes, places_deg.T, strict=True)
    )
