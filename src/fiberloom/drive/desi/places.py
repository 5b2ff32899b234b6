"""From the place of a fibre to the angles of its arm, where the angles are known roughly."""

from __future__ import annotations

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.instruments.arms import CENTRE
from fiberloom.typing import Floats

_ROOM_DEG = 5.0
"""Zeros and maps are off by less: a place that is farther beyond a stop cannot be."""


def angles_near(plane: FocalPlane, xy_mm: Floats, near_deg: Floats) -> Floats:
    """(N, 2) angles in deg that put fibres at `xy_mm` (N, 2), the solution nearest to `near_deg` (N, 2).

    One within the stops goes before one that is not. Of a place out of reach: the arm stretched or folded
    towards it. NaN where the place is.
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
    low, high = np.moveaxis(plane.stops_of(), -1, 0)
    beyond = [np.maximum(low - angles, angles - high).max(axis=1) > _ROOM_DEG for angles in found]
    far = [np.abs(angles - near_deg).sum(axis=1) for angles in found]
    far = [off + 1e3 * out for off, out in zip(far, beyond, strict=True)]
    return np.asarray(np.where((far[0] <= far[1])[:, None], *found), dtype=np.float64)
