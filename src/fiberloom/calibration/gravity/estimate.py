"""By how much each arm turns under gravity, from images of an array that stands still and is tilted.

Where a fibre is while nothing pulls does not matter: of each configuration a positioner's mean is taken away,
from what was seen as from what the model says. What is left is linear in the four numbers of a positioner
(`fiberloom.calibration.gravity.model`); an image that does not fit weighs less (Huber).

One positioner alone tells its numbers to half of their size. All together tell by how much units differ, and
the numbers of a unit are drawn towards the array's mean by as much as its own images leave open
(`fiberloom.calibration.gravity.array`).
"""

from __future__ import annotations

import numpy as np

from fiberloom.calibration.gravity.array import Common, P, Rows, common_of
from fiberloom.calibration.gravity.images import TiltImages
from fiberloom.calibration.gravity.model import shifts_per_parameter
from fiberloom.calibration.gravity.sag import ArmSag
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints

_HUBER = 2.5
"""In units of the noise: an image farther off weighs less."""
_ROUNDS = 4
_WIDEST_RAD = 400e-6
"""Standard error of a number of which nothing is known: five times the largest."""
_CLAIM = 5.0
"""Standard deviations by which the array's mean must differ from none."""
_ODD = 30.0
"""Squared distance from the array in its spread, four numbers: one in 2e5 units is beyond."""

UNTOLD = "its images do not tell: gravity has to lie in other directions"
UNSEEN = "no turn by gravity is seen in these images"
ODD = "turns otherwise than the others: look at its gear"


def estimate(plane: FocalPlane, images: TiltImages) -> ArmSag:
    """The sag of the positioners of the `plane` that are in the `images`.

    Where gravity does not turn in them, or where the array as a whole is not seen to turn with it, every
    positioner has a reason and no numbers. InputError where none of them is in the plane.
    """
    known = np.isin(images.positioner_id, plane.positioner_id)
    if not known.any():
        raise InputError(f"images: of none of the {len(plane)} positioners of this layout")
    part = plane.select(plane.index_of(images.positioner_id[known]))
    rows = weighed(part, images, known)
    told = np.linalg.eigvalsh(rows.matrix)[:, 0] > _WIDEST_RAD**-2
    reason = np.where(told, "", UNTOLD).astype("U80")
    sag, wide = np.zeros((len(part), P)), np.full((len(part), P, P), np.nan)
    if told.any():
        array, odd = _without_odd(rows, told)
        reason[odd] = ODD
        if array.significance < _CLAIM:
            reason[told] = UNSEEN
        fine = np.flatnonzero(reason == "")
        sag[fine], wide[fine] = array.own(rows.select(fine))
    return ArmSag(part.positioner_id, sag, wide, (rows.weight > 0.0).sum(axis=1), reason)


def weighed(plane: FocalPlane, images: TiltImages, known: Flags) -> Rows:
    """What the images of the `known` (N,) say of the positioners of the `plane`, by weight."""
    seen = np.asarray(np.isfinite(images.xy_mm[known]).all(axis=2), dtype=np.bool_)
    shifts = np.stack(
        [
            shifts_per_parameter(plane, np.nan_to_num(images.angles_deg[known, m]), pointing)
            for m, pointing in enumerate(images.pointing)
        ],
        axis=1,
    )
    xy = np.nan_to_num(images.xy_mm[known])
    weight: Floats = seen.astype(np.float64)
    for _ in range(_ROUNDS):
        y = _from_means(xy, weight, images.configuration)
        x = _from_means(shifts, weight, images.configuration)
        rows = Rows(y, x, weight, images.configuration)
        left = y - np.einsum("nmip,np->nmi", x, _alone(rows))
        noise_mm = max(_noise_mm(left, seen, images.configuration), 1e-9)
        off = np.hypot(left[..., 0], left[..., 1]) / noise_mm
        weight = np.where(seen, np.minimum(1.0, _HUBER / np.maximum(off, 1e-9)), 0.0)
    return Rows(y, x, rows.weight / noise_mm**2, images.configuration)


def _from_means(values: Floats, weight: Floats, configuration: Ints) -> Floats:
    """(N, M, ...) less their means in each configuration, by `weight` (N, M)."""
    left = values.copy()
    for one in np.unique(configuration):
        at = configuration == one
        share = weight[:, at] / np.maximum(weight[:, at].sum(axis=1, keepdims=True), 1e-300)
        left[:, at] -= np.einsum("nm,nm...->n...", share, values[:, at])[:, None]
    return left


def _alone(rows: Rows) -> Floats:
    """(N, 4) least squares of each positioner; 0 along what its images do not tell."""
    inverse = np.linalg.pinv(rows.matrix, rcond=1e-9, hermitian=True)
    return np.asarray(np.einsum("npq,nq->np", inverse, rows.vector))


def _noise_mm(left_mm: Floats, seen: Flags, configuration: Ints) -> float:
    """Of a coordinate, from the median of what is `left_mm` (N, M, 2); all cameras' images are alike."""
    if not seen.any():
        return 0.0
    means = sum(int(seen[:, configuration == one].any(axis=1).sum()) for one in np.unique(configuration))
    fitted = means + 0.5 * P * int(seen.any(axis=1).sum())
    free = max(float(seen.sum()) - fitted, 1.0)
    median = float(np.median(np.abs(left_mm[seen])))
    return 1.4826 * median * float(np.sqrt(seen.sum() / free))


def _without_odd(rows: Rows, told: Flags) -> tuple[Common, Flags]:
    """The array, and (N,) which do not belong to it."""
    odd = np.zeros_like(told)
    for _ in range(2):
        array = common_of(rows.select(np.flatnonzero(told & ~odd)))
        own = rows.select(np.flatnonzero(told))
        alone = np.linalg.inv(own.matrix)
        shifted = np.einsum("nm,nmip,mi->np", own.weight, own.x_mm_rad, array.shift_mm)
        apart = np.einsum("npq,nq->np", alone, own.vector - shifted) - array.mean_rad
        expected = np.linalg.inv(alone + np.diag(array.spread_rad2))
        odd[told] = np.einsum("np,npq,nq->n", apart, expected, apart) > _ODD
    return array, odd
