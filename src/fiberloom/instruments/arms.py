"""Arms as arrays: the columns of `FocalPlane.arms`, where the elbows are, and how angles come and go."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from fiberloom.errors import InputError
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
    elbows: Floats = arms[(slice(None), CENTRE, *more)] + arms[(slice(None), L_ALPHA, None, *more)] * along
    return elbows


class Inverse(NamedTuple):
    """Arm angles that put a fibre on its target."""

    alpha_deg: Floats
    beta_deg: Floats
    reachable: Flags
    gap_mm: Floats
    """How far the target lies outside the reach of the arms; 0 with reachable = False: only the
    axis limits stand in the way; inf: the positioner lacks the fibre."""


class Solutions(NamedTuple):
    """All arm angles that put fibres on their targets: both elbows, and turns of alpha."""

    angles_deg: Floats
    """(n, k, 2) alpha and beta; beta in [0, 180] first, then by rising alpha."""
    number: Ints
    """(n,) how many of the k hold."""
    gap_mm: Floats
    """As of `Inverse`."""

    @property
    def holds(self) -> Flags:
        """(n, k) which of them do."""
        holds: Flags = np.arange(self.angles_deg.shape[1]) < self.number[:, None]
        return holds

    def one(self, near_deg: ArrayLike | None = None) -> Inverse:
        """The first of each, or the one nearest to angles (n, 2) in deg, turns left aside."""
        reachable, which = self.number > 0, np.zeros(len(self.number), dtype=np.int64)
        if near_deg is not None:
            off = np.abs((self.angles_deg - np.asarray(near_deg)[:, None] + 180.0) % 360.0 - 180.0).sum(
                axis=2
            )
            which = np.where(self.holds, off, np.inf).argmin(axis=1)
        chosen = np.where(reachable[:, None], self.angles_deg[np.arange(len(which)), which], 0.0)
        alpha, beta = chosen.T
        return Inverse(alpha, beta, reachable, self.gap_mm)


def columns_of(first: Floats, second: Floats, n: int) -> Floats:
    """(n, 2) of two columns of any unit, in rad as arms take them, each (n,) or one number for all."""
    pair = np.empty((n, 2))
    pair[:, 0], pair[:, 1] = first, second
    return pair


def arm_rows(
    positioner_id: Ints, hole: NDArray[np.str_], arms: Floats, most: int = 5
) -> list[dict[str, Any]]:
    """The first `most` positioners with their arms, for notebooks.

    `positioner_id` (N,), `hole` (N,) and `arms` (N, 5) in mm and rad, as `FocalPlane` has them.
    """
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


def pairs_within(centres_mm: Floats, reach_mm: Floats, extra_mm: float) -> Ints:
    """(P, 2) rows i < j, in order, of arms at centres (N, 2) with reach (N,) that come within `extra_mm`."""
    tree = cKDTree(centres_mm)
    pairs = tree.query_pairs(2 * reach_mm.max(initial=0.0) + extra_mm, output_type="ndarray")
    i, j = pairs[:, 0], pairs[:, 1]
    gap = np.linalg.norm(centres_mm[i] - centres_mm[j], axis=1)
    near = pairs[gap < reach_mm[i] + reach_mm[j] + extra_mm].astype(np.int64)
    in_order: Ints = near[np.lexsort((near[:, 1], near[:, 0]))]
    return in_order


def rows_of(known: Ints, positioner_id: ArrayLike) -> Ints:
    """Rows of positioners among the `known` (N,); an InputError names the first that is not there."""
    wanted, n = np.asarray(positioner_id, dtype=np.int64), len(known)
    if n == 0 and wanted.size > 0:
        raise InputError(f"positioner {wanted.flat[0]}: the focal plane is empty")
    if n == 0:
        return np.zeros(wanted.shape, dtype=np.int64)
    order = np.argsort(known)
    rows: Ints = order[np.searchsorted(known, wanted, sorter=order).clip(max=n - 1)]
    wrong = known[rows] != wanted
    if np.any(wrong):
        raise InputError(
            f"positioner {np.atleast_1d(wanted)[np.atleast_1d(wrong)][0]}: not in "
            f"this focal plane of {n} positioners"
        )
    return rows


def rows_given(n: int, index: ArrayLike | None) -> Ints:
    """Rows by number or by a mask of n; all when left out."""
    if index is None:
        return np.arange(n)
    rows = np.atleast_1d(np.asarray(index))
    return np.flatnonzero(rows) if rows.dtype == bool else rows.astype(np.int64)
