"""By how many whole motor turns a counter is off, by images of its fibre.

After power-up a hall sensor says the angle of the motor within a turn, and the counter may be off by whole
ones. A turn of the alpha motor moves a stretched arm of SDSS-V by 0.14 mm, a turn of beta's by 0.09 mm, both
against each other by 0.045 mm wherever it is: with arms and maps known to some 20 um a few images tell them,
where the arm is neither folded nor stretched.

For each number of turns of either axis (a hypothesis) the misses of all images are weighed by Student's t
with the scatter of the field itself: most counters are right, so the median miss tells it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.operation.safety.begin import TURNS
from fiberloom.typing import Flags, Floats, Ints

PROVEN = 0.99
"""Probability from which on a number of turns is told."""

OFF_SHARE = 0.05
"""Of the positioners: those with counters that are off, before anything is seen (assumed)."""

BOTH_SHARE = 0.25
"""Of those: both counters are off, as where power went while both axes turned (assumed)."""

FREEDOM = 8.0
"""Of Student's t: arms that are far off their table are more frequent than in a Gaussian."""

LEAST_SCATTER_MM = 0.005
"""Of a field, per coordinate: no map is better than that."""

_MEDIAN = np.sqrt(2.0 * np.log(2.0))
"""Median distance of a Gaussian in the plane, in units of its scatter per coordinate."""


def hypotheses() -> Ints:
    """(H, 2) motor turns of alpha and of beta that a counter may have lost or gained, none first."""
    steps = sorted(range(-TURNS, TURNS + 1), key=abs)
    return np.array([(a, b) for a in steps for b in steps])


def log_prior(turns: Ints) -> Floats:
    """(H,) natural logarithm of the probability of `turns` (H, 2): each further turn is half as likely."""
    which = np.array([1.0 - OFF_SHARE, 0.5 * OFF_SHARE * (1.0 - BOTH_SHARE), OFF_SHARE * BOTH_SHARE])
    # of either sign, and 1, 2, 3... turns with 1/2, 1/4, 1/8...
    size = np.where(turns == 0, 0.0, -(1.0 + np.abs(turns)) * np.log(2.0)).sum(axis=1)
    return np.asarray(np.log(which)[(turns != 0).sum(axis=1)] + size)


@dataclass(frozen=True, eq=False)
class CountedTurns:
    """What images say of the counters of N positioners."""

    turns: Ints
    """(N, 2) the likeliest motor turns to add to what each reports."""
    probability: Floats
    """(N,) of these; that of the prior where no image shows the fibre."""
    scatter_mm: float
    """Of the field, per coordinate, in the last image; infinite where too few are seen."""

    @property
    def proven(self) -> Flags:
        """(N,) whose number of turns is told."""
        return np.asarray(self.probability > PROVEN)


class TurnCounter:
    """Weighs the images of one field until its counters change."""

    def __init__(self, plane: FocalPlane) -> None:
        """`plane`: N positioners, as well as they are known."""
        self.plane, self.tried = plane, hypotheses()
        self._weight = np.tile(log_prior(self.tried), (len(plane), 1))
        self._scatter_mm = np.inf

    def add(self, reported_deg: Floats, seen_mm: Floats) -> None:
        """One image: `reported_deg` (N, 2); `seen_mm` (N, 2) metrology fibres, NaN where not seen."""
        miss_mm = self._misses_mm(reported_deg, seen_mm)
        as_reported = miss_mm[:, 0]
        if not np.isfinite(as_reported).any():
            return
        self._scatter_mm = max(float(np.nanmedian(as_reported)) / _MEDIAN, LEAST_SCATTER_MM)
        log = -0.5 * (FREEDOM + 2.0) * np.log1p(miss_mm**2 / (FREEDOM * self._scatter_mm**2))
        self._weight += np.where(np.isfinite(log), log, 0.0)

    def _misses_mm(self, reported_deg: Floats, seen_mm: Floats) -> Floats:
        """(N, H) distances of what is seen from where each hypothesis has it."""
        turn_deg = np.array([360.0 / axis.gear for axis in self.plane.instrument.axes])
        miss_mm = np.empty((len(self.plane), len(self.tried)))
        for k, turns in enumerate(self.tried):
            place_mm = self.plane.forward(*(reported_deg + turns * turn_deg).T)
            miss_mm[:, k] = np.hypot(*(seen_mm - place_mm).T)
        return miss_mm

    def nearest(self, reported_deg: Floats, seen_mm: Floats, some: bool = False) -> tuple[Ints, Floats]:
        """The turns (N, 2) that are likeliest by what was added, and by how much they miss, (N,) in mm.

        `reported_deg` and `seen_mm` as of `add`; `some`: of those that are off, which is known.
        """
        first = 1 if some else 0  # the first hypothesis is no turn
        best = first + self._weight[:, first:].argmax(axis=1)
        miss_mm = self._misses_mm(reported_deg, seen_mm)[np.arange(len(best)), best]
        return self.tried[best], np.nan_to_num(miss_mm, nan=np.inf)

    def counted(self) -> CountedTurns:
        """What the images so far say."""
        share = np.exp(self._weight - self._weight.max(axis=1, keepdims=True))
        share /= share.sum(axis=1, keepdims=True)
        best = share.argmax(axis=1)
        return CountedTurns(self.tried[best], share.max(axis=1), self._scatter_mm)


def told_apart_mm(plane: FocalPlane, angles_deg: Floats) -> Floats:
    """(N, C) mm by which the least change of turns moves the fibre: the worth of places for counting them.

    `angles_deg` (N, C, 2): alpha and beta of C places for each positioner of the `plane`. The changes are one
    turn of either axis, one of both, and two of one with one of the other. One of alpha against one of beta
    is left out: it moves the fibre by a turn of the alpha arm alone, 45 um of SDSS-V, wherever it is.
    """
    turn_rad = np.array([2.0 * np.pi / axis.gear for axis in plane.instrument.axes])
    rows = np.repeat(np.arange(len(plane)), angles_deg.shape[1])
    flat = angles_deg.reshape(-1, 2)
    fibre_mm = plane.forward(flat[:, 0], flat[:, 1], index=rows)
    from_axis_mm = fibre_mm - plane.centres_mm[rows], fibre_mm - plane.elbows_mm(flat[:, 0], index=rows)
    step = [turn * (off.T[0] + 1j * off.T[1]) for turn, off in zip(turn_rad, from_axis_mm, strict=True)]
    ways = ((1, 0), (0, 1), (1, 1), (2, 1), (2, -1), (1, 2), (1, -2))
    least = np.min([np.abs(a * step[0] + b * step[1]) for a, b in ways], axis=0)
    return np.asarray(least.reshape(angles_deg.shape[:2]))
