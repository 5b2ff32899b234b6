"""Square profiles: each axis goes at its full rate from the start of a group, and stops at once (MEGARA)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.drive.port import Wanted
from fiberloom.drive.steppers.groups import grouped
from fiberloom.drive.steppers.known import KnownUnits
from fiberloom.drive.steppers.link import Leg
from fiberloom.instruments import Instrument
from fiberloom.typing import Flags, Floats, Ints


@dataclass(frozen=True, eq=False)
class SquareMaker:
    """Groups of moves with square profiles. Implements `fiberloom.drive.steppers.drive.Maker`."""

    rate_Hz: Floats
    """(2,) steps a second of alpha and beta."""
    trial_steps: int
    """Of alpha, of the trial."""

    @classmethod
    def of(cls, instrument: Instrument, trial_deg: float) -> SquareMaker:
        """With the speeds of an instrument; `trial_deg`: way of the trial."""
        step = np.array([axis.smallest_step_deg for axis in instrument.axes])
        speed = np.array([axis.speed_deg_s for axis in instrument.axes])
        return cls(speed / step, round(trial_deg / step[0]))

    def legs(
        self, wanted: Wanted, moves: Flags, counts: Ints, known: KnownUnits
    ) -> tuple[list[Leg], dict[int, str]]:
        """Fold, turn, unfold; a correction straight. `wanted`, `moves`, `counts`, `known`: as of `Maker`."""
        if wanted.small:
            return self._straight(wanted, moves, counts, known), {}
        found = grouped(wanted.obstacles, wanted.here_deg, wanted.goal_deg, moves)
        now, angles, legs = counts.copy(), wanted.here_deg, []
        for rows, after in found.stages:
            told = known.counts_on_way(after, wanted.goal_deg, np.sign(after - angles))
            then = now.copy()
            then[rows] = np.where(np.abs(after - angles)[rows] > 1e-9, told[rows], now[rows])
            legs.append(self.leg(rows, now[rows], then[rows]))
            now, angles = then, after
        return legs, found.refused

    def _straight(self, wanted: Wanted, moves: Flags, counts: Ints, known: KnownUnits) -> list[Leg]:
        """All at once."""
        rows = np.flatnonzero(moves)
        way = wanted.goal_deg - wanted.here_deg
        after = np.where(way == 0.0, counts, known.counts(wanted.goal_deg, np.sign(way)))
        return [self.leg(rows, counts[rows], after[rows])] if len(rows) else []

    def trial(self, rows: Ints, counts: Ints) -> Leg:
        """Alpha out. `rows` (m,), `counts` (N, 2): as of `Maker`."""
        return self.leg(rows, counts[rows], counts[rows] + np.array([self.trial_steps, 0]))

    def leg(self, rows: Ints, before: Ints, after: Ints) -> Leg:
        """One leg of units `rows` (m,) from counts to counts (m, 2)."""
        ends_s = np.abs(after - before) / self.rate_Hz
        time_s = np.sort(np.column_stack([np.zeros(len(rows)), ends_s]), axis=1).T
        gone = np.minimum(time_s[..., None] / np.maximum(ends_s, 1e-9), 1.0)
        return Leg(rows, time_s, np.rint(before + gone * (after - before)).astype(np.int64))
