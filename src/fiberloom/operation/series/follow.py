"""Goals of fibres whose targets have gone elsewhere: where they reach them, else as near as they come."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.assignment import Assignment
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.arms import Inverse
from fiberloom.typing import Floats, Ints
from fiberloom.units import wrap_deg

_INSIDE_MM = 1e-6
"""So far within the reach of the arms."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Arrays over N positioners."""

    angles_deg: Floats
    """(N, 2) goals, alpha and beta."""
    short_mm: Floats
    """(N, 2) from the fibres there to the targets; 0 where they reach them."""


def followed(plane: FocalPlane, assignment: Assignment, shift_mm: Floats) -> Followed:
    """Goals whose fibres are shifted by (N, 2) mm.

    `plane`: of N positioners; `assignment`: the goals before. One that does not reach its target stops at the
    end of its reach, and stays where even that is not within the limits of its axes.
    """
    goal_deg, short_mm = assignment.goal_deg.copy(), np.zeros((plane.n, 2))
    for fibre in np.unique(assignment.fibre[assignment.target >= 0]).tolist():
        rows = np.flatnonzero((assignment.target >= 0) & (assignment.fibre == fibre))
        before_deg = goal_deg[rows]
        here_mm = plane.forward(before_deg[:, 0], before_deg[:, 1], fibre, index=rows)
        found = _nearest(plane, fibre, rows, here_mm + shift_mm[rows], before_deg)
        turned_deg = wrap_deg(np.column_stack([found.alpha_deg, found.beta_deg]) - before_deg)
        goal_deg[rows] += np.where(found.reachable[:, None], turned_deg, 0.0)
        there_mm = plane.forward(goal_deg[rows, 0], goal_deg[rows, 1], fibre, index=rows)
        left_mm = here_mm + shift_mm[rows] - there_mm
        short_mm[rows] = np.where(np.hypot(*left_mm.T)[:, None] > _INSIDE_MM, left_mm, 0.0)
    return Followed(goal_deg, short_mm)


def _nearest(plane: FocalPlane, fibre: str, rows: Ints, xy_mm: Floats, near_deg: Floats) -> Inverse:
    """Of places (n, 2) in mm, or of those at the end of the reach of the arms."""
    found = plane.inverse(xy_mm, fibre, rows, near_deg=near_deg)
    out_mm = xy_mm - plane.centres_mm[rows]
    radius_mm = np.hypot(*out_mm.T)
    for sign in (-1.0, 1.0):  # too far out, too far in
        pulled_mm = radius_mm + sign * (found.gap_mm + _INSIDE_MM)
        ends_mm = plane.centres_mm[rows] + out_mm * (pulled_mm / radius_mm)[:, None]
        at_end = plane.inverse(
            np.where(found.reachable[:, None], xy_mm, ends_mm), fibre, rows, near_deg=near_deg
        )
        found = _first(found, at_end)
    return found


def _first(found: Inverse, other: Inverse) -> Inverse:
    """The first, and the other where only that is reachable."""
    return Inverse(
        np.where(found.reachable, found.alpha_deg, other.alpha_deg),
        np.where(found.reachable, found.beta_deg, other.beta_deg),
        found.reachable | other.reachable,
        found.gap_mm,
    )
