"""What the positioners of an array have in common: how they sag on the average, how each image is shifted.

The numbers p of a unit are drawn from a normal distribution, with the mean m and the variances T of the
array. Air and fiducials shift all fibres of an image alike, by s, drawn with a variance of its own. A common
shift in the direction of gravity looks like arms that sag, so both are fitted at once, with the units' own
numbers eliminated. Variances are found by expectation and maximisation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.calibration.gravity.model import PARAMETERS
from fiberloom.typing import Floats, Ints

_STEPS = 60
"""Of expectation and maximisation: the variances settle within 1 %."""
_LEAST_RAD2, _LEAST_MM2 = 1e-16, 1e-12
_FEWEST = 8
"""Positioners, below which no shifts are fitted: they could not be told from what the units do themselves."""
_FIRST_MM2 = 1e-7
P = len(PARAMETERS)


@dataclass(frozen=True)
class Rows:
    """N positioners in M images, less their means in each configuration."""

    y_mm: Floats
    """(N, M, 2) as seen."""
    x_mm_rad: Floats
    """(N, M, 2, 4) by which each number shifts the fibre."""
    weight: Floats
    """(N, M) 1/mm^2; 0 where not seen."""
    configuration: Ints
    """(M,)"""

    @property
    def matrix(self) -> Floats:
        """(N, 4, 4) 1/rad^2: normal equations of each positioner alone."""
        return np.asarray(np.einsum("nm,nmip,nmiq->npq", self.weight, self.x_mm_rad, self.x_mm_rad))

    @property
    def vector(self) -> Floats:
        """(N, 4) 1/rad."""
        return np.asarray(np.einsum("nm,nmip,nmi->np", self.weight, self.x_mm_rad, self.y_mm))

    def select(self, rows: Ints) -> Rows:
        """Some of the positioners."""
        return Rows(self.y_mm[rows], self.x_mm_rad[rows], self.weight[rows], self.configuration)

    def shift_pairs(self) -> Floats:
        """(M, M) 1/mm^2: normal matrix of the shifts of the images, in one coordinate, of all positioners."""
        pairs = np.diag(self.weight.sum(axis=0))
        for one in np.unique(self.configuration):
            at = np.flatnonzero(self.configuration == one)
            own = self.weight[:, at]
            whole = np.maximum(own.sum(axis=1), 1e-300)
            pairs[np.ix_(at, at)] -= np.einsum("nm,nk,n->mk", own, own, 1.0 / whole)
        return pairs


@dataclass(frozen=True)
class Common:
    """Of an array."""

    mean_rad: Floats
    """(4,) of the numbers."""
    mean_rad2: Floats
    """(4, 4) covariance of that mean."""
    spread_rad2: Floats
    """(4,) variances from unit to unit."""
    shift_mm: Floats
    """(M, 2) of each image."""

    @property
    def significance(self) -> float:
        """By how many standard deviations the square of the mean is larger than noise would make it."""
        square = float(self.mean_rad @ np.linalg.solve(self.mean_rad2, self.mean_rad))
        return (square - P) / float(np.sqrt(2.0 * P))

    def own(self, rows: Rows) -> tuple[Floats, Floats]:
        """(N, 4) rad and (N, 4, 4) rad^2: the numbers of each positioner, and their covariance."""
        left = rows.vector - np.einsum("nm,nmip,mi->np", rows.weight, rows.x_mm_rad, self.shift_mm)
        wide = np.linalg.inv(rows.matrix + np.diag(1.0 / self.spread_rad2))
        at = np.einsum("npq,nq->np", wide, left + self.mean_rad / self.spread_rad2)
        drawn = wide / self.spread_rad2  # share of the array's mean in each
        return at, wide + np.einsum("npq,qr,nsr->nps", drawn, self.mean_rad2, drawn)


def common_of(rows: Rows) -> Common:
    """Mean, spread and shifts of an array from its `rows`, all of which tell their numbers."""
    own = np.linalg.solve(rows.matrix, rows.vector[..., None])[..., 0]
    spread, shifted_mm2 = np.maximum(own.var(axis=0), _LEAST_RAD2), _FIRST_MM2
    if len(own) < _FEWEST:
        shifted_mm2 = _LEAST_MM2
    known = _solved(rows, spread, shifted_mm2)[0]
    for _ in range(_STEPS):
        known, squares_mm2 = _solved(rows, spread, shifted_mm2)
        at, wide = known.own(rows)
        inner = np.einsum("npp->np", wide).mean(axis=0) + ((at - known.mean_rad) ** 2).mean(axis=0)
        spread = np.maximum(inner, _LEAST_RAD2)
        if len(own) >= _FEWEST:
            shifted_mm2 = max(squares_mm2, _LEAST_MM2)
    return known


def _solved(rows: Rows, spread: Floats, shifted_mm2: float) -> tuple[Common, float]:
    """Mean and shifts by least squares, and the mean square that the shifts may have."""
    n, m = rows.weight.shape
    x_to_s = np.einsum("nm,nmip->npim", rows.weight, rows.x_mm_rad).reshape(n, P, 2 * m)
    whole = np.concatenate([rows.matrix, x_to_s], axis=2)
    drawn = np.linalg.inv(rows.matrix + np.diag(1.0 / spread))
    pairs = rows.shift_pairs()
    normal = np.zeros((P + 2 * m, P + 2 * m))
    normal[:P, :] = whole.sum(axis=0)
    normal[P:, :P] = normal[:P, P:].T
    for k in (0, 1):
        at = slice(P + k * m, P + (k + 1) * m)
        normal[at, at] = pairs
    half = np.einsum("npq,nqs->nps", drawn, whole)
    normal -= np.einsum("nps,npt->st", whole, half)
    normal[P:, P:] += np.eye(2 * m) / shifted_mm2
    right = np.concatenate(
        [rows.vector.sum(axis=0), np.einsum("nm,nmi->im", rows.weight, rows.y_mm).reshape(-1)]
    ) - np.einsum("nps,np->s", half, rows.vector)
    wide = np.linalg.inv(normal)
    found = wide @ right
    shift_mm = found[P:].reshape(2, m).T
    square = float((found[P:] ** 2 + np.diag(wide)[P:]).mean())
    return Common(found[:P], wide[:P, :P], spread, shift_mm), square
