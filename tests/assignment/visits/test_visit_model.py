"""The choice over many exposures against brute force, and its bound."""

import sys
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fiberloom.assignment.visits import solve as solvers
from fiberloom.assignment.visits.model import Choices, build
from fiberloom.assignment.visits.solve import one_by_one, shortage, solve
from fiberloom.errors import InputError

TARGETS, SECTORS = 5, 2
NONE = (np.empty(0, np.int64), np.empty(0, np.int64))


@st.composite
def exposures(draw):
    """Three positioners with up to two candidates each; the last is in another sector."""
    rows = [(p, t) for p in range(3) for t in sorted(draw(st.sets(st.integers(0, TARGETS - 1), max_size=2)))]
    positioner, target = np.array(rows or [(0, 0)]).T
    possible = [
        (a, b)
        for a in range(len(target))
        for b in range(a)
        if positioner[a] != positioner[b] and target[a] != target[b]
    ]
    pairs = np.array([p for p in possible if draw(st.booleans())], dtype=np.int64).reshape(-1, 2)
    return Choices(positioner, target, (positioner == 2).astype(np.int64), (pairs[:, 0], pairs[:, 1]))


@st.composite
def models(draw, minimum=True):
    value = 10.0 ** np.array(draw(st.lists(st.integers(0, 3), min_size=TARGETS, max_size=TARGETS)))
    visits = np.array(draw(st.lists(st.integers(1, 2), min_size=TARGETS, max_size=TARGETS)))
    role = np.array(draw(st.lists(st.sampled_from(["science", "sky"]), min_size=TARGETS, max_size=TARGETS)))
    value[role == "sky"], visits[role == "sky"] = 0.0, 2
    least = {"sky": draw(st.integers(0, 1))} if minimum else {}
    parts = [draw(exposures()) for _ in range(2)]
    return build(parts, value, visits, role, least, SECTORS), parts, visits, role, least


def keeps(chosen, parts, visits, role, least):
    """The rules in words, without the matrices of the model."""
    done, at = np.zeros(TARGETS, dtype=int), 0
    for part in parts:
        mine = chosen[at : at + len(part.target)]
        at += len(part.target)
        for key in (part.positioner[mine], part.target[mine]):
            if len(set(key)) < len(key):
                return False
        if any(mine[a] and mine[b] for a, b in zip(*part.pairs, strict=True)):
            return False
        np.add.at(done, part.target[mine], 1)
        for sector, number in product(range(SECTORS), least.values()):
            if np.sum((role[part.target[mine]] == "sky") & (part.sector[mine] == sector)) < number:
                return False
    return bool((done <= visits).all())


def best_of_all(model, *rules):
    allowed = (np.array(x, dtype=bool) for x in product([0, 1], repeat=len(model)))
    return max((model.worth(x) for x in allowed if keeps(x, *rules)), default=None)


@given(models())
@settings(max_examples=60, deadline=None)
def test_no_choice_is_better_and_where_there_is_none_it_is_said(made):
    model, *rules = made
    best = best_of_all(model, *rules)
    if best is None:
        with pytest.raises(
            InputError, match=r"exposure \d, sector \d: 1 sky fibres are asked for, 0 can be had"
        ):
            solve(model)
        return
    found = solve(model)
    assert keeps(found.columns, *rules)
    assert found.value == best
    assert found.bound == pytest.approx(best, abs=1e-6)
    assert found.proven
    assert found.gap < 1e-6


@given(models())
@settings(max_examples=30, deadline=None)
def test_cp_sat_finds_the_same(made):
    pytest.importorskip("ortools", reason="pip install 'fiberloom[survey]'")
    model, *rules = made
    best = best_of_all(model, *rules)
    assume(best is not None)
    found = solve(model, "ortools")
    assert keeps(found.columns, *rules)
    assert (found.value, found.bound) == (best, best)


@given(models(minimum=False))
@settings(max_examples=40, deadline=None)
def test_greedy_and_one_by_one_keep_the_rules_and_are_never_above_the_bound(made):
    model, *rules = made
    bound = solve(model).bound
    for other in (solve(model, "greedy"), one_by_one(model)):
        assert keeps(other.columns, *rules)
        assert other.value <= bound + 1e-6
        assert not other.proven


def one_exposure(positioner, target, sector):
    return Choices(np.array(positioner), np.array(target), np.array(sector), NONE)


def test_the_exposures_are_chosen_together():
    """The first exposure alone would take a, which the second could have too; b is in the first only."""
    parts = [one_exposure([0, 0], [0, 1], [0, 0]), one_exposure([0], [0], [0])]
    model = build(parts, np.array([10.0, 9.0]), np.array([1, 1]), np.array(["science"] * 2), {}, 1)
    assert solve(model).value == 19.0
    assert one_by_one(model).value == 10.0


def test_a_target_has_no_more_visits_than_it_wants():
    parts = [one_exposure([0], [0], [0])] * 3
    model = build(parts, np.array([1.0]), np.array([2]), np.array(["science"]), {}, 1)
    assert solve(model).columns.sum() == 2


def test_a_minimum_that_cannot_be_had_is_named_with_sector_and_number():
    parts = [one_exposure([0, 1, 2], [0, 1, 2], [0, 1, 1])]
    role = np.array(["science", "sky", "sky"])
    model = build(parts, np.array([1.0, 0.0, 0.0]), np.ones(3, int), role, {"sky": 2}, 2)
    assert shortage(model).tolist() == [2, 0]
    with pytest.raises(InputError) as told:
        solve(model)
    assert str(told.value) == (
        "exposure 1, sector 1: 2 sky fibres are asked for, 0 can be had; lower the minimum, or give more "
        "targets of the role"
    )


def test_minimums_that_only_together_cannot_be_had_are_named():
    """Two positioners reach one sky place: either sector can have it, not both."""
    parts = [one_exposure([0, 1], [0, 0], [0, 1])]
    model = build(parts, np.zeros(1), np.ones(1, int), np.array(["sky"]), {"sky": 1}, 2)
    assert shortage(model).sum() == 1
    with pytest.raises(InputError, match="0 can be had"):
        solve(model)


def test_the_same_seed_gives_the_same_choice_and_another_one_may_not():
    rng = np.random.default_rng(0)
    parts = [one_exposure(np.repeat(np.arange(6), 3), rng.integers(0, 9, 18), np.zeros(18, int))] * 2
    model = build(parts, np.ones(9), np.ones(9, int), np.array(["science"] * 9), {}, 1)
    once = solve(model, seed=1).columns
    assert (solve(model, seed=1).columns == once).all()
    assert any((solve(model, seed=s).columns != once).any() for s in range(2, 8))


def test_a_solver_that_nobody_knows_and_ortools_that_is_not_there(monkeypatch):
    model = build([one_exposure([0], [0], [0])], np.ones(1), np.ones(1, int), np.array(["science"]), {}, 1)
    with pytest.raises(InputError, match="must be one of highs, ortools, greedy"):
        solve(model, "guess")
    monkeypatch.setitem(sys.modules, "ortools.sat.python.cp_model", None)
    monkeypatch.setitem(sys.modules, "ortools.sat.python", None)
    with pytest.raises(InputError, match=r"pip install 'fiberloom\[survey\]'"):
        solve(model, "ortools")


def test_where_the_search_is_cut_short_the_gap_says_so():
    found = solvers.ChosenVisits(np.ones(1, dtype=bool), 90.0, 100.0, 0.0)
    assert found.gap == pytest.approx(0.1)
    assert not found.proven


@settings(max_examples=60, deadline=None)
@given(models(), st.data())
def test_a_choice_that_breaks_a_rule_is_not_allowed(made, data):
    """What a solver returns is looked at again: the matrices say of any choice what the words say."""
    model, *told = made
    chosen = np.array(
        data.draw(st.lists(st.booleans(), min_size=len(model), max_size=len(model))), dtype=bool
    )
    assert model.allowed(chosen) == keeps(chosen, *told)
