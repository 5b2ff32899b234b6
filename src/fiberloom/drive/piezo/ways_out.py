"""Which targets cobras may have so that none has to wait for another: the drive's rule for an assignment.

A cobra turns theta within its territory, then goes out along phi. Where no way out crosses another one, nor
an arm at its target, all can go at once. An arm that does not move may stand in the territory of a neighbour:
then it bars turns too. Implements `fiberloom.assignment.candidates.WayRule`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.assignment.candidates import Block
from fiberloom.drive.piezo.cobras import CobraArms, stops_deg
from fiberloom.drive.piezo.learning import LearningSettings
from fiberloom.drive.piezo.scatter import SIGMAS
from fiberloom.drive.piezo.swept import SweptCheck, box_of
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints

BESIDE_DOT_MM = 0.05
"""[A] A fibre that near to its dot may be cut off by it."""
ROOM_DEG = 6.0
"""[A] Beside theta and beyond phi of a target: what motors may miss when they go out."""
ROOM_OF_SCATTER_DEG = 60.0
"""[A] Times the scatter of phi: room beyond its target, so that the last 17 deg can be one way (3.5 sigmas).
With less a wild motor goes a part of what is left time and again, and is not there after the last move."""


def leg_share(left_deg: Floats, told_deg: Floats, tube_deg: Floats, room_deg: Floats) -> Floats:
    """(n,) shares, at most 1, of a way that end within the room beyond a target.

    `left_deg` (n,): to the target; `told_deg` (n,) of it are aimed at; `tube_deg` (n,): what such a way may
    miss its end by, in proportion; `room_deg` (n,): beyond the target. All in deg, not below 0.
    """
    return np.asarray(np.minimum((left_deg + room_deg) / np.maximum(told_deg + tube_deg, 1e-9), 1.0))


@dataclass(frozen=True, eq=False)
class WaysOut:
    """Ways out of the cobras of a plane."""

    low_deg: Floats
    """(n, 2) counter-clockwise stops."""
    check: SweptCheck
    stands: Flags
    """(n,) cobras that do not move."""
    stands_deg: Floats
    """(n, 2) where these are, from their stops."""
    dots_mm: Floats | None
    """(n, 3) x, y, radius in mm of the dot of each; None: there are none."""
    room_deg: Floats
    """(n, 2) beside theta and beyond phi of a target."""
    turn_miss: Floats
    """(n,) share of its way that a first turn of theta may miss its end by."""
    within_deg: Floats
    """(n,) the most open phi within the territory."""

    @classmethod
    def of(cls, plane: FocalPlane, scatter: Floats | None = None) -> WaysOut:
        """Those of a `plane` with its fiducials and its offline cobras.

        `scatter` (n, 2), dimensionless: rms by which moves of theta and phi miss, of their way, by a
        calibration; NaN, or None: not known.
        """
        low, room = stops_deg(plane)[0], np.full((len(plane), 2), ROOM_DEG)
        scatter = np.full(room.shape, np.nan) if scatter is None else scatter
        room[:, 1] = np.fmax(ROOM_DEG, ROOM_OF_SCATTER_DEG * scatter[:, 1])
        arms = CobraArms.of(plane)
        check, stands_deg = SweptCheck.of(arms, plane.fiducials), plane.offline_position_deg - low
        miss, within = _turn_miss(scatter[:, 0]), arms.phi_within_deg(check.territory_mm())
        return cls(low, check, plane.offline, stands_deg, plane.dots_mm, room, miss, within)

    def blocks(self, positioner: Ints, goal_deg: Floats) -> Ints:
        """(C,) `Block.POCKET` where the way out meets what does not move, `Block.DARK` behind a dot.

        `positioner` (C,): rows of the plane; `goal_deg` (C, 2): alpha and beta.
        """
        dark = np.where(self._behind_dots(positioner, goal_deg), Block.DARK, Block.NONE)
        return np.where(self._meets_what_stands(positioner, goal_deg), Block.POCKET, dark)

    def _behind_dots(self, positioner: Ints, goal_deg: Floats) -> Flags:
        """(C,) candidates at which the fibre is behind a dot: dark, so that nothing corrects it."""
        if self.dots_mm is None:
            return np.zeros(len(positioner), dtype=bool)
        at = self.check.arms.segments_mm(goal_deg - self.low_deg[positioner], positioner)[:, 2:]
        x, y, radius = self.dots_mm[positioner].T
        behind: Flags = np.hypot(at[:, 0] - x, at[:, 1] - y) < radius + BESIDE_DOT_MM
        return behind

    def _meets_what_stands(self, positioner: Ints, goal_deg: Floats) -> Flags:
        """(C,) candidates that something bars which does not move, on the way out or in the turn before."""
        n = self.check.cobras
        i, j = self.check.pairs.T
        still = np.append(self.stands, np.ones(len(self.check.arms) - n, dtype=bool))
        own, other = np.concatenate([i, j[j < n]]), np.concatenate([j, i[j < n]])
        own, other = own[still[other]], other[still[other]]
        order = np.argsort(own, kind="stable")
        first = np.searchsorted(own[order], np.arange(n + 1))
        count = np.diff(first)[positioner]
        row = np.repeat(np.arange(len(positioner)), count)
        within = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        there = other[order][first[positioner[row]] + within]
        at = np.zeros((len(there), 2))
        at[there < n] = self.stands_deg[there[there < n]]
        pairs = np.column_stack([positioner[row], there])
        out = np.zeros(len(positioner), dtype=bool)
        for boxes in (self._boxes(positioner, goal_deg), self._turns(positioner, goal_deg)):
            out[row[self.check.boxes_meet(pairs, np.stack([boxes[row], box_of(at, at)], axis=1))]] = True
        return out

    def crossing(self, positioner: Ints, goal_deg: Floats, first: Ints, second: Ints) -> Flags:
        """(p,) pairs `first`, `second` (p,) of candidates whose ways out could meet.

        `positioner` (C,): rows of the plane, and `goal_deg` (C, 2): alpha and beta of the candidates.
        """
        wide = self._boxes(positioner, goal_deg)
        pairs = np.column_stack([positioner[first], positioner[second]])
        return self.check.boxes_meet(pairs, np.stack([wide[first], wide[second]], axis=1))

    def _boxes(self, positioner: Ints, goal_deg: Floats) -> Floats:
        """(C, 2, 2) from the folded arm to the goal, with room."""
        goal, top = goal_deg - self.low_deg[positioner], self.check.arms.range_deg[positioner]
        room = self.room_deg[positioner]
        low = np.column_stack([goal[:, 0] - room[:, 0], np.zeros(len(goal))])
        return box_of(np.clip(low, 0.0, top), np.clip(goal + room, 0.0, top))

    def _turns(self, positioner: Ints, goal_deg: Floats) -> Floats:
        """(C, 2, 2) of the first turn from the stop, where a field begins, within the territory."""
        goal, top = goal_deg - self.low_deg[positioner], self.check.arms.range_deg[positioner]
        theta = goal[:, 0] * (1.0 + self.turn_miss[positioner]) + ROOM_DEG
        high = np.column_stack([theta, self.within_deg[positioner]])
        return box_of(np.zeros_like(goal), np.clip(high, 0.0, top))


def _turn_miss(scatter: Floats) -> Floats:
    """(n,) by scatter (n,), NaN where it was not measured: as of a map that is known but for its places."""
    known = LearningSettings()
    drift = known.measured_gain_sigma**2 + known.drift_sigma**2
    first = known.gain_sigma**2 + known.drift_sigma**2
    out: Floats = SIGMAS * np.sqrt(np.where(np.isfinite(scatter), np.nan_to_num(scatter) ** 2 + drift, first))
    return out
