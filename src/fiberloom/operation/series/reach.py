"""Targets that have gone out of reach: their fibres come as near as the arms let them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.assignment import Assignment
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Array, Floats, Ints
from fiberloom.units import wrap_deg

_INSIDE_MM = 1e-6
"""So far within the reach of the arms."""


@dataclass(frozen=True, eq=False)
class Reached:
    """Arrays over N positioners."""

    angles_deg: Floats
    """(N, 2) goals, alpha and beta."""
    short_mm: Floats
    """(N, 2) from the fibres there to the targets; 0 where they reach them."""


def to_the_end(plane: FocalPlane, assignment: Assignment, shift_mm: Floats, angles_deg: Floats) -> Reached:
    """Goals of which those that do not reach their targets go to the end of the reach of the arms.

    `plane`: of N positioners; `assignment`: the goals before; `shift_mm` (N, 2): of the targets since;
    `angles_deg` (N, 2): goals, as `steps.followed` gives them. One stays where even the end of the reach is
    not within the limits of its axes.
    """
    wanted_mm = _fibres_mm(plane, assignment, assignment.goal_deg) + shift_mm
    short = _short(wanted_mm - _fibres_mm(plane, assignment, angles_deg))
    angles_deg = angles_deg.copy()
    for row in np.flatnonzero(short.any(axis=1)).tolist():
        angles_deg[row] = _stretched(plane, str(assignment.fibre[row]), row, wanted_mm[row], angles_deg[row])
    return Reached(angles_deg, _short(wanted_mm - _fibres_mm(plane, assignment, angles_deg)))


def _short(left_mm: Floats) -> Floats:
    """What is more than rounding; 0 without a target."""
    far: Floats = np.where(np.hypot(*left_mm.T)[:, None] > 10.0 * _INSIDE_MM, left_mm, 0.0)
    return far


def _fibres_mm(plane: FocalPlane, assignment: Assignment, angles_deg: Floats) -> Floats:
    """(N, 2) the fibre of each positioner that goes to a target; NaN without one."""
    there_mm = np.full((plane.n, 2), np.nan)
    has: Array = assignment.target >= 0
    for fibre in np.unique(assignment.fibre[has]).tolist():
        rows = np.flatnonzero(has & (assignment.fibre == fibre))
        there_mm[rows] = plane.forward(angles_deg[rows, 0], angles_deg[rows, 1], fibre, index=rows)
    return there_mm


def _stretched(plane: FocalPlane, fibre: str, row: int, xy_mm: Floats, near_deg: Floats) -> Floats:
    """(2,) angles in deg at the end of the reach, towards a place (2,) in mm; `near_deg` without any."""
    rows: Ints = np.array([row])
    out_mm = xy_mm - plane.centres_mm[row]
    radius_mm, gap_mm = float(np.hypot(*out_mm)), plane.inverse(xy_mm, fibre, rows).gap_mm[0]
    for sign in (-1.0, 1.0):  # too far out, too far in
        share = 1.0 + sign * (gap_mm + _INSIDE_MM) / radius_mm
        found = plane.inverse(plane.centres_mm[row] + share * out_mm, fibre, rows, near_deg=near_deg[None])
        if found.reachable[0]:
            angles_deg = np.array([found.alpha_deg[0], found.beta_deg[0]])
            return near_deg + wrap_deg(angles_deg - near_deg)
    return near_deg
