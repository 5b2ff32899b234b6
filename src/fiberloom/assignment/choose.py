"""The choice itself: a packing of candidates, solved to optimality as a mixed-integer programme.

Each positioner takes at most one target, each target at most one positioner, and no two arms come
too near. The last rule is written as cliques: a candidate against *all* that it conflicts with at
one neighbour, of which one at most is taken anyway; with these the linear relaxation is nearly
whole, and HiGHS closes 500 positioners and 1500 targets at the root.
"""

from collections.abc import Iterator

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, OptimizeResult, milp
from scipy.sparse import csc_array, csr_array, vstack

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
MAX_CHOICES = 40
"""Candidates per positioner: more make long lists slow and hardly ever better."""
PAIRS_AT_ONCE = 200_000
"""Bound on memory."""
MAX_NODES = 2000
"""Bound on the search, not on time: the same answer on a slow machine."""


def conflicts(
    plane: FocalPlane, positioner: Ints, target: Ints, segments: Floats, limit_mm: float
) -> tuple[Ints, Ints]:
    """Pairs of candidates (rows; sorted by positioner) that come nearer than the limit.

    `positioner` and `target` (C,): rows of the `plane` and of the target list; `segments` (C, POSES, 4)
    mm: centre lines of the arm at the goal and on the approach; `limit_mm`: least distance of two
    centre lines. Pairs on the same target are left out: they exclude each other anyway.
    """
    all_places = places(segments)
    found = [np.empty((0, 2), dtype=np.int64)]
    for a, b in _neighbouring(plane, positioner):
        other = target[a] != target[b]
        a, b = a[other], b[other]
        near = too_near(all_places, a, all_places, b, limit_mm)
        found.append(np.column_stack([a[near], b[near]]))
    first, second = np.concatenate(found).T
    return first, second


def _neighbouring(plane: FocalPlane, positioner: Ints) -> Iterator[tuple[Ints, Ints]]:
    """All pairs of candidates of neighbours, in portions that fit the memory."""
    start = np.searchsorted(positioner, np.arange(plane.n + 1)).tolist()
    first, second, size = [], [], 0
    for i, j in plane.neighbour_pairs(1.0).tolist():
        a, b = np.arange(start[i], start[i + 1]), np.arange(start[j], start[j + 1])
        first.append(np.repeat(a, len(b)))
        second.append(np.tile(b, len(a)))
        size += len(a) * len(b)
        if size > PAIRS_AT_ONCE:
            yield np.concatenate(first), np.concatenate(second)
            first, second, size = [], [], 0
    if first:
        yield np.concatenate(first), np.concatenate(second)


def shortlist(positioner: Ints, level: Ints, rng: np.random.Generator) -> Flags:
    """(C,) the MAX_CHOICES candidates of highest level of each positioner."""
    tie = rng.random(len(positioner))
    order = np.lexsort((tie, -level, positioner))
    ranked = positioner[order]
    place = np.arange(len(order)) - np.searchsorted(ranked, ranked)
    keep = np.zeros(len(order), dtype=bool)
    keep[order[place < MAX_CHOICES]] = True
    return keep


def levels_of(priority: Floats) -> Ints:
    """Priority levels (n,) from 0 (lowest) up, at most MAX_LEVELS of them; `priority` (n,) is
    dimensionless.
    """
    values, level = np.unique(priority, return_inverse=True)
    if len(values) <= MAX_LEVELS:
        return level
    rank = np.argsort(np.argsort(priority, kind="stable"), kind="stable")
    band = rank * MAX_LEVELS // len(priority)
    # equal priorities stay in one band: that of their first
    lowest = np.full(len(values), MAX_LEVELS)
    np.minimum.at(lowest, level, band)
    return lowest[level]


def pack(
    positioner: Ints,
    target: Ints,
    level: Ints,
    pairs: tuple[Ints, Ints],
    rng: np.random.Generator,
) -> tuple[Flags, bool]:
    """(C,) the chosen candidates, and whether the choice is proven to be the best.

    `positioner`, `target` and `level` (C,): rows of the plane and of the target list, and the priority
    level; `pairs`: two arrays of candidates that exclude each other. Solved from the highest levels
    down, LEVELS_AT_ONCE together, LEVELS_SETTLED of them for good; with more levels than that nothing is
    proven. `rng` decides between equally good choices.
    """
    if not len(positioner):
        return np.zeros(0, dtype=bool), True
    order = rng.permutation(len(positioner))
    packing = _Packing(_exclusions(positioner, target, pairs)[:, order], target[order], level[order])
    if not packing.solve():
        return _greedy(positioner, target, level, pairs), False
    chosen = np.zeros(len(positioner), dtype=bool)
    chosen[order] = packing.chosen
    return chosen, packing.proven


class _Packing:
    """Solves windows of levels from the highest one down."""

    def __init__(self, rules: csc_array, target: Ints, level: Ints) -> None:
        self.rules, self.target, self.level = rules, target, level
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
        result = _solve(value, [LinearConstraint(self.rules[:, rows], -np.inf, 1.0), *self._served(rows)])
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
        shape = (len(self.settled), len(rows))
        served = csr_array((np.ones(len(row)), (row, column)), shape=shape)
        return [LinearConstraint(served, 1.0, np.inf)] if len(self.settled) else []

    def _settle(self, done: Flags) -> None:
        """Targets of the levels that are `done` are served, or out."""
        self.settled = np.unique(self.target[self.chosen & done])
        self.open &= ~done | np.isin(self.target, self.settled)


def _solve(value: Floats, rules: list[LinearConstraint]) -> OptimizeResult:
    return milp(
        -value,
        constraints=rules,
        bounds=Bounds(0.0, 1.0),
        integrality=np.ones(len(value)),
        options={"node_limit": MAX_NODES, "mip_rel_gap": 0.0},
    )


def _exclusions(positioner: Ints, target: Ints, pairs: tuple[Ints, Ints]) -> csc_array:
    """One row per set of candidates of which at most one may be taken."""
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
