"""A move in stages: retract, rotate, extend, swing, approach; each in turns that all units have in common.

While phi is retracted theta may turn as it likes, so pairs can meet only while they retract, extend, swing or
approach. A unit whose turn comes later waits by pauses of its table. One whose arm would sweep over another's
while it extends does so beside its goal, and swings in by theta.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np

from fiberloom.drive.desi.clock import (
    APPROACH_STEPS,
    FINAL_DIRECTION,
    PAUSE_TICKS,
    TICK_HZ,
    degrees_of,
    tenths_of,
)
from fiberloom.drive.desi.paths import FieldPath, executed_path
from fiberloom.drive.desi.tables import MoveTables, leg_steps
from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan, Trajectory
from fiberloom.typing import Flags, Floats, Ints

STAGES = 5
LEGS = STAGES - 1
_SPARE_TICKS = 6 * PAUSE_TICKS
"""Between turns: pauses are whole milliseconds, rounded up in each row."""


class MoveStage(IntEnum):
    """What happens in a stage."""

    RETRACT = 0
    ROTATE = 1
    EXTEND = 2
    SWING = 3
    APPROACH = 4


class Level(IntEnum):
    """How much of its move a unit makes."""

    WHOLE = 0
    NOT_EXTENDED = 1
    RETRACTED = 2
    STILL = 3


@dataclass(frozen=True, eq=False)
class Staged:
    """What N units shall do; fields that say who waits for whom are changed until nothing meets."""

    legs: Ints
    """(N, LEGS, 2) ways of all stages before the approach, tenths of a motor deg."""
    level: Ints
    """(N,) `Level`."""
    turn: Ints
    """(N, STAGES) when a unit's turn comes in each stage, from 0."""

    @property
    def reduced(self) -> Ints:
        """(N, LEGS, 2) ways of what each unit makes of its move."""
        last = np.array([LEGS, 2, 1, 0])[self.level]
        return np.where(np.arange(LEGS)[None, :, None] < last[:, None, None], self.legs, 0)

    @property
    def moves(self) -> Flags:
        """(N,) who has anything to do."""
        return np.asarray(self.reduced.any(axis=(1, 2)))

    def swung(self, unit: int, swing_deg: float) -> Staged:
        """The same with one that extends so far beside its goal, in deg of theta, and swings in."""
        legs, beside = self.legs.copy(), int(tenths_of(swing_deg))
        legs[unit, MoveStage.ROTATE, 0] += legs[unit, MoveStage.SWING, 0] + beside
        legs[unit, MoveStage.SWING, 0] = -beside
        return replace(self, legs=legs)


@dataclass(frozen=True, eq=False)
class Timed:
    """Tables of a staged move, and when each unit is on in each stage."""

    tables: MoveTables
    begin_tick: Ints
    """(N, STAGES)."""
    end_tick: Ints
    """(N, STAGES) as the begin where a unit does nothing in a stage."""

    def active(self, unit: int, time_s: float) -> int | None:
        """The stage in which a unit moves at a time in s; None: it does not."""
        tick = time_s * TICK_HZ
        on = (self.begin_tick[unit] - 2 <= tick) & (tick <= self.end_tick[unit] + 2)
        on &= self.end_tick[unit] > self.begin_tick[unit]
        found = np.flatnonzero(on)
        return int(found[-1]) if len(found) else None


def staged(plane: FocalPlane, here_deg: Floats, way_deg: Floats, safe_deg: Floats, *, small: bool) -> Staged:
    """The stages of a move.

    `plane`: N positioners; `here_deg` and `way_deg` (N, 2): where they are, and how far they go;
    `safe_deg` (N,): phi from which on theta is free; `small`: all of the way at once, in the last stage
    before the approach.
    """
    n = len(plane)
    legs = np.zeros((n, LEGS, 2), dtype=np.int64)
    if small:
        legs[:, MoveStage.EXTEND] = tenths_of(way_deg)
    else:
        phi, goal = here_deg[:, 1], here_deg[:, 1] + way_deg[:, 1]
        moves = np.abs(way_deg).sum(axis=1) > 0.0
        first, second = np.maximum(phi, safe_deg), np.maximum(goal, safe_deg)
        corners = np.zeros((n, 4, 2))
        corners[:, 1:, 1] = np.column_stack([first - phi, second - phi, goal - phi])
        corners[:, 2:, 0] = way_deg[:, :1]
        legs[:, : MoveStage.SWING] = np.where(moves[:, None, None], np.diff(tenths_of(corners), axis=1), 0)
    return Staged(legs, np.zeros(n, dtype=np.int64), np.zeros((n, STAGES), dtype=np.int64))


def timed(move: Staged) -> Timed:
    """Tables of a staged move: each stage begins for all in turns, as long as the slowest of each."""
    n, goes = len(move.level), move.moves
    steps, cruise, rest = leg_steps(move.reduced)
    back = np.where(goes[:, None], APPROACH_STEPS * FINAL_DIRECTION, 0)
    last = back + np.where(goes[:, None], rest.sum(axis=1), 0)
    still, creeps = np.zeros((n, 1, 2), dtype=np.int64), np.zeros((n, 1, 2), dtype=bool)
    all_steps = np.concatenate([still, steps, -back[:, None], last[:, None]], axis=1)
    all_cruise = np.concatenate([creeps, cruise, creeps, creeps], axis=1)
    bare = MoveTables(all_steps, all_cruise, np.zeros(all_steps.shape[:2], dtype=np.int64))
    own = np.column_stack([bare.ticks[:, 1:STAGES], bare.ticks[:, -2:].sum(axis=1)])
    begin = _begins(own, move.turn)
    pause, begin = _pauses(bare.ticks, begin, own)
    return Timed(replace(bare, pause_ms=pause), begin, begin + own)


def _begins(own: Ints, turn: Ints) -> Ints:
    """(N, STAGES) wanted begins: turns of a stage one after another, stages one after another."""
    begin, now = np.zeros_like(own), 0
    for stage in range(STAGES):
        for k in range(int(turn[:, stage].max(initial=0)) + 1):
            whose = turn[:, stage] == k
            begin[whose, stage] = now
            longest = int(own[whose, stage].max(initial=0))
            now += longest + (_SPARE_TICKS if longest else 0)
    return begin


def _pauses(ticks: Ints, wanted: Ints, own: Ints) -> tuple[Ints, Ints]:
    """(N, rows) ms after each row so that stages begin as wanted, and (N, STAGES) when they really do."""
    n = len(ticks)
    rows, now, last = np.arange(n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    pause, begin = np.zeros(ticks.shape, dtype=np.int64), wanted.copy()
    for stage, row in enumerate(range(1, STAGES + 1)):
        used = own[:, stage] > 0
        wait = np.where(used, np.maximum(-((now - wanted[:, stage]) // PAUSE_TICKS), 0), 0)
        pause[rows, last] += wait
        now = now + PAUSE_TICKS * wait
        begin[:, stage] = np.where(used, now, wanted[:, stage])
        now = now + own[:, stage]
        last = np.where(used, row + (stage == MoveStage.APPROACH), last)
    return pause, begin


@dataclass(frozen=True, eq=False)
class Aims:
    """Where arms are and where their counts take them: what turns counts into angles."""

    here_deg: Floats
    """(N, 2) of the arms."""
    error_deg: Floats
    """(N, 2) by which arms go beyond what is counted, over the whole move."""
    refused: dict[int, str] = field(default_factory=dict)


def plan_of(plane: FocalPlane, made: Timed, aims: Aims, play_deg: tuple[float, float] = (0.0, 0.0)) -> Plan:
    """The way that arms of a `plane` go by tables, with a corner wherever a motor changes.

    `made`: the tables; `aims`: where they begin and end; `play_deg` of theta and phi: a motor that turns
    against its final direction moves its arm only when that is used up.
    """
    path = _finer(executed_path(made.tables)) if any(play_deg) else executed_path(made.tables)
    total = np.abs(path.tenths[:, -1:]) + 1e-9
    share = np.clip(np.abs(path.tenths) / total, 0.0, 1.0)
    counted = _behind(degrees_of(path.tenths), np.array(play_deg))
    angles = np.round(aims.here_deg[:, None] + counted + share * aims.error_deg[:, None], 9)
    moves = made.tables.rows > 0
    robots = []
    for row, number in enumerate(plane.positioner_id.tolist()):
        if not moves[row]:
            at = np.round(aims.here_deg[row], 9)
            robots.append(Trajectory(number, np.zeros(1), at[:1], at[1:]))
            continue
        keep = np.append(np.diff(path.tick[row]) > 0, True)
        time_s = np.round(path.tick[row, keep] / TICK_HZ, 6)
        robots.append(Trajectory(number, time_s, *angles[row, keep].T))
    return Plan(
        instrument=plane.instrument.name,
        collision_buffer_mm=plane.collision_buffer_mm,
        robots=tuple(robots),
        refused=aims.refused,
        statistics={},
    )


def _finer(path: FieldPath) -> FieldPath:
    """With three more corners between any two: play is used up within a leg."""
    parts = np.arange(4) / 4
    first, last = path.tick[:, :-1, None], path.tick[:, 1:, None]
    tick = np.rint(first + parts * (last - first)).astype(np.int64).reshape(len(path.tick), -1)
    tick = np.concatenate([tick, path.tick[:, -1:]], axis=1)
    return FieldPath(tick, path.at(tick))


def _behind(counted_deg: Floats, play_deg: Floats) -> Floats:
    """(N, K, 2) deg of arms behind counts (N, K, 2), with plays (2,) that are closed at first."""
    if not play_deg.any():
        return counted_deg
    low, high = np.where(FINAL_DIRECTION < 0, -play_deg, 0.0), np.where(FINAL_DIRECTION > 0, play_deg, 0.0)
    out, at = np.empty_like(counted_deg), np.zeros_like(counted_deg[:, 0])
    for k in range(counted_deg.shape[1]):
        at = np.clip(at, counted_deg[:, k] + low, counted_deg[:, k] + high)
        out[:, k] = at
    return out
