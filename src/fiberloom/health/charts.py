"""Charts: evidence that adds up from move to move until it is beyond chance.

A CUSUM chart sums the log likelihood ratio of "it is broken" over "it is healthy", never below zero
(Page 1954). A healthy one crosses h about once in e^h of its steps or more rarely; a broken one after
h over the ratio's mean. Steps are clipped, so that one wild measurement decides nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fiberloom.typing import Flags, Floats

Rows = NDArray[np.intp]


@dataclass
class Chart:
    """CUSUM charts of any shape, first index the positioner."""

    shape: tuple[int, ...]
    alarm: float
    clip: float = np.inf
    score: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.score = np.zeros(self.shape)

    def add(self, ratio: Floats, where: Flags | None = None) -> None:
        """Add log likelihood ratios; where a measurement is missing (NaN, not `where`) nothing changes."""
        step = np.clip(np.where(np.isfinite(ratio), ratio, 0.0), -self.clip, self.clip)
        if where is not None:
            step = np.where(where, step, 0.0)
        np.maximum(self.score + step, 0.0, out=self.score)

    def share(self) -> Floats:
        """(N,) the highest score of each positioner relative to the alarm: 1 is beyond chance."""
        highest: Floats = self.score.reshape(len(self.score), -1).max(axis=1) / self.alarm
        return highest

    def forget(self, rows: Rows) -> None:
        """Begin anew, after a repair."""
        self.score[rows] = 0.0


def of_event(happened: Flags, healthy: float, broken: float) -> Floats:
    """Ratio of something that happens with these probabilities."""
    no = math.log((1.0 - broken) / (1.0 - healthy))
    return no + happened.astype(np.float64) * (math.log(broken / healthy) - no)


def of_shift(value: Floats, shift: Floats | float) -> Floats:
    """Log likelihood ratio of a mean of `shift` over one of zero; both in standard deviations of
    `value`.
    """
    return shift * (value - 0.5 * shift)


def of_spread(square: Floats, numbers: int, ratio: float) -> Floats:
    """Ratio of a variance `ratio` times as large; `square` is the sum of `numbers` standard squares."""
    gain: Floats = 0.5 * (square * (1.0 - 1.0 / ratio) - numbers * np.log(ratio))
    return gain
