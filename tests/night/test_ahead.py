"""A plan made ahead is used where it is right from the true start, and only there."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.calibration.transmission.nominal import nominal_maps
from fiberloom.connect import twin_source
from fiberloom.drive.port import Wanted
from fiberloom.drive.sdssv import SdssvDrive
from fiberloom.operation.series.ahead import AHEAD, BLEND_S, PlannedAhead
from fiberloom.planning import plan_in_waves


@pytest.fixture(scope="module")
def parts():
    plane = fl.FocalPlane.of("sdssv", n=7)
    goal = plane.park_deg + np.array([20.0, -40.0])
    hardware = asyncio.run(twin_source(plane, 0, "noise", "").open())
    drive = SdssvDrive(plane, nominal_maps(plane), hardware.bus)
    wanted = Wanted(plane, plane.park_deg, goal, np.full(7, plane.instrument.approach_deg))
    plan = fl.plan(plane, wanted.here_deg, goal, approach_deg=wanted.approach_deg)
    return drive, wanted, plan


def ahead(wanted, plan):
    return PlannedAhead(plan, wanted.here_deg, wanted.goal_deg)


def dead(wanted, row):
    """The layout with one that gives no answer, at its goal."""
    return replace(wanted.obstacles, offline=np.arange(7) == row, offline_position_deg=wanted.goal_deg)


def asked(drive, made, wanted):
    return asyncio.run(made.programme(drive, wanted))


def test_it_begins_where_positioners_truly_are(parts):
    drive, wanted, plan = parts
    off = np.random.default_rng(0).uniform(-0.1, 0.1, (7, 2))
    made = ahead(wanted, plan)
    programme = asked(drive, made, replace(wanted, here_deg=wanted.here_deg + off))
    assert made.told == AHEAD
    for robot, was, here in zip(programme.plan.robots, plan.robots, wanted.here_deg + off, strict=True):
        assert robot.points_deg[0] == pytest.approx(here)
        late = was.time_s >= BLEND_S
        np.testing.assert_array_equal(robot.points_deg[late], was.points_deg[late])
    np.testing.assert_array_equal(programme.plan.end_deg, plan.end_deg)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda w: {"here_deg": w.here_deg + np.eye(7)[:, [2, 3]] * 0.2}, "is 0.20 deg from where it was"),
        (lambda w: {"goal_deg": w.goal_deg + np.eye(7)[:, [2, 3]]}, "has another goal"),
        (lambda w: {"obstacles": dead(w, 3)}, "cannot be moved any more"),
        (lambda w: {"obstacles": w.obstacles.with_collision_buffer(1.7)}, "the collision buffer is another"),
    ],
)
def test_it_is_not_used_where_something_differs(parts, change, words):
    drive, wanted, plan = parts
    made = ahead(wanted, plan)
    assert asked(drive, made, replace(wanted, **change(wanted))) is None
    assert words in made.told


def test_it_is_proven_from_the_true_start(parts):
    """An arm that does not follow any more is in the way: the verifier finds it, not the comparison."""
    drive, wanted, plan = parts
    centre = wanted.obstacles
    obstacle = np.array([[*centre.centres_mm[0], centre.body_reach_mm[0]]])
    blocked = replace(centre, fiducials=np.vstack([centre.fiducials, obstacle]))
    made = ahead(wanted, plan)
    assert asked(drive, made, replace(wanted, obstacles=blocked)) is None
    assert made.told.startswith("not proven from the true start")


def test_it_is_not_used_where_the_true_start_takes_more_than_the_supply_gives(parts):
    """Who waits for a later wave would turn from the start, by as much as it is off."""
    drive, wanted, _ = parts
    motors = {"motor_friction_A": (0.01, 0.01), "supply_A": 0.04}
    care = wanted.obstacles.instrument.care.model_copy(update=motors)
    plane = replace(
        wanted.obstacles, instrument=wanted.obstacles.instrument.model_copy(update={"care": care})
    )
    waves = plan_in_waves(plane, wanted.here_deg, wanted.goal_deg, most=2, approach_deg=wanted.approach_deg)
    as_expected = replace(wanted, obstacles=plane)
    assert asked(drive, ahead(wanted, waves), as_expected) is not None
    made = ahead(wanted, waves)
    assert asked(drive, made, replace(as_expected, here_deg=wanted.here_deg + 0.1)) is None
    assert "more than the supply gives from the true start: the motors take 0." in made.told
