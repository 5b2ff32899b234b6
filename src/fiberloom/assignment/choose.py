"""The choice itself: a packing of candidates, solved to optimality as a mixed-integer programme.

Each positioner takes at most one target, each target at most one positioner, and no two arms come
too near. The last rule is written as cliques: a candidate against *all* that it conflicts with at
one neighbour, of which one at most is taken anyway; with these the linear relaxation is nearly
whole, and HiGHS closes 500 positioners and 1500 targets at the root.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, OptimizeResult, milp
from scipy.sparse import csc_array, csr_array, vstack

from fiberloom.assignment.candidates import Candidates, WayRule
from fiberloom.assignment.clearance import places, too_near
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints

LEVEL_WEIGHT = 10.0
"""One target of a priority level is worth ten of the next lower level."""
LEVELS_AT_ONCE = 5
"""Levels per solution: weights from 1 to 1e4 keep the sums exact for the solver."""
LEVELS_SETTLED = 2
"""Of these, the highest: which of their targets are served stays as it is. The three below have had their say
where targets of one level can stand for each other; measured: at most 1 of 1150 targets fewer."""
MAX_LEVELS = 15
"""More different priorities are put into so many bands of equal size."""
STRICT_LEVELS = 60
"""The same where levels are strict."""
STRICT_WEIGHT = 2e4
"""Strict levels share a solution as long as their weights stay below this, for the solver's tolerances."""
MAX_CHOICES = 40
"""Candidates per positioner: more make long lists slow and hardly ever better."""
STRICT_CHOICES = 160
"""The same where levels are strict: what is left out is not proven to be of no use."""
PAIRS_AT_ONCE = 200_000
"""Bound on memory."""
MAX_NODES = 2000
"""Bound on the search, not on time: the same answer on a slow machine."""


@dataclass(frozen=True)
class Wish:
    """What a choice is to be, beside allowed."""

    strict: bool = False
    """No number of targets outweighs one of a higher level."""
    cost: Floats | None = None
    """(C,) from 0 up, dimensionless, of each candidate; of equally good choices the one of the least sum."""

    @property
    def most_choices(self) -> int:
        """Candidates per positioner."""
        return STRICT_CHOICES if self.strict else MAX_CHOICES

    @property
    def most_levels(self) -> int:
        """So many different priorities are told apart."""
        return STRICT_LEVELS if self.strict else MAX_LEVELS

    def select(self, rows: Ints | Flags) -> "Wish":
        """For some of the candidates."""
        return self if self.cost is None else replace(self, cost=self.cost[rows])


ANY = Wish()


def conflicts(
    plane: FocalPlane,
    found: Candidates,
    segments: Floats,
    limit_mm: float,
    ways: WayRule | None = None,
) -> tuple[Ints, Ints]:
    """Pairs of candidates (rows; sorted by positioner) that come nearer than the limit, or bar ways.

    `found`: C candidates on the `plane`; `segments` (C, POSES, P, 4) mm: centre lines of the arm at the goal
    and on the approach; `limit_mm`: least gap between two arms; `ways`: what the drive asks. Pairs on the
    same target are left out: they exclude each other anyway.
    """
    positioner, target = found.positioner, found.target
    all_places = places(plane, positioner, segments)
    pairs = [np.empty((0, 2), dtype=np.int64)]
    for a, b in _neighbouring(plane, positioner):
        other = target[a] != target[b]
        a, b = a[other], b[other]
        near = too_near(all_places, a, all_places, b, limit_mm)
        if ways is not None:
            apart = np.flatnonzero(~near)
            near[apart] = ways.crossing(positioner, found.goal_deg, a[apart], b[apart])
        pairs.append(np.column_stack([a[near], b[near]]))
    first, second = np.concatenate(pairs).T
    return first, second


def _neighbouring(plane: FocalPlane, positioner: Ints) -> Iterator[tuple[Ints, Ints]]:
    """All pairs of candidates of neighbours, in portions that fit the memory."""
    start = np.searchsorted(positioner, np.arange(plane.n + 1))
    count = np.diff(start)
    one, other = plane.neighbour_pairs(1.0).T
    size = count[one] * count[other]
    portion = np.cumsum(size) // PAIRS_AT_ONCE
    for rows in np.split(np.arange(len(size)), np.flatnonzero(np.diff(portion)) + 1):
        # the candidates of one after the other, each with all of the other positioner
        ends = np.cumsum(size[rows])
        place = np.arange(size[rows].sum()) - np.repeat(ends - size[rows], size[rows])
        wide = np.repeat(count[other[rows]], size[rows])
        first = np.repeat(start[one[rows]], size[rows]) + place // wide
        yield first, np.repeat(start[other[rows]], size[rows]) + place % wide


def shortlist(positioner: Ints, level: Ints, rng: np.random.Generator, wish: Wish = ANY) -> Flags:
    """(C,) the candidates of highest `level` (C,) of each `positioner` (C,), `wish.most_choices` of them; of
    equals those of least cost, or by `rng`.
    """
    tie = rng.random(len(positioner)) if wish.cost is None else wish.cost
    order = np.lexsort((tie, -level, positioner))
    ranked = positioner[order]
    place = np.arange(len(order)) - np.searchsorted(ranked, ranked)
    keep = np.zeros(len(order), dtype=bool)
    keep[order[place < wish.most_choices]] = True
    return keep


def levels_of(priority: Floats, most: int = MAX_LEVELS) -> Ints:
    """Priority levels (n,) from 0 (lowest) up, at most `most` of them; `priority` (n,) is
    dimensionless.
    """
    values, level = np.unique(priority, return_inverse=True)
    if len(values) <= most:
        return level
    rank = np.argsort(np.argsort(priority, kind="stable"), kind="stable")
    band = rank * most // len(priority)
    # equal priorities stay in one band: that of their first
    lowest = np.full(len(values), most)
    np.minimum.at(lowest, level, band)
    return lowest[level]


def pack(
    positioner: Ints,
    target: Ints,
    level: Ints,
    pairs: tuple[Ints, Ints],
    rng: np.random.Generator,
    wish: Wish = ANY,
) -> tuple[Flags, bool]:
    """(C,) the chosen candidates, and whether the choice is proven to be the best.

    `positioner`, `target` and `level` (C,): rows of the plane and of the target list, and the priority
    level; `pairs`: two arrays of candidates that exclude each other. Solved from the highest levels
    down, LEVELS_AT_ONCE together, LEVELS_SETTLED of them for good; with more levels than that nothing is
    proven, unless the `wish` is for strict levels. Of equally good choices it is the one of the least sum
    of costs, where the wish has some; else `rng` decides.
    """
    if not len(positioner):
        return np.zeros(0, dtype=bool), True
    order = rng.permutation(len(positioner))
    rules = exclusions(positioner, target, pairs)[:, order]
    kind = _StrictPacking if wish.strict else _Packing
    room = len(np.unique(positioner))
    packing = kind(rules, target[order], level[order], _tie(wish, room, len(order))[order], room)
    if not packing.solve():
        return _greedy(positioner, target, level, pairs), False
    chosen = np.zeros(len(positioner), dtype=bool)
    chosen[order] = packing.chosen
    return chosen, packing.proven


def exchange(
    positioner: Ints, target: Ints, kind: Ints, pairs: tuple[Ints, Ints], numbers: Ints, cost: Floats
) -> Flags | None:
    """(C,) the candidates of the least sum of costs of which exactly `numbers` of each kind are chosen.

    `positioner`, `target` (C,) and `pairs` as in `pack`; `kind` (C,): number of the priority of each, from
    0 up; `numbers`: so many of each kind; `cost` (C,): from 0 up, dimensionless. None: no choice was found.
    """
    same = csr_array((np.ones(len(kind)), (kind, np.arange(len(kind)))), shape=(len(numbers), len(kind)))
    rules = [
        LinearConstraint(exclusions(positioner, target, pairs), -np.inf, 1.0),
        LinearConstraint(same, numbers, numbers),
    ]
    result = _solve(-cost, rules)
    return None if result.x is None else result.x > 0.5


def _tie(wish: Wish, room: int, n: int) -> Floats:
    """(n,) costs, so small that those of `room` positioners are less than one target of the lowest level."""
    if wish.cost is None or not wish.cost.any():
        return np.zeros(n)
    tie: Floats = wish.cost / (2.0 * wish.cost.max() * room)
    return tie


class _Packing:
    """Solves windows of levels from the highest one down."""

    def __init__(self, rules: csc_array, target: Ints, level: Ints, tie: Floats, room: int) -> None:
        """`rules`: sets of candidates of which one may be taken; `target`, `level`, `tie` (C,) of each;
        `room`: positioners."""
        self.rules, self.target, self.level, self.tie, self.room = rules, target, level, tie, room
        self.open = np.ones(len(target), dtype=bool)
        self.settled = np.zeros(0, dtype=np.int64)  # targets that must be served
        self.chosen = np.zeros(len(target), dtype=bool)
        self.proven = True

    def solve(self) -> bool:
        """All windows; False where the solver gives nothing."""
        top = int(self.level.max())
        while True:
            low = max(top - LEVELS_AT_ONCE + 1, 0)
            if not self._window(low):
                return False
            if low == 0:
                return True
            top -= LEVELS_SETTLED
            self._settle(self.level > top)
            self.proven = False

    def _window(self, low: int) -> bool:
        """Chooses among the levels from `low` up."""
        rows = np.flatnonzero(self.open & (self.level >= low))
        settled = np.isin(self.target[rows], self.settled)
        value = np.power(LEVEL_WEIGHT, (self.level[rows] - low).astype(np.float64))
        value[settled] = 0.0  # they are served anyway
        return self._choose(rows, value, self._served(rows))

    def _choose(self, rows: Ints, value: Floats, more: list[LinearConstraint]) -> bool:
        """Chooses among these candidates (rows) by their `value`, whole numbers; `more`: further rules."""
        rules = [LinearConstraint(self.rules[:, rows], -np.inf, 1.0), *more]
        result = _solve(value - self.tie[rows], rules)
        self.proven &= result.status == 0
        if result.x is None:
            return False
        self.chosen[:] = False
        self.chosen[rows] = result.x > 0.5
        return True

    def _served(self, rows: Ints) -> list[LinearConstraint]:
        """Every settled target has a positioner."""
        column = np.flatnonzero(np.isin(self.target[rows], self.settled))
        row = np.searchsorted(self.settled, self.target[rows][column])
        return _at_least(row, column, np.ones(len(self.settled)), len(rows))

    def _settle(self, done: Flags) -> None:
        """Targets of the levels that are `done` are served, or out."""
        self.settled = np.unique(self.target[self.chosen & done])
        self.open &= ~done | np.isin(self.target, self.settled)


class _StrictPacking(_Packing):
    """Strictly one level after the other, each solution as many levels as proven weights allow.

    With R the most targets that the levels below can have served, one target of a level weighs more than
    all that they can bring. Levels that are done must keep the number of targets served, not these targets.
    """

    def solve(self) -> bool:
        """All windows; False where the solver gives nothing."""
        there = [len(np.unique(self.target[self.level == k])) for k in range(int(self.level.max()) + 1)]
        room, top = self.room, len(there) - 1
        served: dict[int, int] = {}
        while top >= 0 and room > 0:
            weight = _strict_weights(there[: top + 1], room)
            low = top + 1 - len(weight)
            if not self._strict_window(low, weight, served):
                return False
            for k in range(low, top + 1):
                served[k] = int(np.count_nonzero(self.chosen & (self.level == k)))
                room -= served[k]
            top = low - 1
        return True

    def _strict_window(self, low: int, weight: list[float], served: dict[int, int]) -> bool:
        """Chooses among the levels from `low` up, of which those `served` keep their numbers."""
        rows = np.flatnonzero(self.level >= low)
        # what is done counts too: it changes nothing, since its numbers are fixed, and leads the solver
        worth = np.array(weight + [weight[-1]] * len(served))
        column = np.flatnonzero(self.level[rows] >= low + len(weight))
        row = self.level[rows][column] - low - len(weight)
        numbers = np.array([served[k] for k in sorted(served)], dtype=np.float64)
        return self._choose(rows, worth[self.level[rows] - low], _at_least(row, column, numbers, len(rows)))


def _strict_weights(there: list[int], room: int) -> list[float]:
    """Weights of the highest levels that share a solution, the lowest first: each more than all below it.

    `there`: targets of each level, from the lowest up; `room`: most targets that can be served together.
    """
    for n in range(len(there), 0, -1):
        weight, below = [1.0], 0.0
        for count in there[len(there) - n : -1]:
            below = min(below + min(count, room) * weight[-1], room * weight[-1])
            weight.append(below + 1.0)
        if weight[-1] <= STRICT_WEIGHT:
            break
    return weight


def _at_least(row: Ints, column: Ints, least: Floats, width: int) -> list[LinearConstraint]:
    """Of the candidates in each row (`row`, `column`) at least so many are chosen."""
    if not len(least):
        return []
    matrix = csr_array((np.ones(len(row)), (row, column)), shape=(len(least), width))
    return [LinearConstraint(matrix, least, np.inf)]


def _solve(value: Floats, rules: list[LinearConstraint]) -> OptimizeResult:
    return milp(
        -value,
        constraints=rules,
        bounds=Bounds(0.0, 1.0),
        integrality=np.ones(len(value)),
        options={"node_limit": MAX_NODES, "mip_rel_gap": 0.0},
    )


def exclusions(positioner: Ints, target: Ints, pairs: tuple[Ints, Ints]) -> csc_array:
    """(R, C) one row per set of candidates of which at most one may be taken.

    `positioner`, `target` (C,): rows of the plane and of the target list; `pairs`: two arrays of candidates
    that exclude each other.
    """
    n = len(positioner)
    a, b = np.concatenate(pairs), np.concatenate(pairs[::-1])
    wide = int(positioner.max()) + 1
    key, row = np.unique(a * wide + positioner[b], return_inverse=True)
    ones = np.ones(len(key) + len(b))
    rows = np.concatenate([np.arange(len(key)), row])
    cliques = csr_array((ones, (rows, np.concatenate([key // wide, b]))), shape=(len(key), n))
    each = np.arange(n)
    singles = [csr_array((np.ones(n), (key, each))) for key in (positioner, target)]
    return vstack([*singles, cliques], format="csc")


def _greedy(positioner: Ints, target: Ints, level: Ints, pairs: tuple[Ints, Ints]) -> Flags:
    """Highest level first, whatever is still free: only if the solver gives nothing."""
    chosen = np.zeros(len(positioner), dtype=bool)
    open_ = np.ones(len(positioner), dtype=bool)
    a, b = np.concatenate(pairs), np.concatenate(pairs[::-1])
    for c in np.argsort(-level, kind="stable").tolist():
        if open_[c]:
            chosen[c] = True
            open_ &= (positioner != positioner[c]) & (target != target[c])
            open_[b[a == c]] = False
    return chosen
