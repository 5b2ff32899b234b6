"""Corrections of one positioner, worked out by hand; and defaults that two places share."""

import time

import numpy as np
from fields import field

from fiberloom._core import planning as core
from fiberloom.planning import PlanSettings, plan_corrections

ALONE = field(7).select([0])
QUARTER_S = 0.125
"""5.85 deg/step at 11.7 deg/s last 0.5 s, four quarters of 0.125 s; 2 x 5.85 / 47 deg/s^2 need less."""


def test_a_correction_within_one_step_rises_and_comes_down_in_thirds():
    made = plan_corrections(ALONE, [[100.0, 90.0]], [[101.0, 88.0]], approach_deg=0.8)
    (robot,) = made.robots
    # way to the place above the goal: (1.8, -1.2); corners cut at 1/16 and 1/4 of the way, and as much
    # before its end; then 1/4, 1/2, 1/4 of the approach
    done = np.array([0.0, 1 / 16, 1 / 4, 3 / 4, 15 / 16, 1.0])
    up = np.array([100.0, 90.0]) + done[:, None] * [1.8, -1.2]
    down = np.array([101.8, 88.8]) - np.array([0.2, 0.6, 0.8])[:, None]
    np.testing.assert_allclose(robot.points_deg, np.vstack([up, down]), atol=1e-9)
    np.testing.assert_allclose(robot.time_s, QUARTER_S * np.array([0, 1, 2, 4, 5, 6, 7, 8, 9]))


def test_a_longer_correction_takes_as_many_steps_as_it_needs():
    """10.8 deg are two steps: each corner then cuts half as much of the way."""
    made = plan_corrections(ALONE, [[100.0, 90.0]], [[110.0, 90.0]], approach_deg=0.8)
    (robot,) = made.robots
    done = np.array([0.0, 1 / 32, 1 / 8, 7 / 8, 31 / 32, 1.0])
    np.testing.assert_allclose(robot.points_deg[:6, 0], 100.0 + 10.8 * done, atol=1e-9)
    np.testing.assert_allclose(robot.time_s, QUARTER_S * np.array([0, 1, 2, 8, 9, 10, 11, 12, 13]))


def test_the_time_that_planning_took_is_within_the_time_of_the_call():
    begin = time.thread_time()
    made = plan_corrections(ALONE, [[100.0, 90.0]], [[101.0, 90.0]])
    assert 0.0 < made.cpu_s <= time.thread_time() - begin


def test_defaults_are_those_of_the_compiled_planner():
    settings = core.Settings(**PlanSettings().of(ALONE).dynamics)
    names = ("clearance_mm", "in_hand_mm", "first_deadline", "last_deadline", "effort")
    assert {n: getattr(PlanSettings(), n) for n in names} == {n: getattr(settings, n) for n in names}
