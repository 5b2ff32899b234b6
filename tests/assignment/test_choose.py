"""The packing against brute force."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom.assignment.choose import (
    LEVEL_WEIGHT,
    MAX_LEVELS,
    _greedy,
    levels_of,
    pack,
    shortlist,
)


@st.composite
def problems(draw):
    """Up to 4 positioners with up to 3 candidates each, random targets, levels, conflicts."""
    choices = [(p, t) for p in range(4) for t in draw(st.sets(st.integers(0, 5), max_size=3))]
    if not choices:
        choices = [(0, 0)]
    positioner, target = np.array(choices).T
    level = np.array(draw(st.lists(st.integers(0, 3), min_size=6, max_size=6)))[target]
    possible = [
        (a, b)
        for a in range(len(choices))
        for b in range(a)
        if positioner[a] != positioner[b] and target[a] != target[b]
    ]
    chosen = [p for p in possible if draw(st.booleans())]
    pairs = np.array(chosen, dtype=np.int64).reshape(-1, 2)
    return positioner, target, level, (pairs[:, 0], pairs[:, 1])


def is_allowed(chosen, positioner, target, pairs):
    for key in (positioner[chosen], target[chosen]):
        if len(np.unique(key)) < len(key):
            return False
    return not np.any(chosen[pairs[0]] & chosen[pairs[1]])


def best_value(positioner, target, level, pairs):
    worth = LEVEL_WEIGHT ** level.astype(float)
    per = [[-1, *np.flatnonzero(positioner == p)] for p in range(4)]
    best = 0.0
    for combination in product(*per):
        chosen = np.zeros(len(positioner), dtype=bool)
        chosen[[c for c in combination if c >= 0]] = True
        if is_allowed(chosen, positioner, target, pairs):
            best = max(best, worth[chosen].sum())
    return best


@given(problems(), st.integers(0, 100))
@settings(max_examples=60, deadline=None)
def test_no_choice_is_better(problem, seed):
    positioner, target, level, pairs = problem
    chosen, proven = pack(positioner, target, level, pairs, np.random.default_rng(seed))
    assert proven
    assert is_allowed(chosen, positioner, target, pairs)
    worth = LEVEL_WEIGHT ** level.astype(float)
    assert worth[chosen].sum() == pytest.approx(best_value(*problem))


@given(problems())
@settings(max_examples=30)
def test_the_fallback_is_allowed(problem):
    positioner, target, level, pairs = problem
    chosen = _greedy(positioner, target, level, pairs)
    assert chosen.any()
    assert is_allowed(chosen, positioner, target, pairs)


def test_many_levels_are_solved_from_the_top():
    # 12 levels in one positioner each: two targets compete, the higher level must win every time
    positioner = np.repeat(np.arange(11), 2)
    target = np.column_stack([np.arange(11), np.arange(1, 12)]).ravel()
    level = target.copy()
    none = np.empty(0, dtype=np.int64)
    chosen, proven = pack(positioner, target, level, (none, none), np.random.default_rng(0))
    assert proven
    assert sorted(level[chosen]) == list(range(1, 12))


def test_the_shortlist_keeps_the_highest_levels():
    rng = np.random.default_rng(0)
    positioner, level = np.repeat([2, 5, 9], [100, 10, 60]), rng.integers(0, 5, 170)
    keep = shortlist(positioner, level, rng)
    for row, n in ((2, 40), (5, 10), (9, 40)):
        mine = level[positioner == row]
        chosen = level[(positioner == row) & keep]
        assert len(chosen) == n
        np.testing.assert_array_equal(np.sort(chosen), np.sort(mine)[-n:])


def test_levels():
    assert levels_of(np.array([3.0, 1.0, 3.0, 7.5])).tolist() == [1, 0, 1, 2]
    many = levels_of(np.linspace(0, 1, 300))
    assert many.min() == 0
    assert many.max() == MAX_LEVELS - 1
    assert np.all(np.diff(many) >= 0)
    assert np.bincount(many).tolist() == [20] * MAX_LEVELS
    tied = np.concatenate([np.zeros(200), np.linspace(1, 2, 100)])
    assert np.unique(levels_of(tied)[:200]).tolist() == [0]


def test_nothing_to_choose():
    none = np.empty(0, dtype=np.int64)
    chosen, proven = pack(none, none, none, (none, none), np.random.default_rng(0))
    assert len(chosen) == 0
    assert proven
