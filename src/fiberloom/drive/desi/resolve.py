"""Who waits for whom, and who goes less far, until the verifier finds no contact on the way."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from fiberloom.drive.desi.clock import LAG_DEG, degrees_of
from fiberloom.drive.desi.stages import Aims, Level, MoveStage, Staged, Timed, plan_of, timed
from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan, Verification, verify
from fiberloom.planning.verification import MotionLimits, Violation
from fiberloom.typing import Floats

MOST_TURNS = 3
"""Of a stage: each makes all others wait."""
ROUNDS = 40
_HARD_AFTER = 30
"""Rounds after which no more orders are tried."""
SWINGS_DEG = np.array([20.0, -20.0, 40.0, -40.0, 70.0, -70.0])
"""[A] So far beside its goal an arm extends that would sweep over another one there, in turn."""
CLOCK = MotionLimits(speed_deg_s=300.0, acceleration_deg_s2=1e6, separating=True)
"""The clock of the motors sees to speeds and ramps: a path has corners a tick apart, with times rounded to
1 us, and waves of gears on it. Arms that stand nearer than their tubes may move apart."""
_WHY = {
    Level.NOT_EXTENDED: "it would meet {other} when it extends; it stays retracted",
    Level.RETRACTED: "it would meet {other} when it rotates; it stays retracted",
    Level.STILL: "it would meet {other}; it stays where it is",
}


def proven(plane: FocalPlane, plans: Iterable[Plan]) -> Verification:
    """What the verifier finds on ways that tables make arms go: the first that is not safe, else the last."""
    for plan in plans:
        found = verify(plane, plan, limits=CLOCK)
        if not found.ok:
            return found
    return found


@dataclass(frozen=True, eq=False)
class Resolved:
    """A move without contacts."""

    move: Staged
    made: Timed
    plan: Plan
    """Of gears without play."""
    loose: Plan
    """Of gears with as much as the instrument allows."""
    rounds: int
    waits: int
    """Units that wait for another."""


class Resolver:
    """Orders the turns of a staged move of N units and holds back those that find none."""

    def __init__(self, plane: FocalPlane, move: Staged, ends: Callable[[Staged], Aims]) -> None:
        """`plane`: with tubes; `move`: all whole, in the first turn; `ends`: angles of a reduced move."""
        self.plane, self.move, self.ends = plane, move, ends
        self._tried: Counter[tuple[int, int, int]] = Counter()
        self.refused: dict[int, str] = {}
        goal = ends(move).here_deg + degrees_of(move.legs.sum(axis=1))
        low, high = plane.limits_of()[:, 0].T
        ways = goal[:, :1] + SWINGS_DEG
        # a move that is straight and at once has no swings
        self._may_swing = (ways >= low[:, None]) & (ways <= high[:, None])
        self._may_swing &= not move.legs[:, MoveStage.EXTEND, 0].any()

    def resolve(self) -> Resolved:
        """Rounds of verifying and mending; where that does not end, those that still meet others stay."""
        for count in range(1, ROUNDS + 1):
            made, plan, loose = self._made()
            found = proven(self.plane, (plan, loose))
            if found.ok:
                waits = int((self.move.turn > 0).any(axis=1).sum())
                return Resolved(self.move, made, plan, loose, count, waits)
            for violation in found.violations:
                if violation in found.contacts:
                    continue  # of bodies that do not move
                self._mend(made, violation, hard=count > _HARD_AFTER)
        self._hold_back(np.flatnonzero(self.move.moves), "the others, in any order that was tried")
        made, plan, loose = self._made()
        return Resolved(self.move, made, plan, loose, ROUNDS, 0)

    def _made(self) -> tuple[Timed, Plan, Plan]:
        made = timed(self.move)
        aims = replace(self.ends(self.move), refused=dict(self.refused))
        theta, phi = (axis.backlash_deg + 2.0 * LAG_DEG for axis in self.plane.instrument.axes)
        return made, plan_of(self.plane, made, aims), plan_of(self.plane, made, aims, (theta, phi))

    def _mend(self, made: Timed, violation: Violation, hard: bool) -> None:
        """Another order of two that meet, or less of a way; `hard`: no more orders are tried."""
        first = int(self.plane.index_of(violation.positioner_id))
        second = int(self.plane.index_of(int(violation.other))) if violation.other.isdigit() else None
        stage_of = {row: made.active(row, violation.time_s) for row in (first, second) if row is not None}
        moving = [row for row, stage in stage_of.items() if stage is not None]
        if not moving:
            self._at_an_end(list(stage_of), violation)
            return
        row = moving[0]
        stage = int(stage_of[row] or 0)
        other = second if row == first else first
        if other is not None and not hard and self._reorder(row, other, stage):
            return
        if hard or not any(self._swing(one, stage_of[one]) for one in moving):
            name = f"positioner {self._name(other)}" if other is not None else violation.other
            self._shorten(row, stage, name or f"a limit ({violation.kind})")

    def _at_an_end(self, rows: list[int], violation: Violation) -> None:
        """They meet where one begins or ends: the one of the longer way makes less of it."""
        rows = [row for row in rows if self.move.moves[row]]
        if rows:
            row = max(rows, key=lambda k: int(np.abs(self.move.reduced[k]).sum()))
            other = (
                str(violation.positioner_id) if violation.other == str(self._name(row)) else violation.other
            )
            name = f"positioner {other}" if other.isdigit() else other or f"a limit ({violation.kind})"
            self._shorten(row, MoveStage.APPROACH, name)

    def _reorder(self, row: int, other: int, stage: int) -> bool:
        """Tries the one after the other, then the reverse; False: both were tried, or one does not move."""
        legs = self.move.reduced
        both = stage == MoveStage.APPROACH or (legs[row, stage].any() and legs[other, stage].any())
        pair = min(row, other), max(row, other), stage
        self._tried[pair] += 1
        if not (both and self.move.moves[[row, other]].all()) or self._tried[pair] > 2:
            return False
        early, late = pair[:2] if self._tried[pair] == 1 else pair[1::-1]
        turn = self.move.turn.copy()
        if self._tried[pair] == 2:
            turn[early, stage] = 0
        turn[late, stage] = turn[early, stage] + 1
        if turn[late, stage] >= MOST_TURNS:
            return False
        self.move = replace(self.move, turn=turn)
        return True

    def _swing(self, row: int, stage: int | None) -> bool:
        """Tries the next way beside its goal of one that extends or swings; False: none is left."""
        left = np.flatnonzero(self._may_swing[row])
        if stage not in (MoveStage.EXTEND, MoveStage.SWING) or not len(left):
            return False
        self._may_swing[row, left[0]] = False
        self.move = self.move.swung(row, float(SWINGS_DEG[left[0]]))
        return True

    def _shorten(self, row: int, stage: int, other: str) -> None:
        level = self.move.level.copy()
        levels = {MoveStage.SWING: 1, MoveStage.EXTEND: 1, MoveStage.ROTATE: 2, MoveStage.RETRACT: 3}
        below = levels.get(MoveStage(stage), level[row] + 1)
        legs = self.move.legs[row]
        level[row] = min(max(level[row] + 1, below), Level.STILL)
        # what has no earlier leg stands still
        while level[row] < Level.STILL and not legs[: Level.STILL - level[row]].any():
            level[row] += 1
        self.move = replace(self.move, level=level)
        why = _WHY[Level(int(level[row]))].format(other=other)
        self.refused[self._name(row)] = f"positioner {self._name(row)}: {why}"

    def _hold_back(self, rows: Iterable[int], other: str) -> None:
        for row in rows:
            level = self.move.level.copy()
            level[row] = Level.STILL
            self.move = replace(self.move, level=level)
            self.refused[self._name(row)] = (
                f"positioner {self._name(row)}: {_WHY[Level.STILL].format(other=other)}"
            )

    def _name(self, row: int) -> int:
        return int(self.plane.positioner_id[row])


def counted_deg(move: Staged) -> Floats:
    """(N, 2) deg that a reduced move counts."""
    return degrees_of(move.reduced.sum(axis=1))
