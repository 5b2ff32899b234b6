"""Where arms are: by the place of a fibre where the angles are known roughly; folded where nothing is known."""

from __future__ import annotations

import numpy as np

from fiberloom.assignment.clearance import obstacle_gap_mm, obstacles, sweep
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.arms import CENTRE
from fiberloom.typing import Floats, Ints

ROOM_MM = 0.4
"""[D] Of a folded arm, to what does not move: 1.5 sigma of a map that nothing has taught are 0.15 mm, the play of
theta 0.2 mm."""
_TURNS_DEG = np.array([turn * side for turn in range(10, 190, 10) for side in (1, -1)], dtype=np.float64)


def angles_near(plane: FocalPlane, xy_mm: Floats, near_deg: Floats) -> Floats:
    """(N, 2) angles in deg that put fibres at `xy_mm` (N, 2), the solution nearest to `near_deg` (N, 2).

    Of a place out of reach: the arm stretched or folded towards it. NaN where the place is.
    """
    arms, (a, b) = plane.arms, (plane.l_alpha_mm, plane.l_beta_mm)
    z = (xy_mm - arms[:, CENTRE]) @ np.array([1.0, 1.0j])
    cosine = np.clip((np.abs(z) ** 2 - a**2 - b**2) / (2.0 * a * b), -1.0, 1.0)
    found = []
    for elbow in (np.arccos(cosine), -np.arccos(cosine)):
        alpha = np.angle(z) - np.angle(a + b * np.exp(1j * elbow)) - plane.alpha_off_rad
        beta = elbow - plane.beta_off_rad - plane.metrology_phi_rad
        angles = np.rad2deg(np.column_stack([alpha, beta]))
        found.append(angles + 360.0 * np.rint((near_deg - angles) / 360.0))
    far = [np.abs(angles - near_deg).sum(axis=1) for angles in found]
    return np.asarray(np.where((far[0] <= far[1])[:, None], *found), dtype=np.float64)


def folded_deg(plane: FocalPlane) -> Floats:
    """(N, 2) deg where units of a `plane` are taken to be before anything is known: folded.

    Theta is at 0, and where the folded arm would be nearer than `ROOM_MM` to what does not move, turned away
    from it by as little as leaves that room: no arm can be inside of an edge.
    """
    out, bodies = plane.park_deg, obstacles(plane, 0.0)
    able = np.flatnonzero(~plane.offline)
    gap = _gap_mm(plane, able, out[able], bodies)
    rows, best = able[gap < ROOM_MM], gap[gap < ROOM_MM]
    first = out[rows].copy()
    for turn in _TURNS_DEG:
        tried = first + [turn, 0.0]
        low, high = plane.limits_of(rows)[:, 0].T
        found = _gap_mm(plane, rows, tried, bodies)
        better = (best < ROOM_MM) & (found > best) & (tried[:, 0] >= low) & (tried[:, 0] <= high)
        out[rows[better]], best = tried[better], np.where(better, found, best)
    return out


def _gap_mm(plane: FocalPlane, rows: Ints, angles_deg: Floats, bodies: Floats) -> Floats:
    """(n,) mm from folded arms to what does not move."""
    return obstacle_gap_mm(plane, rows, sweep(plane, rows, angles_deg, 0.0), bodies)
