"""Do bodies touch in a plan? By dense samples of every pair, without the verifier's code or the core's
geometry.

Between two moments no point of an arm moves farther than the integral of |d alpha| (l_alpha + far) + |d
beta| far. With gaps g0, g1 at the ends of an interval and such ways w1, w2 of the two arms in it, the gap
in it is at least (g0 + g1 - w1 - w2) / 2. Intervals in which this does not decide are sampled again, eight
times as densely. The answer is sure; where it would depend on less than `DOUBT_MM` it is left open.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from fiberloom.planning import Plan, Trajectory
from fiberloom.typing import Floats

from .bodies import Bodies, between

SAMPLE_S = 0.05
FINER = 8
DOUBT_MM = 2e-6
"""The verifier calls a gap below -1e-6 mm a collision: at half of it and at twice it nobody can be blamed."""
MOST = 200_000
"""So many intervals of one pair are looked at; more leave it open."""
SHORTEST_S = 1e-11
"""Nor shorter ones."""


class Answer(StrEnum):
    """Of the oracle."""

    TOUCH = "touch"
    CLEAR = "clear"
    OPEN = "open"


@dataclass(frozen=True)
class Way:
    """The motion of one arm, linear between its points."""

    row: int
    time_s: Floats
    alpha: Floats
    """rad"""
    beta: Floats
    path_mm: Floats
    """How far any of its points can have moved until then."""

    @classmethod
    def of(cls, bodies: Bodies, robot: Trajectory) -> Way:
        """In rad, with its path."""
        row = bodies.row_of(robot.positioner_id)
        alpha, beta = np.radians(robot.alpha_deg), np.radians(robot.beta_deg)
        step = (
            np.abs(np.diff(alpha)) * (bodies.l_alpha[row] + bodies.far) + np.abs(np.diff(beta)) * bodies.far
        )
        return cls(row, robot.time_s, alpha, beta, np.concatenate([[0.0], np.cumsum(step)]))

    @property
    def moves(self) -> bool:
        """Does it go anywhere?"""
        return len(self.time_s) > 1

    def at(self, bodies: Bodies, when_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Ends of its centre line (complex, mm) and path until then."""
        alpha, beta, path = (np.interp(when_s, self.time_s, x) for x in (self.alpha, self.beta, self.path_mm))
        return *bodies.lines(self.row, alpha, beta), path


@dataclass
class Scene:
    """A plan with its bodies; samples of a motion are kept, for most mutants change one of many."""

    bodies: Bodies
    buffer_mm: float
    ways: dict[int, Way]
    when_s: Floats
    kept: dict[int, tuple[Floats, Floats, Floats]]

    @classmethod
    def of(cls, bodies: Bodies, plan: Plan, longest_s: float) -> Scene:
        """Sampled from 0 to `longest_s`, the longest that a mutant of it may last."""
        ways = [Way.of(bodies, robot) for robot in plan.robots]
        when_s = np.arange(0.0, longest_s + SAMPLE_S, SAMPLE_S)
        return cls(bodies, plan.collision_buffer_mm, {way.row: way for way in ways}, when_s, {})

    def with_others(self, ways: Iterable[Way]) -> Scene:
        """With other motions of some."""
        new = {way.row: way for way in ways}
        kept = {row: found for row, found in self.kept.items() if row not in new}
        return Scene(self.bodies, self.buffer_mm, self.ways | new, self.when_s, kept)

    def sampled(self, row: int) -> tuple[Floats, Floats, Floats]:
        """An arm at all of the times."""
        if row not in self.kept:
            self.kept[row] = self.ways[row].at(self.bodies, self.when_s)
        return self.kept[row]

    def pairs_of(self, rows: Iterable[int]) -> list[tuple[int, int]]:
        """(row, other row) and (row, -1 - obstacle) of these rows where something moves."""
        out: dict[tuple[int, int], None] = {}
        for row in rows:
            for other in map(int, self.bodies.neighbours(row, self.buffer_mm)):
                if self.ways[row].moves or self.ways[other].moves:
                    out[min(row, other), max(row, other)] = None
            if self.ways[row].moves:
                out |= {(row, -1 - int(k)): None for k in self.bodies.near_obstacles(row, self.buffer_mm)}
        return list(out)

    def gaps(self, pair: tuple[int, int], one: tuple[Floats, ...], two: tuple[Floats, ...]) -> Floats:
        """Beyond the buffers, mm."""
        apart = between(*one[:2], *two[:2])
        if pair[1] < 0:
            return apart - self.bodies.obstacles[-1 - pair[1], 4] - self.buffer_mm
        return apart - 2.0 * self.buffer_mm

    def places(self, pair: tuple[int, int], when_s: Floats | None) -> list[tuple[Floats, ...]]:
        """Both bodies of a pair at these times, or at the samples."""
        out: list[tuple[Floats, ...]] = []
        for row in pair:
            if row < 0:
                x0, y0, x1, y1, _ = self.bodies.obstacles[-1 - row]
                out.append((np.array(complex(x0, y0)), np.array(complex(x1, y1)), np.array(0.0)))
            elif when_s is None:
                out.append(self.sampled(row))
            else:
                out.append(self.ways[row].at(self.bodies, when_s))
        return out


def answer(scene: Scene, rows: Iterable[int]) -> Answer:
    """Whether something that moves touches anything, of all pairs of these rows."""
    open_ = False
    for pair in scene.pairs_of(rows):
        found, _ = _looked(scene, pair, None)
        if found == Answer.TOUCH:
            return found
        open_ |= found == Answer.OPEN
    return Answer.OPEN if open_ else Answer.CLEAR


def least_gap(scene: Scene, rows: Iterable[int], within_mm: float) -> float:
    """The smallest gap of all pairs of these rows, mm, to `within_mm`; below -2 buffers it does not go."""
    least = np.inf
    for pair in scene.pairs_of(rows):
        least = min(least, _looked(scene, pair, (least, within_mm))[1])
    return float(least)


def _looked(scene: Scene, pair: tuple[int, int], than: tuple[float, float] | None) -> tuple[Answer, float]:
    """One pair: whether it touches or, with `than` (least so far, within), how near it comes."""
    when_s, places, least, seen = scene.when_s, scene.places(pair, None), np.inf, 0
    while True:
        gaps = scene.gaps(pair, *places)
        least = min(least, float(gaps.min()))
        if than is None and least < -DOUBT_MM:
            return Answer.TOUCH, least
        ways = [np.diff(np.broadcast_to(place[2], gaps.shape), axis=0) for place in places]
        floor = (gaps[:-1] + gaps[1:] - ways[0] - ways[1]) / 2.0
        bar = -DOUBT_MM / 4 if than is None else min(than[0], least) - than[1]
        left = np.nonzero(floor < bar)
        if not len(left[0]):
            return Answer.CLEAR, least
        begin, end = when_s[:-1][left], when_s[1:][left]
        seen += len(begin)
        if seen > MOST or float((end - begin).max()) < SHORTEST_S:
            return Answer.OPEN, least
        # each of these intervals becomes a column of times
        when_s = begin + (end - begin) * np.linspace(0.0, 1.0, FINER + 1)[:, None]
        places = scene.places(pair, when_s)
