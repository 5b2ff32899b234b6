"""Approaches from below: where an approach is negative, every motion ends in the positive direction."""

from dataclasses import replace

import numpy as np
import pytest

from fiberloom.assignment import assign
from fiberloom.assignment.candidates import inside_stops
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.axis import Ranges
from fiberloom.planning import plan, plan_corrections, verify
from fiberloom.planning.fields import random_configuration
from fiberloom.targets import random_targets

HEIGHT_DEG = 3.0


@pytest.fixture(scope="module")
def desi():
    return FocalPlane.of("desi", n=37)


@pytest.fixture(scope="module")
def moved(desi):
    """A whole move, from folded to places that targets have."""
    found = assign(desi, random_targets(desi, 111, 3))
    return found.goal_deg, plan(desi, desi.park_deg, found.goal_deg)


def last_ways(made):
    """(n, 2) deg by which the last leg of each positioner that moves goes."""
    legs = [
        (r.alpha_deg[-1] - r.alpha_deg[-2], r.beta_deg[-1] - r.beta_deg[-2]) for r in made.robots if r.moves
    ]
    return np.array(legs)


def test_theta_ends_in_the_negative_and_phi_in_the_positive_direction(desi, moved):
    goal_deg, made = moved
    assert verify(desi, made, start_deg=desi.park_deg, goal_deg=goal_deg, approach_deg=HEIGHT_DEG).ok
    assert not made.refused
    usual = [r for r in made.robots if r.moves and r.approach is None]
    assert len(usual) > 25
    for robot in usual:
        assert robot.alpha_deg[-2] - robot.alpha_deg[-1] == pytest.approx(HEIGHT_DEG, abs=1e-6)
        assert robot.beta_deg[-2] - robot.beta_deg[-1] == pytest.approx(-HEIGHT_DEG, abs=1e-6)
    for own in made.approaches.values():
        assert own.height_deg[0] > 0.0 > own.height_deg[1]


def test_so_do_corrections(desi, moved):
    goal_deg, _ = moved
    small = goal_deg + np.random.default_rng(0).uniform(-0.2, 0.2, goal_deg.shape)
    stays = np.abs(small - desi.park_deg).max(axis=1) < 1.0
    small = np.where(stays[:, None], goal_deg, np.clip(small, desi.limits_deg[:, 0], desi.limits_deg[:, 1]))
    made = plan_corrections(desi, goal_deg, small)
    ways = last_ways(made)
    assert len(ways) > 20
    np.testing.assert_allclose(ways, np.tile([-HEIGHT_DEG, HEIGHT_DEG], (len(ways), 1)), atol=1e-6)


def test_the_verifier_finds_the_wrong_side(desi, moved):
    goal_deg, made = moved
    above = desi.instrument.beta.model_copy(
        update={"approach_deg": HEIGHT_DEG, "hard_stop_deg": (-6.2, 190.0)}
    )
    other = replace(desi, instrument=desi.instrument.model_copy(update={"beta": above}))
    seen = verify(other, made, goal_deg=goal_deg, approach_deg=HEIGHT_DEG).violations
    wrong = {v.positioner_id for v in seen if v.kind == "approach"}
    assert wrong == {r.positioner_id for r in made.robots if r.moves}


def test_the_room_for_the_approach_is_on_its_side(desi):
    rows = np.zeros(4, dtype=np.int64)
    low, high = desi.hard_stops_deg.T
    goals = np.array([[high[0] - 3.1, 90.0], [high[0] - 2.9, 90.0], [0.0, low[1] + 2.9], [0.0, low[1] + 3.1]])
    assert inside_stops(desi, rows, goals, HEIGHT_DEG).tolist() == [True, False, False, True]


@pytest.mark.parametrize("name", ["pfs", "megara", "moons"])
def test_fields_of_the_other_elbow_are_planned_and_verified(name):
    plane = FocalPlane.of(name, n=37)
    start, goal = (random_configuration(plane, seed) for seed in (1, 2))
    assert (goal[:, 1] < 0.0).all() == (name != "moons")
    made = plan(plane, start, goal)
    assert verify(plane, made, start_deg=start, goal_deg=goal).ok
    assert len(made.refused) < 6


def test_both_elbows_are_offered_where_both_are_allowed():
    plane = FocalPlane.of("moons", n=37)
    found = assign(plane, random_targets(plane, 148, 5))
    beta = found.beta_deg[found.target >= 0]
    assert (beta < 180.0).any()
    assert (beta > 180.0).any()


def test_a_unit_is_kept_within_its_own_travel():
    plane = FocalPlane.of("sdssv", n=7)
    targets, stops = plane.limits_of().copy(), plane.stops_of().copy()
    targets[3, 0], stops[3, 0] = (0.0, 90.0), (-4.0, 94.0)
    own = replace(plane, ranges=Ranges(targets, stops))
    goal = plane.park_deg.copy()
    goal[:, 0] = 120.0
    assert plan(plane, plane.park_deg, goal).refused == {}
    made = plan(own, plane.park_deg, goal)
    number = int(plane.positioner_id[3])
    assert list(made.refused) == [number]
    assert "alpha needs 120 to" in made.refused[number]
    assert "has -3 to 93 deg" in made.refused[number]
    # and the verifier holds the same plan of the others against it
    seen = verify(own, plan(plane, plane.park_deg, goal)).violations
    assert {(v.kind, v.positioner_id) for v in seen} == {("travel", number), ("stops", number)}
