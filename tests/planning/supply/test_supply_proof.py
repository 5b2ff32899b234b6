"""What a plan takes, counted in three ways: the planner's, the proof's, and by sampling."""

from dataclasses import replace

import numpy as np
import pytest
from tests.planning.fields import SDSSV, field

from fiberloom.instruments.model import Care
from fiberloom.planning import PlanSettings, plan, plan_corrections, random_pair, verify_supply
from fiberloom.planning.supply import (
    LEAST_SHARE,
    currents,
    peak_current_A,
    plan_in_waves,
    plan_within_supply,
    proof,
)
from fiberloom.planning.trajectories import Plan, Trajectory

CARE = {"motor_friction_A": (0.01, 0.005), "motor_speed_A": (0.1, 0.05)}


def fed(n, supply_A=None, **care):
    instrument = SDSSV.model_copy(update={"care": Care.model_validate(CARE | care | {"supply_A": supply_A})})
    return replace(field(n), instrument=instrument)


def sampled_A(plane, made, step_s=0.005):
    """(M,) current by positions alone: a motor that moves within a step turns."""
    care, at_s = plane.instrument.care, np.arange(0.0, made.duration_s + step_s, step_s)
    speeds = [axis.speed_deg_s for axis in plane.instrument.axes]
    total = np.zeros(len(at_s) - 1)
    for robot in made.robots:
        share = np.abs(np.diff(robot.at(at_s), axis=0)) / step_s / speeds
        total += (np.where(share > 1e-7, care.motor_friction_A, 0.0) + share * care.motor_speed_A).sum(axis=1)
    return total


def test_three_ways_of_counting_agree():
    plane = fed(19)
    made = plan(plane, *random_pair(plane, seed=3))
    proven, sampled = verify_supply(plane, made), sampled_A(plane, made)
    assert proven.peak_A == pytest.approx(peak_current_A(plane.instrument, made)[0], rel=1e-9)
    assert proven.peak_s == pytest.approx(peak_current_A(plane.instrument, made)[1], abs=1e-9)
    # a step that holds a corner counts friction on both sides of it
    assert np.median(sampled) <= proven.peak_A
    assert np.sort(sampled)[-20] == pytest.approx(proven.peak_A, rel=0.03)
    assert proven.most_at_once == 19


@pytest.mark.parametrize("most_terms", [1, 20, 500_000])
def test_small_moves_with_common_clocks_are_counted_each(monkeypatch, most_terms):
    """In whatever portions: half of them come from above, so that there are two clocks."""
    monkeypatch.setattr(proof, "_MOST_TERMS", most_terms)
    plane = fed(19)
    start_deg = plane.park_deg
    approach_deg = np.where(np.arange(19) % 2, np.linspace(0.2, 0.6, 19), 0.0)
    way_deg = np.linspace(0.1, 0.3, 19)[:, None] * [0.0, 1.0]
    made = plan_corrections(plane, start_deg, start_deg - way_deg, approach_deg=approach_deg)
    assert len({robot.time_s.tobytes() for robot in made.robots}) == 2
    counted, sampled = verify_supply(plane, made), sampled_A(plane, made, step_s=1e-3)
    assert counted.most_at_once == 19
    assert counted.peak_A == pytest.approx(np.sort(sampled)[-20], rel=0.03)
    assert counted.peak_A == pytest.approx(peak_current_A(plane.instrument, made)[0], rel=1e-9)


def test_the_proof_goes_red_where_a_plan_takes_more():
    plane = fed(2, supply_A=0.2)
    ways = [(0.0, 12.0), (5.0, 17.0)]
    both = [Trajectory(k + 1, np.array([0.0, 1.0]), np.array(way), np.zeros(2)) for k, way in enumerate(ways)]
    found = verify_supply(plane, Plan("sdssv", 2.0, tuple(both)))
    assert not found.ok
    assert "0.22 A at 0.000 s; the supply has 0.2 A" in str(found)
    later = replace(both[1], time_s=np.array([0.0, 1.0, 2.0]), alpha_deg=np.array([5.0, 5.0, 17.0]),
                    beta_deg=np.zeros(3))  # fmt: skip
    one_by_one = Plan("sdssv", 2.0, (both[0], later))
    assert verify_supply(plane, one_by_one, at_once=1).ok
    found = verify_supply(plane, Plan("sdssv", 2.0, tuple(both)), supply_A=1.0, at_once=1)
    assert "2 positioners move at 0.000 s, not 1 at most" in str(found)
    still = Plan(
        "sdssv", 2.0, (replace(both[0], time_s=np.zeros(1), alpha_deg=np.zeros(1), beta_deg=np.zeros(1)),)
    )
    assert verify_supply(plane, still, at_once=1).most_at_once == 0


def fastest(plane, ends, calls):
    def slowed(share):
        return PlanSettings(speed_deg_s=share * 11.7)

    def at_share(share):
        calls.append(share)
        return plan(plane, *ends, settings=slowed(share))

    def in_waves(most, share):
        calls.append(most)
        return plan_in_waves(plane, *ends, most=most, settings=slowed(share))

    return plan_within_supply(plane.instrument, at_share, in_waves)


@pytest.mark.parametrize("part", [0.9, 0.7, 0.45])
def test_the_speed_is_as_high_as_the_supply_allows(part):
    plane, calls = fed(19), []
    ends = random_pair(plane, seed=3)
    full_A = peak_current_A(plane.instrument, plan(plane, *ends))[0]
    plane = fed(19, supply_A=part * full_A)
    made = fastest(plane, ends, calls)
    assert 0.95 * part * full_A < verify_supply(plane, made).peak_A <= part * full_A
    assert calls[0] == 1.0
    assert all(LEAST_SHARE <= share < 1.0 for share in calls[1:])
    assert len(calls) <= 7


def test_a_supply_below_the_friction_of_all_makes_waves():
    ends = random_pair(fed(19), seed=3)
    # 19 positioners turn 19 x 0.015 A by friction alone
    plane, calls = fed(19, supply_A=0.2), []
    made = fastest(plane, ends, calls)
    assert calls == [1.0, 1]  # one at full speed takes 0.165 A
    assert made.statistics["waves"] >= 19
    assert verify_supply(plane, made).ok
    assert currents(plane.instrument, made).share_within(0.2) > 1.0
