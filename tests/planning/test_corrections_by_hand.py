"""Corrections of one positioner, worked out by hand; and defaults that two places share."""

import time

import numpy as np
from fields import field

from fiberloom._core import planning as core
from fiberloom.planning import PlanSettings, plan_corrections

ALONE = field(7).select([0])
QUARTER_S = 0.125
"""5.85 deg/step at 11.7 deg/s last 0.5 s, four quarters of 0.125 s; 2 x 5.85 / 47 deg/s^2 need less."""


def test_a_correction_within_one_step_rises_and_comes_down():
    made = plan_corrections(ALONE, [[100.0, 90.0]], [[101.0, 88.0]], approach_deg=0.8)
    (robot,) = made.robots
    # way to the place above the goal: (1.8, -1.2); corners cut to 1/4 of the way, and from 3/4 of it
    done = np.array([0.0, 1 / 4, 3 / 4, 1.0])
    up = np.array([100.0, 90.0]) + done[:, None] * [1.8, -1.2]
    np.testing.assert_allclose(robot.points_deg, [*up, [101.0, 88.0]], atol=1e-9)
    # 0.8 deg at most at a third of 11.7 deg/s: 0.205 s, two quarters
    np.testing.assert_allclose(robot.time_s, QUARTER_S * np.array([0, 2, 4, 6, 8]))


def test_a_longer_correction_takes_as_many_steps_as_it_needs():
    """10.8 deg are two steps: each corner then cuts half as much of the way."""
    made = plan_corrections(ALONE, [[100.0, 90.0]], [[110.0, 90.0]], approach_deg=0.8)
    (robot,) = made.robots
    done = np.array([0.0, 1 / 8, 7 / 8, 1.0])
    np.testing.assert_allclose(robot.points_deg[:4, 0], 100.0 + 10.8 * done, atol=1e-9)
    np.testing.assert_allclose(robot.time_s, QUARTER_S * np.array([0, 2, 8, 10, 12]))


def test_the_time_that_planning_took_is_within_the_time_of_the_call():
    begin = time.thread_time()
    made = plan_corrections(ALONE, [[100.0, 90.0]], [[101.0, 90.0]])
    assert 0.0 < made.cpu_s <= time.thread_time() - begin


def test_defaults_are_those_of_the_compiled_planner():
    settings = core.Settings(**PlanSettings().of(ALONE).dynamics)
    names = ("clearance_mm", "in_hand_mm", "first_deadline", "last_deadline", "effort")
    assert {n: getattr(PlanSettings(), n) for n in names} == {n: getattr(settings, n) for n in names}
