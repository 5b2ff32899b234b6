"""Assignments from where the positioners are: as many targets of each priority, on shorter ways."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom import _core
from fiberloom.assignment import AssignSettings, assign
from fiberloom.assignment.clearance import obstacles
from fiberloom.assignment.ways import way_deg
from fiberloom.errors import InputError
from fiberloom.instruments import generate
from fiberloom.planning import bound_s, random_pair
from fiberloom.planning.obstacles import on_all_layers, plain_parts
from fiberloom.planning.planner import PlanSettings
from fiberloom.targets import TargetList, random_targets
from fiberloom.targets.target_list import FREE


@pytest.fixture(scope="module")
def field37(sdssv):
    return generate(sdssv, seed=2, n_positioners=37)


def wanted(xy, priority):
    n = len(xy)
    names = np.array([f"t{k}" for k in range(n)])
    x, y = np.array(xy, dtype=float).T
    fibre = np.full(n, "", dtype="<U16")
    return TargetList(names, x, y, np.array(priority, dtype=float), fibre, np.full(n, FREE))


def per_priority(targets, found):
    values = np.unique(targets.priority)
    return [int((targets.priority[found.target[found.target >= 0]] == v).sum()) for v in values]


def is_free(plane, found):
    """By the planner's test in continuous time, all approaching together, with the margin."""
    goals, approach = np.deg2rad(found.goal_deg), np.deg2rad(plane.instrument.approach_deg)
    parts = plain_parts(plane.n, plane.beta_segment_mm, plane.collision_buffer_mm + 0.1)
    bodies = _core.planning.Bodies(plane.arms, parts, on_all_layers(obstacles(plane, 0.0)[:, :5]))
    conflicts = _core.planning.conflicts(bodies, goals, approach)
    static = _core.planning.static_ok(bodies, np.arange(plane.n), goals, approach)
    return len(conflicts) == 0 and np.all(static)


def ways(plane, start_deg, found):
    served = found.target >= 0
    return way_deg(start_deg, found.goal_deg, found.approach_deg)[served]


@given(st.integers(0, 1000), st.integers(40, 300), st.booleans())
@settings(max_examples=12, deadline=None)
def test_as_many_of_each_priority_on_shorter_ways(field37, seed, n, strict):
    targets = random_targets(field37, n, seed)
    start_deg, how = random_pair(field37, seed)[0], AssignSettings(strict=strict)
    plain = assign(field37, targets, settings=how)
    near = assign(field37, targets, start_deg=start_deg, settings=how)
    assert per_priority(targets, near) == per_priority(targets, plain)
    assert (ways(field37, start_deg, near) ** 4).sum() <= (ways(field37, start_deg, plain) ** 4).sum() + 1e-6
    assert is_free(field37, near)
    taken = near.target[near.target >= 0]
    assert len(np.unique(taken)) == len(taken)
    for row in np.flatnonzero(near.target >= 0):
        xy = field37.forward([near.alpha_deg[row]], [near.beta_deg[row]], near.fibre[row], [row])[0]
        np.testing.assert_allclose(xy, targets.xy_mm[near.target[row]], atol=1e-9)


def test_two_neighbours_take_the_targets_that_are_near(field37):
    """Each of two positioners starts at one of two targets; the plain choice may cross them, this one not."""
    plane = field37.select(field37.neighbour_pairs(1.0)[1])
    middle, apart = plane.centres_mm.mean(axis=0), np.diff(plane.centres_mm, axis=0)[0]
    side = np.array([-apart[1], apart[0]]) / np.hypot(*apart)
    both = wanted([middle + 10.0 * side, middle - 10.0 * side], [1, 1])
    by_seed = [assign(plane, both, seed=seed) for seed in range(8)]
    assert {tuple(found.target.tolist()) for found in by_seed} == {(0, 1), (1, 0)}  # either is as good
    for start in by_seed:
        for seed in range(3):
            found = assign(plane, both, seed=seed, start_deg=start.goal_deg)
            np.testing.assert_array_equal(found.target, start.target)


def test_a_far_target_gives_way_to_a_near_one_of_its_priority(field37):
    plane = field37.select([18])
    start_deg = np.array([[90.0, 90.0]])
    xy = [plane.forward([alpha], [90.0], "APOGEE")[0] for alpha in (300.0, 120.0)]
    for seed in range(4):
        assert assign(plane, wanted(xy, [1, 1]), seed=seed, start_deg=start_deg).target.tolist() == [1]
        assert assign(plane, wanted(xy, [2, 1]), seed=seed, start_deg=start_deg).target.tolist() == [0]


def test_the_longest_way_over_the_speed_is_the_bound(field37):
    targets = random_targets(field37, 100, 0)
    start_deg = random_pair(field37, 1)[0]
    found = assign(field37, targets, start_deg=start_deg)
    longest = way_deg(start_deg, found.goal_deg, field37.instrument.approach_deg).max()
    speed = PlanSettings().of(field37).speed_deg_s
    assert longest / speed == pytest.approx(bound_s(field37, start_deg, found.goal_deg), abs=1e-9)


def test_strict_priorities_of_a_field(field37):
    """Sixty levels are told apart; by weights fifteen bands are."""
    better = 0
    for seed in range(3):
        targets = random_targets(field37, 150, seed)
        targets.priority[:] = np.random.default_rng(seed).integers(0, 50, len(targets))
        plain, strict = (assign(field37, targets, settings=AssignSettings(strict=s)) for s in (False, True))
        served = [per_priority(targets, found)[::-1] for found in (plain, strict)]
        assert served[1] >= served[0]
        better += served[1] > served[0]
        assert is_free(field37, strict)
        assert not any("not proven" in note for note in strict.notes)
    assert better > 0


def test_more_priorities_than_levels_are_told(field37):
    targets = random_targets(field37, 150, 0)
    targets.priority[:] = np.linspace(0.0, 1.0, len(targets))
    note = "150 different priorities are put into 60 bands"
    assert any(note in line for line in assign(field37, targets, settings=AssignSettings(strict=True)).notes)
    assert not any(note in line for line in assign(field37, targets).notes)


@pytest.mark.parametrize("start_deg", [np.zeros((3, 2)), np.full((37, 2), np.nan), 0.0])
def test_a_start_that_is_none_is_refused(field37, start_deg):
    with pytest.raises(InputError, match="start_deg"):
        assign(field37, random_targets(field37, 10, 0), start_deg=start_deg)
