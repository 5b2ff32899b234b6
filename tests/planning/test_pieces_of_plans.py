"""Pieces of planning by themselves: travel, margins, corners, times."""

import inspect

import numpy as np
import pytest
from fields import field

from fiberloom.bus.trajectory import WireTrajectory
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import Plan, Trajectory, plan, random_configuration, random_pair, verify
from fiberloom.planning.bodies import BEYOND_RANGE_DEG, travel_rad
from fiberloom.planning.trajectories import corners_of
from fiberloom.planning.untangling import _corners
from fiberloom.units import COUNTS_PER_DEG


@pytest.mark.parametrize("name", ["sdssv", "pfs", "moons", "desi", "lamost"])
def test_an_axis_goes_as_far_as_targets_and_their_approach_need_and_little_farther(name):
    plane = generate(load_instrument(name), 0, n_positioners=3)
    (low, high), approach = np.rad2deg(travel_rad(plane)).T, [a.approach_deg for a in plane.instrument.axes]
    below, above = np.minimum(approach, 0.0), np.maximum(approach, 0.0)
    assert (low <= plane.limits_deg[:, 0] + below + 1e-9).all()
    assert (high >= plane.limits_deg[:, 1] + above - 1e-9).all()
    # four degrees below and ten above the range, and a degree off the stops, unless targets need it; ten
    # below and four above where an axis comes from below, or folds there
    other = np.array([False, name in ("pfs", "desi")])
    assert (low >= plane.limits_deg[:, 0] - np.where(other, 10.0, 4.0) - 1e-9).all()
    assert (high <= plane.limits_deg[:, 1] + np.where(other, 4.0, 10.0) + 1e-9).all()
    off_low, off_high = low - plane.hard_stops_deg[:, 0], plane.hard_stops_deg[:, 1] - high
    assert ((off_low >= 1.0 - 1e-9) | np.isclose(low, plane.limits_deg[:, 0] + below)).all()
    assert ((off_high >= 1.0 - 1e-9) | np.isclose(high, plane.limits_deg[:, 1] + above)).all()
    np.testing.assert_array_equal(BEYOND_RANGE_DEG, [-4.0, 10.0])


@pytest.mark.parametrize("margin_mm", [0.2, 1.0])
def test_random_places_keep_their_margin(margin_mm):
    plane = field(37)
    angles = random_configuration(plane, 5, margin_mm=margin_mm)
    at_rest = tuple(
        Trajectory(int(p), np.zeros(1), a[:1], a[1:])
        for p, a in zip(plane.positioner_id, angles, strict=True)
    )
    found = verify(plane, Plan("sdssv", plane.collision_buffer_mm, at_rest))
    assert found.min_robot_clearance_mm >= margin_mm - 1e-9
    assert found.min_obstacle_clearance_mm >= margin_mm - 1e-9


@pytest.mark.parametrize("seed", range(2))
def test_each_of_a_pair_gets_there_alone(seed):
    plane = field(19)
    start, goal = random_pair(plane, seed)
    for row in range(plane.n):
        assert not plan(plane.select([row]), start[[row]], goal[[row]]).refused


def test_corners_are_both_ends_and_where_the_direction_changes():
    points = np.array([[0, 0], [1, 0], [2, 0], [3, 1], [4, 2], [4, 3], [4, 4]], dtype=float)
    np.testing.assert_array_equal(_corners(points), [0, 2, 4, 6])
    np.testing.assert_array_equal(_corners(points[:3]), [0, 2])
    np.testing.assert_array_equal(_corners(points[2:5]), [0, 2])


def test_a_trajectory_is_asked_at_one_time_or_at_many():
    way = Trajectory(1, np.array([0.0, 2.0]), np.array([10.0, 30.0]), np.array([50.0, 40.0]))
    np.testing.assert_allclose(way.at(0.5), [15.0, 47.5])
    np.testing.assert_allclose(way.at([-1.0, 0.5, 9.0]), [[10.0, 50.0], [15.0, 47.5], [30.0, 40.0]])


def test_pairs_keep_the_margin_of_single_configurations():
    """`margin_mm` as in `random_configuration`: also where it is left out."""
    margins = [
        inspect.signature(f).parameters["margin_mm"].default for f in (random_pair, random_configuration)
    ]
    assert margins[0] == margins[1]
    plane = field(19)
    np.testing.assert_array_equal(random_pair(plane, 0)[0], random_pair(plane, 0, margin_mm=margins[1])[0])


def way(rng, points):
    time_s = np.cumsum(rng.uniform(0.01, 0.3, points))
    alpha_deg = np.cumsum(rng.choice([0.0, 1e-9, 1.0, 1.0], points)) + 1e-6 * rng.choice([0, 1]) * time_s**2
    return Trajectory(1, time_s, alpha_deg, 3.0 * time_s)


def test_corners_of_many_ways_are_those_of_each_alone_and_all_others_are_straight():
    rng = np.random.default_rng(4)
    ways = [way(rng, int(points)) for points in rng.integers(1, 40, 60)]
    for robot, (alpha, beta) in zip(ways, corners_of(ways), strict=True):
        np.testing.assert_array_equal(alpha, robot.corners(0))
        assert beta.tolist() == sorted({0, len(robot.time_s) - 1})
        drawn_deg = np.interp(robot.time_s, robot.time_s[alpha], robot.alpha_deg[alpha])
        assert np.abs(drawn_deg - robot.alpha_deg).max() * COUNTS_PER_DEG < 0.5


def test_ways_on_the_wire_are_the_same_one_by_one_and_together():
    rng = np.random.default_rng(5)
    ways = [way(rng, int(points)) for points in rng.integers(1, 20, 9)]
    paths, corners = [robot.points_deg for robot in ways], corners_of(ways)
    together = WireTrajectory.all_from_deg([robot.time_s for robot in ways], paths, corners)
    for robot, rows, sent in zip(ways, corners, together, strict=True):
        alone = WireTrajectory.from_deg(robot.time_s, robot.alpha_deg, robot.beta_deg, rows)
        np.testing.assert_array_equal(sent.alpha, alone.alpha)
        np.testing.assert_array_equal(sent.beta, alone.beta)
    with pytest.raises(InputError, match="beta: angles must be within"):
        WireTrajectory.all_from_deg([np.zeros(1)], [np.array([[0.0, 1e9]])], [(np.arange(1), np.arange(1))])
