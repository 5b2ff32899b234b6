"""Where a phi arm is out of everyone's way, whatever theta does."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats

_PHI_DEG = np.arange(0.0, 180.5, 1.0)
MARGIN_DEG = 3.5
"""For the overshoot of an approach, and a little."""


def safe_phi_deg(plane: FocalPlane, margin_mm: float = 0.1) -> Floats:
    """(N,) smallest phi in deg from which on, up to folded, an arm keeps within its own territory.

    That is so far from its centre that it meets neither the theta bodies of neighbours nor their arms that
    keep within theirs, with `margin_mm` to spare. Fixed obstacles are not looked at.
    """
    nearest = cKDTree(plane.centres_mm).query(plane.centres_mm, k=2)[0][:, 1] if len(plane) > 1 else np.inf
    theta_mm = plane.instrument.bodies.reach_mm("alpha")
    limit = np.minimum(nearest - theta_mm, 0.5 * nearest) - margin_mm
    inside = _outermost_mm(plane) <= np.broadcast_to(limit, (len(plane),))[:, None]
    # from the folded end: the last angle of an unbroken run
    run = np.cumprod(inside[:, ::-1], axis=1).sum(axis=1)
    first = _PHI_DEG[len(_PHI_DEG) - np.maximum(run, 1)]
    return np.asarray(np.minimum(first - np.rad2deg(plane.beta_off_rad) + MARGIN_DEG, 180.0))


def _outermost_mm(plane: FocalPlane) -> Floats:
    """(N, angles) how far the farthest point of what covers phi is from the centre."""
    parts = [part.capsules_mm for part in plane.instrument.bodies.parts if part.arm == "beta"]
    low, high = plane.beta_segment_mm
    covers = np.vstack(parts) if parts else np.array([[low, 0.0, high, 0.0, plane.collision_buffer_mm]])
    turn = np.exp(1j * np.deg2rad(_PHI_DEG))
    out = np.zeros((len(plane), len(_PHI_DEG)))
    for x0, y0, x1, y1, radius in covers:
        for point in (x0 + 1j * y0, x1 + 1j * y1):
            out = np.maximum(out, np.abs(plane.l_alpha_mm[:, None] + turn * point) + radius)
    return out
