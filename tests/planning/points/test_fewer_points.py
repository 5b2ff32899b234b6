"""No axis gets more points over the bus than it should, and what is sent keeps clear."""

from dataclasses import replace

import numpy as np

from fiberloom.bus import WireTrajectory
from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import PlanSettings, plan, random_pair, verify
from fiberloom.planning.trajectories import Trajectory
from fiberloom.units import TICK_S

MOST_POINTS = 40
BUFFER_MM = 3.0
DEG_PER_COUNT = 360.0 / 2**30


def as_sent(robot: Trajectory) -> Trajectory:
    """Of each axis the points that go over the bus, in counts and ticks, and straight lines between them."""
    if not robot.moves:
        return robot
    corners = robot.corners(0), robot.corners(1)
    wire = WireTrajectory.from_deg(robot.time_s, robot.alpha_deg, robot.beta_deg, corners)
    time_s = np.union1d(wire.alpha[:, 1], wire.beta[:, 1]) * TICK_S
    alpha, beta = (
        np.interp(time_s, axis[:, 1] * TICK_S, axis[:, 0] * DEG_PER_COUNT) for axis in (wire.alpha, wire.beta)
    )
    return replace(robot, time_s=time_s, alpha_deg=alpha, beta_deg=beta)


def test_an_axis_that_waits_again_and_again_leaves_points_out_and_keeps_clear():
    """Without a limit an axis of one of these would have 60 points."""
    plane = generate(load_instrument("sdssv"), seed=0, n_positioners=37)
    start_deg, goal_deg = random_pair(plane, seed=21, collision_buffer_mm=BUFFER_MM)
    settings = PlanSettings(collision_buffer_mm=BUFFER_MM)
    made = plan(plane, start_deg, goal_deg, seed=21, settings=settings)
    assert made.refused == {}
    assert 30 < max(made.points_per_axis) <= MOST_POINTS
    sent = replace(made, robots=tuple(as_sent(robot) for robot in made.robots))
    for motion in (made, sent):
        assert verify(plane, motion, start_deg=start_deg, goal_deg=goal_deg).ok


def test_the_fewer_points_the_nearer_the_others_but_never_too_near():
    """Without a look at the others, or at the change of speed, no plan of 12 points passes the verifier."""
    plane = generate(load_instrument("sdssv"), seed=0, n_positioners=37)
    start_deg, goal_deg = random_pair(plane, seed=0, collision_buffer_mm=BUFFER_MM)
    usual, few = (
        plan(
            plane, start_deg, goal_deg, settings=PlanSettings(collision_buffer_mm=BUFFER_MM, most_points=most)
        )
        for most in (MOST_POINTS, 12)
    )
    assert few.refused == {}
    assert verify(plane, few, start_deg=start_deg, goal_deg=goal_deg).ok
    assert few.duration_s == usual.duration_s
    assert max(few.points_per_axis) < 20 < max(usual.points_per_axis)
