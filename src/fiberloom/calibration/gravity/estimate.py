"""By how much each arm turns under gravity, from images of an array that stands still and is tilted.

Where a fibre is while nothing pulls does not matter: of each configuration a positioner's mean is taken away,
from what was seen as from what the model says. What is left is linear in the four numbers of a positioner
(`fiberloom.calibration.gravity.model`); an image that does not fit weighs less (Huber).

One positioner alone tells its numbers to a quarter of their size. All together tell by how much units
differ: the numbers of a unit are drawn towards the array's mean by as much as its own images leave open (a
normal distribution over the array whose mean and spread are fitted, by expectation and maximisation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.calibration.gravity.images import TiltImages
from fiberloom.calibration.gravity.model import PARAMETERS, shifts_per_parameter
from fiberloom.calibration.gravity.sag import ArmSag
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints

_HUBER = 2.5
"""In units of the noise: an image farther off weighs less."""
_ROUNDS = 4
_STEPS = 60
"""Of expectation and maximisation: the spread settles within 1 %."""
_WIDEST_RAD = 400e-6
"""Standard error of a number of which nothing is known: five times the largest."""
_CLAIM = 5.0
"""Standard deviations by which the images must fit better with gravity than without."""
_ODD = 30.0
"""Squared distance from the array in its spread, four numbers: one in 2e5 units is beyond."""
_NAMES = len(PARAMETERS)

UNTOLD = "its images do not tell: gravity has to lie in other directions"
UNSEEN = "no turn by gravity is seen in these images"
ODD = "turns otherwise than the others: look at its gear"


@dataclass(frozen=True)
class Likelihoods:
    """Of N positioners: what their own images say, as normal equations."""

    matrix: Floats
    """(N, 4, 4) 1/rad^2."""
    vector: Floats
    """(N, 4) 1/rad."""
    n_images: Ints
    """(N,)"""
    noise_mm: float
    """Rms of one coordinate."""

    @property
    def told(self) -> Flags:
        """(N,) whose own images tell all four numbers."""
        weakest = np.linalg.eigvalsh(self.matrix)[:, 0]
        told: Flags = weakest > _WIDEST_RAD**-2
        return told

    def gain(self, rows: Flags) -> float:
        """By how many standard deviations the images of `rows` fit better with gravity than noise would."""
        if not rows.any():
            return 0.0
        own = np.linalg.solve(self.matrix[rows], self.vector[rows][..., None])[..., 0]
        gained = float(np.einsum("np,np->", self.vector[rows], own))
        expected = _NAMES * int(rows.sum())
        return (gained - expected) / float(np.sqrt(2.0 * expected))


def estimate(plane: FocalPlane, images: TiltImages) -> ArmSag:
    """The sag of the positioners of the `plane` that are in the `images`.

    Where gravity does not turn in them, or where they fit no better with it than noise would, every
    positioner has a reason and no numbers. InputError where none of them is in the plane.
    """
    known = np.isin(images.positioner_id, plane.positioner_id)
    if not known.any():
        raise InputError(f"images: of none of the {len(plane)} positioners of this layout")
    part = plane.select(plane.index_of(images.positioner_id[known]))
    found = likelihoods(part, images, known)
    told = found.told
    reason = np.where(told, "", UNTOLD).astype("U80")
    if told.any() and found.gain(told) < _CLAIM:
        reason[told] = UNSEEN
        told = np.zeros_like(told)
    sag, wide = np.zeros((len(part), _NAMES)), np.full((len(part), _NAMES, _NAMES), np.nan)
    if told.any():
        odd, mean, spread = _array(found, told)
        reason[odd] = ODD
        rows = told & ~odd
        sag[rows], wide[rows] = _posterior(found.matrix[rows], found.vector[rows], mean, spread)
    return ArmSag(part.positioner_id, sag, wide, found.n_images, reason)


def likelihoods(plane: FocalPlane, images: TiltImages, rows: Flags) -> Likelihoods:
    """What the images of these `rows` say, of the positioners of the `plane`, one by one."""
    seen = np.asarray(np.isfinite(images.xy_mm[rows]).all(axis=2), dtype=np.bool_)
    shifts = np.stack(
        [
            shifts_per_parameter(plane, np.nan_to_num(images.angles_deg[rows, m]), pointing)
            for m, pointing in enumerate(images.pointing)
        ],
        axis=1,
    )
    xy = np.nan_to_num(images.xy_mm[rows])
    weight: Floats = seen.astype(np.float64)
    noise_mm = 0.0
    for _ in range(_ROUNDS):
        y = _from_means(xy, weight, images.configuration)
        x = _from_means(shifts, weight, images.configuration)
        matrix = np.einsum("nm,nmip,nmiq->npq", weight, x, x)
        vector = np.einsum("nm,nmip,nmi->np", weight, x, y)
        left = y - np.einsum("nmip,np->nmi", x, _solved(matrix, vector))
        noise_mm = _noise_mm(left, seen, images.configuration)
        off = np.hypot(left[..., 0], left[..., 1]) / max(noise_mm, 1e-9)
        weight = np.where(seen, np.minimum(1.0, _HUBER / np.maximum(off, 1e-9)), 0.0)
    variance = max(noise_mm, 1e-9) ** 2
    return Likelihoods(matrix / variance, vector / variance, seen.sum(axis=1), noise_mm)


def _from_means(values: Floats, weight: Floats, configuration: Ints) -> Floats:
    """(N, M, ...) less their means in each configuration, by `weight` (N, M)."""
    left = values.copy()
    for one in np.unique(configuration):
        at = configuration == one
        share = weight[:, at] / np.maximum(weight[:, at].sum(axis=1, keepdims=True), 1e-300)
        left[:, at] -= np.einsum("nm,nm...->n...", share, values[:, at])[:, None]
    return left


def _solved(matrix: Floats, vector: Floats) -> Floats:
    """(N, 4) least squares; 0 along what a positioner's images do not tell."""
    inverse = np.linalg.pinv(matrix, rcond=1e-9, hermitian=True)
    return np.asarray(np.einsum("npq,nq->np", inverse, vector))


def _noise_mm(left_mm: Floats, seen: Flags, configuration: Ints) -> float:
    """Of a coordinate, from the median of what is `left_mm` (N, M, 2); all cameras' images are alike."""
    if not seen.any():
        return 0.0
    means = sum(int(seen[:, configuration == one].any(axis=1).sum()) for one in np.unique(configuration))
    fitted = means + 0.5 * _NAMES * int(seen.any(axis=1).sum())
    free = max(float(seen.sum()) - fitted, 1.0)
    median = float(np.median(np.abs(left_mm[seen])))
    return 1.4826 * median * float(np.sqrt(seen.sum() / free))


def _array(found: Likelihoods, told: Flags) -> tuple[Flags, Floats, Floats]:
    """(N,) which do not belong to the array; its mean (4,) and the variances (4,) round it."""
    odd = np.zeros_like(told)
    for _ in range(2):
        rows = told & ~odd
        mean, spread = _mean_and_spread(found.matrix[rows], found.vector[rows])
        covariance = np.linalg.inv(found.matrix[told])
        apart = np.einsum("npq,nq->np", covariance, found.vector[told]) - mean
        far = np.einsum("np,npq,nq->n", apart, np.linalg.inv(covariance + np.diag(spread)), apart)
        odd[told] = far > _ODD
    return odd, mean, spread


def _mean_and_spread(matrix: Floats, vector: Floats) -> tuple[Floats, Floats]:
    """Mean (4,) and variances (4,) of a normal distribution from which the units were drawn."""
    own = np.linalg.solve(matrix, vector[..., None])[..., 0]
    mean, spread = np.median(own, axis=0), np.maximum(own.var(axis=0), 1e-16)
    for _ in range(_STEPS):
        at, wide = _posterior(matrix, vector, mean, spread)
        mean = at.mean(axis=0)
        spread = np.maximum(np.einsum("npp->np", wide).mean(axis=0) + ((at - mean) ** 2).mean(axis=0), 1e-16)
    return mean, spread


def _posterior(matrix: Floats, vector: Floats, mean: Floats, spread: Floats) -> tuple[Floats, Floats]:
    """(N, 4) and (N, 4, 4): best numbers and covariance, with the array's `mean` and variances `spread`."""
    wide: Floats = np.asarray(np.linalg.inv(matrix + np.diag(1.0 / spread)), dtype=np.float64)
    at: Floats = np.einsum("npq,nq->np", wide, vector + mean / spread)
    return at, wide
