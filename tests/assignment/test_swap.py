"""Targets that change hands for the sake of the motion: what stays, and what is gained."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom import _core
from fiberloom.assignment import SwapSettings, assign, swap_targets
from fiberloom.assignment.clearance import obstacles
from fiberloom.assignment.swapping.exchange import REASON, Exchanger
from fiberloom.assignment.swapping.swap import arrivals_s
from fiberloom.errors import InputError
from fiberloom.instruments import generate
from fiberloom.planning import PlanSettings, plan, random_pair, verify
from fiberloom.planning.obstacles import on_all_layers, plain_parts
from fiberloom.targets import TargetList, random_targets
from fiberloom.targets.target_list import FREE


@pytest.fixture(scope="module")
def array37(sdssv):
    return generate(sdssv, seed=2, n_positioners=37)


@pytest.fixture(scope="module")
def knot(array37):
    """Two neighbours, two targets, and a start from which the arms hinder each other on their shortest ways.

    Found by a search over 4000 pairs of targets."""
    plane = array37.select([23, 24]).with_collision_buffer(2.5)
    x, y = np.array([[-29.23, 30.21], [-15.52, 11.38]]).T
    names, none = np.array(["a", "b"]), np.full(2, "", dtype="<U16")
    targets = TargetList(names, x, y, np.ones(2), none, np.full(2, FREE))
    start_deg = np.array([[105.47, 93.3], [266.4, 39.1]])
    return plane, targets, start_deg, assign(plane, targets, start_deg=start_deg)


def numbers(targets, found):
    return np.unique(targets.priority[found.target[found.target >= 0]], return_counts=True)


def is_sound(plane, targets, found):
    """Places free in the planner's test; fibres on targets, one each; every target is told of."""
    goals, approach = np.deg2rad(found.goal_deg), np.deg2rad(plane.instrument.approach_deg)
    parts = plain_parts(plane.n, plane.beta_segment_mm, plane.collision_buffer_mm + 0.1)
    bodies = _core.planning.Bodies(plane.arms, parts, on_all_layers(obstacles(plane, 0.0)[:, :5]))
    assert len(_core.planning.conflicts(bodies, goals, approach)) == 0
    free = _core.planning.static_ok(bodies, np.arange(plane.n), goals, approach)
    assert np.all(free | plane.offline)  # an arm that is offline is an obstacle itself
    served = np.flatnonzero(found.target >= 0)
    taken = found.target[served]
    assert len(np.unique(taken)) == len(taken)
    assert set(taken.tolist()) | set(found.unassigned) == set(range(len(targets)))
    assert not set(taken.tolist()) & set(found.unassigned)
    assert np.all(found.fibre[found.target < 0] == "")
    for row in served:
        xy = plane.forward([found.alpha_deg[row]], [found.beta_deg[row]], found.fibre[row], [row])[0]
        np.testing.assert_allclose(xy, targets.xy_mm[found.target[row]], atol=1e-9)
        assert targets.fibre[found.target[row]] in ("", found.fibre[row])
        assert targets.positioner_id[found.target[row]] in (FREE, plane.positioner_id[row])
    assert found.clearance_mm.min() >= 0.2


@given(st.integers(0, 500), st.integers(25, 200), st.integers(0, 3))
@settings(max_examples=15, deadline=None)
def test_an_exchange_keeps_numbers_and_rules(array37, seed, n, n_avoided):
    targets, rng = random_targets(array37, n, seed), np.random.default_rng(seed)
    start_deg = random_pair(array37, seed)[0]
    found = assign(array37, targets, seed=seed)
    rows = rng.choice(array37.n, size=1 + n_avoided, replace=False).tolist()
    avoid = {(row, int(found.target[row])) for row in rows[1:]}
    exchanger = Exchanger(array37, targets, start_deg)
    other = exchanger.exchanged(found, rows[:1], avoid)
    if other is None:
        return
    np.testing.assert_array_equal(numbers(targets, other), numbers(targets, found))
    is_sound(array37, targets, other)
    lost = set(found.target.tolist()) - set(other.target.tolist()) - {-1}
    assert all(other.unassigned[row] == REASON for row in lost)
    far = np.linalg.norm(array37.centres_mm - array37.centres_mm[rows[0]], axis=1) > 100.0
    np.testing.assert_array_equal(other.goal_deg[far], found.goal_deg[far])
    # nothing more to gain by the same
    assert exchanger.exchanged(other, rows[:1], avoid) is None


def test_what_is_avoided_goes_to_another(array37):
    targets = random_targets(array37, 200, 3)
    targets.priority[:] = 1.0
    found = assign(array37, targets, start_deg=array37.park_deg)
    exchanger = Exchanger(array37, targets, array37.park_deg)
    for row in range(0, array37.n, 3):
        other = exchanger.exchanged(found, [row], {(row, int(found.target[row]))})
        assert other is not None
        assert other.target[row] != found.target[row]
        assert other.n_assigned == found.n_assigned
        is_sound(array37, targets, other)


def test_what_a_list_demands_is_not_exchanged(array37):
    targets = random_targets(array37, 120, 5)
    targets.priority[:] = 1.0
    first = assign(array37, targets)
    rows = np.flatnonzero(first.target >= 0)[:20]
    targets.positioner_id[first.target[rows]] = array37.positioner_id[rows]
    found = assign(array37, targets)
    np.testing.assert_array_equal(found.target[rows], first.target[rows])
    avoid = {(row, int(found.target[row])) for row in rows.tolist()}
    other = Exchanger(array37, targets, array37.park_deg).exchanged(found, range(array37.n), avoid)
    assert other is not None
    np.testing.assert_array_equal(other.target[rows], first.target[rows])
    assert not np.array_equal(other.target, found.target)


def test_offline_positioners_stay(array37):
    plane = array37.with_offline(array37.positioner_id[[5, 18]])
    targets = random_targets(plane, 100, 1)
    found = assign(plane, targets)
    other = Exchanger(plane, targets, plane.park_deg).exchanged(found, range(plane.n))
    assert other is not None
    assert np.all(other.target[[5, 18]] == -1)
    np.testing.assert_array_equal(other.goal_deg[[5, 18]], plane.offline_position_deg[[5, 18]])
    is_sound(plane, targets, other)


def test_only_a_swap_unties_two_arms(knot):
    """On their shortest ways the two need 19 s where 7 s would do, whatever the planner draws."""
    plane, targets, start_deg, found = knot
    for seed in range(3):
        alone = plan(plane, start_deg, found.goal_deg, seed=seed, settings=PlanSettings(effort=3.0))
        assert alone.duration_s > 15.0
    swapped = swap_targets(plane, targets, found, start_deg)
    assert swapped.assignment.target.tolist() == found.target.tolist()[::-1]
    assert swapped.first.duration_s > 15.0
    assert swapped.plan.duration_s < 12.0
    assert verify(plane, swapped.plan, goal_deg=swapped.assignment.goal_deg).ok
    assert f"{swapped.first.duration_s:.1f} to {swapped.plan.duration_s:.1f} s" in repr(swapped)


def test_a_swap_brings_home_who_is_refused(knot):
    """With little time the planner unties nothing, and both stay where they are."""
    plane, targets, start_deg, found = knot
    hasty = SwapSettings(planning=PlanSettings(last_deadline=1.2))
    swapped = swap_targets(plane, targets, found, start_deg, settings=hasty)
    assert any("no way past its neighbours" in why for why in swapped.first.refused.values())
    assert swapped.plan.refused == {}


def test_a_motion_that_is_not_held_up_is_left_alone(array37):
    targets = random_targets(array37, 120, 1)
    found = assign(array37, targets, start_deg=array37.park_deg)
    swapped = swap_targets(array37, targets, found, array37.park_deg)
    assert swapped.assignment is found
    assert swapped.n_plans == 1
    assert swapped.plan is swapped.first


def test_no_more_plans_than_allowed_and_never_a_worse_one(knot):
    plane, targets, start_deg, found = knot
    for plans in (0, 1, 3):
        # everything is late by this rule: tried until nothing is left to try, or the plans are used up
        how = SwapSettings(plans=plans, late_s=-60.0)
        swapped = swap_targets(plane, targets, found, start_deg, settings=how)
        assert swapped.n_plans <= 1 + plans
        assert swapped.plan.duration_s <= swapped.first.duration_s
        np.testing.assert_array_equal(numbers(targets, swapped.assignment), numbers(targets, found))
        assert swapped.cpu_s >= swapped.plan.cpu_s


def test_arrivals_are_above_the_goals(knot):
    plane, _, start_deg, found = knot
    made = plan(plane, start_deg, found.goal_deg)
    above_s = arrivals_s(made, found.approach_deg)
    assert above_s.max() == pytest.approx(made.duration_s - 0.375, abs=0.26)
    for row, robot in enumerate(made.robots):
        later = [k for k, t in enumerate(robot.time_s) if t > above_s[row] + 1e-9]
        ends = np.column_stack([robot.alpha_deg, robot.beta_deg])[later]
        assert np.all(np.abs(ends - found.goal_deg[row]) < 0.83)


def test_a_start_of_another_shape_is_refused(knot):
    plane, targets, _, found = knot
    with pytest.raises(InputError, match="start_deg"):
        swap_targets(plane, targets, found, np.zeros((3, 2)))
