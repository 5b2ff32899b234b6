"""The packing against brute force."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom.assignment import choose
from fiberloom.assignment.choose import (
    LEVEL_WEIGHT,
    MAX_LEVELS,
    STRICT_WEIGHT,
    Wish,
    _greedy,
    _solve,
    _strict_weights,
    exchange,
    levels_of,
    pack,
    shortlist,
)


@st.composite
def problems(draw, levels=4):
    """Up to 4 positioners with up to 3 candidates each, random targets, levels, conflicts."""
    choices = [(p, t) for p in range(4) for t in draw(st.sets(st.integers(0, 5), max_size=3))]
    if not choices:
        choices = [(0, 0)]
    positioner, target = np.array(choices).T
    level = np.array(draw(st.lists(st.integers(0, levels - 1), min_size=6, max_size=6)))[target]
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


def all_choices(positioner, target, pairs):
    per = [[-1, *np.flatnonzero(positioner == p)] for p in np.unique(positioner)]
    for combination in product(*per):
        chosen = np.zeros(len(positioner), dtype=bool)
        chosen[[c for c in combination if c >= 0]] = True
        if is_allowed(chosen, positioner, target, pairs):
            yield chosen


def best_value(positioner, target, level, pairs, worth=None):
    worth = LEVEL_WEIGHT ** level.astype(float) if worth is None else worth
    return max(worth[chosen].sum() for chosen in all_choices(positioner, target, pairs))


def served(chosen, level):
    """Targets of each level, the highest first."""
    return np.bincount(level[chosen], minlength=level.max() + 1)[::-1].tolist()


@given(problems(), st.integers(0, 100))
@settings(max_examples=60, deadline=None)
def test_no_choice_is_better(problem, seed):
    positioner, target, level, pairs = problem
    chosen, proven = pack(positioner, target, level, pairs, np.random.default_rng(seed))
    assert proven
    assert is_allowed(chosen, positioner, target, pairs)
    worth = LEVEL_WEIGHT ** level.astype(float)
    assert worth[chosen].sum() == pytest.approx(best_value(*problem))


@given(problems(levels=6), st.integers(0, 100), st.booleans())
@settings(max_examples=100, deadline=None)
def test_strict_levels_against_all_choices(problem, seed, tight):
    """Also with windows of one level each, so that numbers have to be kept from window to window."""
    positioner, target, level, pairs = problem
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(choose, "STRICT_WEIGHT", 1.0 if tight else STRICT_WEIGHT)
        chosen, proven = pack(*problem, np.random.default_rng(seed), Wish(strict=True))
    assert proven
    assert is_allowed(chosen, positioner, target, pairs)
    best = max(served(other, level) for other in all_choices(positioner, target, pairs))
    assert served(chosen, level) == best


def one_against_many(n):
    """One target in the middle keeps n others out; all n + 1 positioners can serve only the many."""
    positioner = target = np.arange(n + 1)
    level = np.array([1, *[0] * n])
    return positioner, target, level, (np.zeros(n, dtype=np.int64), np.arange(1, n + 1))


@pytest.mark.parametrize(("n", "weighted"), [(9, [1, 0]), (11, [0, 11]), (40, [0, 40])])
def test_no_number_outweighs_a_higher_level_if_strict(n, weighted):
    positioner, target, level, pairs = one_against_many(n)
    for strict, expected in ((False, weighted), (True, [1, 0])):
        chosen, _ = pack(positioner, target, level, pairs, np.random.default_rng(0), Wish(strict))
        assert served(chosen, level) == expected


def test_strict_levels_keep_numbers_and_not_targets():
    """Two of the highest level are equally good; which one is served is decided by the lowest of twelve."""
    positioner, target = np.array([0, 0, 1]), np.array([0, 1, 2])
    level, pairs = np.array([11, 11, 0]), (np.array([0]), np.array([2]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(choose, "STRICT_WEIGHT", 1.0)
        for seed in range(8):
            chosen, _ = pack(positioner, target, level, pairs, np.random.default_rng(seed), Wish(strict=True))
            assert chosen.tolist() == [False, True, True]


@given(st.lists(st.integers(0, 4), min_size=1, max_size=8), st.integers(1, 6))
def test_a_strict_weight_is_more_than_all_below(there, room):
    """By the best that fits below: the dearest first, as many as there are and as there is room."""
    weight = _strict_weights(there, room)
    for k in range(1, len(weight)):
        left, below = room, 0.0
        for one, count in zip(weight[:k][::-1], there[len(there) - len(weight) :][:k][::-1], strict=True):
            below += one * min(count, left)
            left -= min(count, left)
        assert weight[k] > below
    assert len(weight) == 1 or weight[-1] <= STRICT_WEIGHT


@given(problems(), st.booleans(), st.data())
@settings(max_examples=100, deadline=None)
def test_of_equally_good_choices_the_cheapest(problem, strict, data):
    """Costs never change how many of each level are served; strict or by weight."""
    positioner, target, level, pairs = problem
    n = len(positioner)
    cost = np.array(data.draw(st.lists(st.integers(0, 9), min_size=n, max_size=n))) / 9.0
    wish = Wish(strict, cost)
    chosen, proven = pack(*problem, np.random.default_rng(0), wish)
    assert proven
    assert is_allowed(chosen, positioner, target, pairs)
    good = [c for c in all_choices(positioner, target, pairs) if served(c, level) == served(chosen, level)]
    assert cost[chosen].sum() == pytest.approx(min(cost[c].sum() for c in good))
    free, _ = pack(*problem, np.random.default_rng(0), Wish(strict))
    assert served(free, level) == served(chosen, level)


@given(problems(), st.data())
@settings(max_examples=60, deadline=None)
def test_an_exchange_keeps_the_numbers_and_is_the_cheapest(problem, data):
    positioner, target, level, pairs = problem
    n = len(positioner)
    cost = np.array(data.draw(st.lists(st.integers(0, 9), min_size=n, max_size=n))) / 9.0
    allowed = list(all_choices(positioner, target, pairs))
    now = allowed[data.draw(st.integers(0, len(allowed) - 1))]
    numbers = np.bincount(level[now], minlength=level.max() + 1)
    chosen = exchange(positioner, target, level, pairs, numbers, cost)
    assert chosen is not None
    assert is_allowed(chosen, positioner, target, pairs)
    np.testing.assert_array_equal(np.bincount(level[chosen], minlength=len(numbers)), numbers)
    as_many = [c for c in allowed if served(c, level) == served(now, level)]
    assert cost[chosen].sum() == pytest.approx(min(cost[c].sum() for c in as_many))


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
    assert not proven  # more levels than one solution holds
    assert sorted(level[chosen]) == list(range(1, 12))


def test_levels_that_are_settled_leave_room_for_those_below():
    """Two targets of the highest level are equally good; one of them keeps the lowest of six levels out."""
    # positioner 0: target 0 or 1, both of level 5; positioner 1: target 2 of level 2, in the way of target 0
    positioner, target = np.array([0, 0, 1]), np.array([0, 1, 2])
    level = np.array([5, 5, 2])
    pairs = (np.array([0]), np.array([2]))
    for seed in range(8):
        chosen, _ = pack(positioner, target, level, pairs, np.random.default_rng(seed))
        assert chosen.tolist() == [False, True, True]


@given(problems(levels=9), st.integers(0, 100))
@settings(max_examples=60, deadline=None)
def test_what_the_highest_levels_are_worth_is_never_given_away(problem, seed):
    """By the best choice among the targets of the five highest levels alone."""
    positioner, target, level, pairs = problem
    chosen, _ = pack(positioner, target, level, pairs, np.random.default_rng(seed))
    assert is_allowed(chosen, positioner, target, pairs)
    high = level > level.max() - 5
    worth = np.where(high, LEVEL_WEIGHT ** level.astype(float), 0.0)
    assert worth[chosen].sum() == pytest.approx(best_value(*problem, worth))


def test_1200_positioners_and_many_levels_take_few_solutions():
    """What makes long lists slow is the number of solutions and rows over all candidates."""
    rng = np.random.default_rng(2)
    positioner = np.sort(rng.integers(0, 1200, 9000))
    target = (2 * positioner + rng.integers(-6, 7, 9000)) % 2400
    level = rng.integers(0, MAX_LEVELS, 2400)[target]
    once = np.unique(np.column_stack([positioner, target]), axis=0, return_index=True)[1]
    none = np.empty(0, dtype=np.int64)
    solved = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(choose, "_solve", lambda value, rules: solved.append(rules) or _solve(value, rules))
        chosen, _ = pack(positioner[once], target[once], level[once], (none, none), rng)
    assert chosen.sum() > 1100
    assert len(solved) == 6
    for rules in solved:
        for rule in rules[1:]:
            assert np.diff(rule.A.tocsr().indptr).max() < 40  # no row over all candidates


def test_the_shortlist_keeps_the_highest_levels():
    rng = np.random.default_rng(0)
    positioner, level = np.repeat([2, 5, 9], [100, 10, 60]), rng.integers(0, 5, 170)
    keep = shortlist(positioner, level, rng)
    for row, n in ((2, 40), (5, 10), (9, 40)):
        mine = level[positioner == row]
        chosen = level[(positioner == row) & keep]
        assert len(chosen) == n
        np.testing.assert_array_equal(np.sort(chosen), np.sort(mine)[-n:])


def test_the_shortlist_keeps_the_cheapest_of_a_level():
    positioner, level = np.zeros(60, dtype=np.int64), np.repeat([1, 0], 30)
    cost = np.arange(60)[::-1] / 60.0
    keep = shortlist(positioner, level, np.random.default_rng(0), Wish(cost=cost))
    assert np.flatnonzero(keep).tolist() == [*range(30), *range(50, 60)]
    assert shortlist(positioner, level, np.random.default_rng(0), Wish(strict=True)).all()


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
