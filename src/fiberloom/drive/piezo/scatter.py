"""How much each motor scatters, learned from the moves of all of them.

A few moves do not tell a motor that scatters by half of its way from one that had bad luck. But motors of one
kind are alike: how often which scatter occurs is learned from all of them (empirical Bayes), and each motor
is a mixture over a few sizes of scatter. Its tube is a quantile of that mixture, so it has heavy tails as
long as the motor is not known.
"""

from __future__ import annotations

import numpy as np
from scipy.special import erfc

from fiberloom.typing import Flags, Floats, Ints

SIZES = np.geomspace(0.03, 0.9, 10)
"""Of scatter, shares of the way."""
FIRST_MEDIAN, FIRST_LOG_SD = 0.12, 0.8
"""[A] How they are distributed before any motor was seen."""
FIRST_MOTORS = 100.0
"""[A] So many motors that belief counts as."""
SIGMAS = 3.5
"""Of a normal distribution: what a motor may miss by more as rarely as that is not provided for."""
ROUNDS = 3
"""Of expectation and maximisation after each image."""
MOST_SURPRISE = 36.0
"""Squared standard deviations: a spot that was taken for another tells no more than that."""
HALVINGS = 16


class ScatterBelief:
    """The scatter of M motors of several kinds, which each have their own distribution of it."""

    def __init__(self, kind: Ints) -> None:
        """`kind` (M,): 0, 1, ... of each motor."""
        self.kind, kinds = kind, int(kind.max(initial=0)) + 1
        first = np.exp(-0.5 * (np.log(SIZES / FIRST_MEDIAN) / FIRST_LOG_SD) ** 2)
        self._first = np.tile(first / first.sum(), (kinds, 1))
        self._common = self._first.copy()
        self._told = np.zeros((len(kind), len(SIZES)))
        self._share_out()

    def learn(self, off: Floats, told: Floats, other_variance: Floats) -> None:
        """Moves by `told` (M,) ended `off` (M,), NaN: not seen, in deg.

        `other_variance` (M,) deg^2: of all that is not scatter.
        """
        known = np.isfinite(off) & (told != 0.0)
        variance = SIZES**2 * np.square(told)[:, None] + other_variance[:, None]
        surprise = np.minimum(np.square(np.nan_to_num(off))[:, None] / variance, MOST_SURPRISE)
        self._told -= np.where(known[:, None], 0.5 * (np.log(variance) + surprise), 0.0)
        self._share_out()

    def measured(self, scatter: Floats, known: Flags, moves: float) -> None:
        """Motors `known` (M,) showed a `scatter` (M,), dimensionless, of their way, in so many `moves`."""
        size = np.where(known, np.nan_to_num(scatter, nan=1.0), 1.0)[:, None]
        told = -0.5 * moves * (2.0 * np.log(SIZES) + np.minimum((size / SIZES) ** 2, 100.0))
        self._told = np.where(known[:, None], told, self._told)
        self._share_out()

    @property
    def variance(self) -> Floats:
        """(M,) mean square of the scatter of each, dimensionless, of its way."""
        out: Floats = self.weight @ SIZES**2
        return out

    def precision(self, way: Floats, other_variance: Floats) -> Floats:
        """(M,) mean of 1 / variance, 1/deg^2, of where moves by `way` (M,) in deg end.

        `other_variance` (M,) deg^2: of all that is not scatter.
        """
        variance = SIZES**2 * np.square(way)[:, None] + other_variance[:, None]
        out: Floats = (self.weight / np.maximum(variance, 1e-12)).sum(axis=1)
        return out

    def tube(self, way: Floats, other_variance: Floats, sigmas: float) -> Floats:
        """(M,) deg that moves by `way` (M,) miss their ends by, but for as rarely as normal ones by `sigmas`.

        `other_variance` (M,) deg^2: of all that is not scatter.
        """
        sd = np.sqrt(SIZES**2 * np.square(way)[:, None] + other_variance[:, None])
        low, high = sigmas * sd[:, 0], sigmas * sd[:, -1]
        rarely = erfc(sigmas / np.sqrt(2.0))
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            tail = (self.weight * erfc(middle[:, None] / (np.sqrt(2.0) * np.maximum(sd, 1e-12)))).sum(axis=1)
            low, high = np.where(tail > rarely, middle, low), np.where(tail > rarely, high, middle)
        return high

    def _share_out(self) -> None:
        """The common distributions anew, and by them the weights (M, sizes) of each motor."""
        likelihood = np.exp(self._told - self._told.max(axis=1, keepdims=True))
        for _ in range(ROUNDS):
            self.weight = likelihood * self._common[self.kind]
            self.weight /= self.weight.sum(axis=1, keepdims=True)
            for kind, first in enumerate(self._first):
                total = self.weight[self.kind == kind].sum(axis=0) + FIRST_MOTORS * first
                self._common[kind] = total / total.sum()
