"""Interlocks of MOONS' units: an arm that touches another, or that leaves its range, stops where it is.

Beta arms carry a voltage, so both units of a contact know of it (ukatc/fpu_driver); alpha has a limit switch
and beta a hardware limit. The others do not know: they go on, and may run into those that have stopped.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np

from fiberloom.twin.cobras.contacts import ArmBodies, touching
from fiberloom.typing import Flags, Floats, Ints

HALVINGS = 10
"""Of an interval in which two arms touch: a segment of 125 ms to 0.1 ms."""


class StopKind(StrEnum):
    """Why a unit stops."""

    COLLISION = "collision"
    """A beta arm touches, or is beyond its hardware limit."""
    LIMIT = "limit"
    """Alpha has left its range."""


@dataclass(frozen=True)
class InterlockStop:
    """Units that stop at once."""

    time_s: float
    rows: tuple[int, ...]
    kind: StopKind


@dataclass(frozen=True, eq=False)
class Interlocks:
    """Of N units."""

    bodies: ArmBodies
    """Of the N arms, then of what does not move."""
    pairs: Ints
    """(P, 2) rows of bodies that can meet."""
    limits_deg: Floats
    """(2, 2) by axis: lowest and highest angle by the counts of a unit's own switches."""

    def first(
        self, time_s: Floats, way_deg: Floats, counted_deg: Floats, held: Flags
    ) -> InterlockStop | None:
        """The first stop on a motion through K moments `time_s`; None: there is none.

        `way_deg` (K, n, 2): true angles of all bodies, `counted_deg` (K, N, 2): of the units by their counts;
        `held` (N,): those that have been stopped on it already.
        """
        found = self._collisions(time_s, way_deg, held) + self._limits(time_s, counted_deg, held)
        return min(found, key=lambda one: one.time_s, default=None)

    def meets(self, row: int, at_deg: Floats) -> bool:
        """Whether an arm touches another body, all at (n, 2) deg."""
        own = self.pairs[(self.pairs == row).any(axis=1)]
        return bool((self.bodies.apart_mm(own, at_deg) < 0.0).any())

    def beyond(self, counted_deg: Floats) -> bool:
        """Whether angles (2,) by a unit's counts are beyond a limit."""
        low, high = self.limits_deg.T
        return bool(((counted_deg < low) | (counted_deg > high)).any())

    def _collisions(self, time_s: Floats, way_deg: Floats, held: Flags) -> list[InterlockStop]:
        still = np.append(held, np.ones(way_deg.shape[1] - len(held), dtype=bool))
        pairs = self.pairs[~still[self.pairs].all(axis=1)]
        stops = []
        for pair in pairs[touching(self.bodies, pairs, way_deg)]:
            rows = tuple(int(row) for row in pair if row < len(held))
            stops.append(InterlockStop(self._touch_s(pair[None], time_s, way_deg), rows, StopKind.COLLISION))
        return stops

    def _touch_s(self, pair: Ints, time_s: Floats, way_deg: Floats) -> float:
        """When a pair (1, 2) that touches does so first."""
        for k, (before, after) in enumerate(pairwise(way_deg)):
            if touching(self.bodies, pair, np.stack([before, after]))[0]:
                share = self._touch_share(pair, before, after)
                return float(time_s[k] + share * (time_s[k + 1] - time_s[k]))
        return float(time_s[-1])

    def _touch_share(self, pair: Ints, before: Floats, after: Floats) -> float:
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            there = before + middle * (after - before)
            met = touching(self.bodies, pair, np.stack([before, there]))[0]
            low, high = (low, middle) if met else (middle, high)
        return high

    def _limits(self, time_s: Floats, counted_deg: Floats, held: Flags) -> list[InterlockStop]:
        """Arms that go outwards beyond a limit."""
        low, high = self.limits_deg.T
        out_deg = np.maximum(low - counted_deg, counted_deg - high)
        leaves = (out_deg[1:] > 0.0) & (out_deg[1:] > out_deg[:-1]) & ~held[:, None]
        stops = []
        for row, axis in np.argwhere(leaves.any(axis=0)).tolist():
            k = int(np.argmax(leaves[:, row, axis]))
            before, after = out_deg[k : k + 2, row, axis]
            share = float(np.clip(-before / (after - before), 0.0, 1.0))
            at_s = float(time_s[k] + share * (time_s[k + 1] - time_s[k]))
            stops.append(InterlockStop(at_s, (row,), StopKind.COLLISION if axis else StopKind.LIMIT))
        return stops
