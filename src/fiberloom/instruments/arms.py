"""Arms as arrays: the columns of `FocalPlane.arms`, where the elbows are, and how angles come and go."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad

CENTRE = slice(0, 2)
L_ALPHA, ALPHA_OFF, BETA_OFF = 2, 3, 4
"""Columns of FocalPlane.arms."""


def elbows_mm(arms: Floats, alpha_deg: ArrayLike) -> Floats:
    """(n, 2, ...) mm: the beta axes of arms (n, 5) at alpha (n, ...) deg."""
    alpha = deg_to_rad(alpha_deg)
    more = (None,) * (alpha.ndim - 1)
    turn = alpha + arms[(slice(None), ALPHA_OFF, *more)]
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return arms[(slice(None), CENTRE, *more)] + arms[(slice(None), L_ALPHA, None, *more)] * along


class Inverse(NamedTuple):
    """Arm angles that put a fibre on its target."""

    alpha_deg: Floats
    beta_deg: Floats
    reachable: Flags
    gap_mm: Floats
    """How far the target lies outside the reach of the arms; 0 with reachable = False: only the
    axis limits stand in the way; inf: the positioner lacks the fibre."""


def columns_of(first: Floats, second: Floats, n: int) -> Floats:
    """(n, 2) of two columns, each (n,) or one number for all."""
    pair = np.empty((n, 2))
    pair[:, 0], pair[:, 1] = first, second
    return pair


def arm_rows(
    positioner_id: Ints, hole: NDArray[np.str_], arms: Floats, most: int = 5
) -> list[dict[str, Any]]:
    """The first positioners with their arms, for notebooks."""
    return [
        {
            "positioner": int(positioner_id[k]),
            "hole": str(hole[k]),
            "x [mm]": float(arms[k, 0]),
            "y [mm]": float(arms[k, 1]),
            "alpha arm [mm]": float(arms[k, L_ALPHA]),
        }
        for k in range(min(len(positioner_id), most))
    ]
