"""Plans in waves: nobody moves out of turn, all arrive, and what cannot is named. Against plain sampling."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.planning.fields import field, sampled_gaps

from fiberloom.errors import InputError
from fiberloom.planning import (
    PlanSettings,
    plan,
    plan_corrections,
    plan_in_waves,
    random_pair,
    verify,
    verify_supply,
)
from fiberloom.planning.supply import waves
from fiberloom.planning.supply.waves import PAUSE_S
from fiberloom.planning.verification import MotionLimits

N = 19


def sampled_moving(made, step_s=0.01):
    """How many move at once, by positions alone, every 10 ms."""
    at_s = np.arange(0.0, made.duration_s + step_s, step_s)
    way = [np.abs(np.diff(robot.at(at_s), axis=0)).max(axis=1) for robot in made.robots]
    return (np.array(way) > 1e-9).sum(axis=0)


@pytest.mark.parametrize("most", [1, 4, 10, N])
def test_no_more_than_may_move_and_all_arrive(most):
    plane = field(N)
    start_deg, goal_deg = random_pair(plane, seed=2)
    made = plan_in_waves(plane, start_deg, goal_deg, most=most, seed=1)
    assert sampled_moving(made).max() <= most
    assert verify_supply(plane, made, at_once=most).ok
    assert verify(plane, made, start_deg=start_deg, goal_deg=goal_deg).ok
    assert min(sampled_gaps(plane, made)) > -1e-6
    arrived = ~np.isin(plane.positioner_id, list(made.refused))
    np.testing.assert_allclose(made.end_deg[arrived], goal_deg[arrived], atol=1e-8)
    # of random pairs some bar each other where none may step aside for another
    assert len(made.refused) <= {1: 3, 4: 1}.get(most, 0)


def test_between_waves_nothing_moves_and_all_at_once_is_one_wave():
    plane = field(7)
    goal_deg = plane.park_deg - [0.0, 30.0]
    made = plan_in_waves(plane, plane.park_deg, goal_deg, most=3)
    assert made.statistics["waves"] == 3
    assert (sampled_moving(made) == 0).sum() * 0.01 == pytest.approx(2 * PAUSE_S, abs=0.05)
    together = plan_in_waves(plane, plane.park_deg, goal_deg, most=7)
    assert together.to_json() == plan(plane, plane.park_deg, goal_deg).to_json()


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), most=st.integers(1, 7))
def test_of_any_field_each_moves_in_its_turn(seed, most):
    plane = field(7)
    start_deg, goal_deg = random_pair(plane, seed=seed)
    made = plan_in_waves(plane, start_deg, goal_deg, most=most, seed=seed)
    assert sampled_moving(made).max() <= most
    assert verify(plane, made, start_deg=start_deg, goal_deg=goal_deg).ok


def test_corrections_come_in_waves_and_none_folds():
    plane = field(7)
    start_deg, _ = random_pair(plane, seed=4)
    goal_deg = start_deg + 0.02
    made = plan_in_waves(plane, start_deg, goal_deg, most=2, make=plan_corrections)
    assert made.refused == {}
    assert made.statistics["waves"] == 4
    assert max(np.abs(robot.points_deg - start_deg[k]).max() for k, robot in enumerate(made.robots)) < 1.0


def test_offline_ones_stay_and_none_at_once_is_refused():
    plane = field(7).with_offline([field(7).positioner_id[0]])
    made = plan_in_waves(plane, plane.park_deg, plane.park_deg - [0.0, 30.0], most=2)
    assert not made.robots[0].moves
    assert sum(robot.moves for robot in made.robots) == 6
    with pytest.raises(InputError, match="0 positioners at once: none can move"):
        plan_in_waves(plane, plane.park_deg, plane.park_deg, most=0)
    with pytest.raises(InputError, match="goal_deg"):
        plan_in_waves(plane, plane.park_deg, plane.park_deg[:3], most=2)


def test_the_budget_is_of_all_waves_together():
    plane = field(N)
    start_deg, goal_deg = random_pair(plane, seed=2)
    made = plan_in_waves(plane, start_deg, goal_deg, most=2, settings=PlanSettings(budget_s=1e-3))
    assert verify(plane, made, start_deg=start_deg).ok


def test_waves_that_fail_their_verification_are_never_given_out(monkeypatch):
    """None moves; whoever was refused before keeps its own reason."""
    plane = field(N)
    ends_deg = random_pair(plane, seed=2)
    refused = plan_in_waves(plane, *ends_deg, most=1, seed=1).refused
    assert refused
    monkeypatch.setattr(waves, "MotionLimits", lambda *limits, **others: MotionLimits(1e-3, 1e-3))
    made = plan_in_waves(plane, *ends_deg, most=1, seed=1)
    assert (sampled_moving(made) == 0).all()
    assert made.refused.keys() >= refused.keys()
    for number, why in made.refused.items():
        assert why == refused.get(number, f"positioner {number}: {waves._UNVERIFIED}")
    assert verify(plane, made, start_deg=ends_deg[0]).ok
