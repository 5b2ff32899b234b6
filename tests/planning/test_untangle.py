"""Collided fields are taken apart, by motions in which what overlaps only parts."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fields import _lines, field, signed

from fiberloom.errors import InputError
from fiberloom.instruments.model import BODY_SHARE
from fiberloom.planning import (
    MotionLimits,
    Plan,
    PlanSettings,
    Trajectory,
    UntangleSettings,
    plan,
    random_configuration,
    untangle,
    untangling,
    verify,
)
from fiberloom.planning.crashes import KINDS, random_crash

BUFFER_MM = 2.0


@cache
def untangled(kind: str, seed: int, n: int = 37):
    crash = random_crash(field(n), seed, kind)
    return crash, untangle(crash.plane, crash.start_deg, seed=seed)


def assert_verified(plane, found) -> None:
    here = found.start_deg
    for stage in found.stages:
        limits = MotionLimits(separating=stage.separates)
        seen = verify(plane, stage.plan, start_deg=here, limits=limits)
        assert seen.ok, f"{stage.what}: {seen}"
        here = stage.plan.end_deg
    np.testing.assert_array_equal(here, found.end_deg)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", [k for k in KINDS if k != "immobile"])
def test_a_collided_field_is_taken_apart_and_folded(kind, seed):
    crash, found = untangled(kind, seed)
    assert len(found.overlaps) >= (2 if kind == "knot" else 1)
    assert (found.free, found.stuck, found.refused) == (True, {}, {})
    assert_verified(crash.plane, found)
    np.testing.assert_allclose(found.end_deg, crash.plane.park_deg, atol=1e-8)
    assert "of positioner" in found.stages[0].what
    assert found.stages[0].separates
    assert not found.stages[-1].separates


@pytest.mark.parametrize("seed", range(3))
def test_one_that_cannot_move_is_left_where_it_is(seed):
    crash, found = untangled("immobile", seed)
    assert found.free
    assert_verified(crash.plane, found)
    (row,) = crash.culprits
    assert crash.plane.offline[row]
    assert not any(stage.plan.robots[row].moves for stage in found.stages)
    for number, why in found.refused.items():  # their place is taken, or they are fenced in
        assert number != crash.plane.positioner_id[row]
        assert "does not move" in why or "stands still" in why


@pytest.mark.parametrize("kind", ["two arms", "knot", "fiducial"])
def test_retreats_are_small_slow_and_only_part_what_overlaps(kind):
    """Against gaps that are sampled densely, in numpy alone."""
    crash, found = untangled(kind, 1)
    retreats = [stage for stage in found.stages if stage.separates]
    assert len(retreats) <= (2 if kind == "knot" else 1)
    for stage in retreats:
        (mover,) = [robot for robot in stage.plan.robots if robot.moves]
        assert np.abs(mover.points_deg[-1] - mover.points_deg[0]).max() < 12.0
        # 1 deg/s, on a grid of which each step is a whole number of ticks
        found_speed = verify(crash.plane, stage.plan, limits=MotionLimits(separating=True)).top_speed_deg_s
        assert found_speed == pytest.approx(1.0, abs=1e-4)
        assert lowest_rise(crash.plane, stage.plan) > -1e-3


def lowest_rise(plane, made) -> float:
    """By how much a gap falls at most below the largest until then, mm; of gaps above 0: below 0."""
    times = np.linspace(0.0, made.duration_s, 2000)
    lines = [_lines(plane, k, robot.at(times)) for k, robot in enumerate(made.robots)]
    gaps = [signed(lines[i], lines[j]) - 2 * BUFFER_MM for i, j in plane.neighbour_pairs()]
    for x, y, radius in plane.fiducials:
        disc = np.array([[x, y, x + 1e-9, y]] * len(times))
        near = np.flatnonzero(np.hypot(*(plane.centres_mm - (x, y)).T) < 30.0)
        gaps += [signed(lines[k], disc) - BUFFER_MM - radius for k in near]
    return min(float((g - np.minimum(np.maximum.accumulate(g), 0.0)).min()) for g in gaps)


@pytest.mark.parametrize("seed", range(4))
def test_nothing_new_touches_where_the_arms_really_are(seed):
    """Each arm is up to 0.1 deg from where it is said to be; bodies as thick as they are, without buffer."""
    crash, found = untangled("two arms", seed)
    off = np.random.default_rng(seed).uniform(-0.1, 0.1, (crash.plane.n, 2))
    limits = MotionLimits(1e9, 1e9, BODY_SHARE * BUFFER_MM, separating=True)
    for stage in found.stages:
        robots = [
            Trajectory(r.positioner_id, r.time_s, r.alpha_deg + a, r.beta_deg + b)
            for r, (a, b) in zip(stage.plan.robots, off, strict=True)
        ]
        assert not verify(crash.plane, replace(stage.plan, robots=tuple(robots)), limits=limits).collisions


def test_retreats_are_proven_for_angles_that_are_not_exact():
    _, found = untangled("two arms", 0)
    assert [s.uncertainty_deg for s in found.stages if s.separates] == [0.2]
    crash = random_crash(field(37), 0)
    sure = untangle(crash.plane, crash.start_deg, settings=UntangleSettings(uncertainty_deg=0.0))
    assert [s.uncertainty_deg for s in sure.stages if s.separates] == [0.0]


@pytest.mark.parametrize(
    ("seed", "what"),
    [
        (56, "retreat of positioner 204"),  # another is in its way, farther off
        (78, "positioner 206 aside"),  # it overlaps nothing, and moves no farther than room is needed
        (
            92,
            "retreat of positioner 298",
        ),  # the other presses on its elbow, in the direction of its alpha arm
    ],
)
def test_an_arm_that_is_wedged_against_a_dead_one_is_freed(seed, what):
    crash, found = untangled("immobile", seed)
    assert (found.free, found.stuck) == (True, {})
    assert what in [stage.what for stage in found.stages]
    assert_verified(crash.plane, found)


def test_what_is_stuck_is_tried_again_when_others_have_gone_to_their_goals(monkeypatch):
    """With all else that would free it taken away."""
    monkeypatch.setattr(untangling, "WINDOWS", untangling.WINDOWS[:-1])
    monkeypatch.setattr(untangling._Untangling, "_step_aside", lambda self, pairs: False)
    crash = random_crash(field(37), 56, "immobile")
    found = untangle(crash.plane, crash.start_deg, seed=56)
    assert found.free
    goes = [stage.what for stage in found.stages].index("to the goal")
    assert "retreat of positioner 204" in [stage.what for stage in found.stages[goes:]]
    assert_verified(crash.plane, found)


def mess(seed: int, n: int = 37, least_beta_deg: float = 60.0) -> np.ndarray:
    """Angles without regard to anything: arms lie on and across each other."""
    low, high = field(n).limits_deg.T
    return np.random.default_rng(seed).uniform(low + np.array([0.0, least_beta_deg]), high, (n, 2))


@pytest.mark.parametrize("seed", [5, 8])
def test_one_that_is_asked_to_step_aside_in_vain_stays_at_its_goal(seed):
    """Its path was taken back while another hurried; its motion ended 0.82 deg below its goal."""
    plane = field(37)
    found = untangle(plane, mess(seed, least_beta_deg=0.0), seed=seed)
    assert (found.stuck, found.refused) == ({}, {})
    assert_verified(plane, found)
    np.testing.assert_allclose(found.end_deg, plane.park_deg, atol=1e-8)


@pytest.mark.parametrize("seed", [0, 2, 7])
def test_whole_heaps_are_taken_apart_one_by_one(seed):
    plane = field(37)
    found = untangle(plane, mess(seed), seed=seed)
    assert len(found.overlaps) >= 5
    assert max(found.overlaps.values()) > 4.0  # arms that cross
    assert found.free
    assert_verified(plane, found)
    folds = [stage.what for stage in found.stages if stage.what == "fold the neighbours"]
    assert len(folds) == (1 if seed == 7 else 0)


def test_what_cannot_be_parted_is_named_and_the_others_fold():
    crash = random_crash(field(19), 4)
    arms = random_crash(field(19), 4, "two arms")
    found = untangle(crash.plane, crash.start_deg)
    (names,) = found.overlaps
    ids = [int(name.split()[-1]) for name in names]
    rows = arms.plane.index_of(ids)
    dead = arms.plane.with_offline(ids, arms.start_deg[rows])
    stuck = untangle(dead, arms.start_deg)
    assert not stuck.free
    assert set(stuck.stuck) == set(ids)
    assert all("no way apart was found" in why and "offline" in why for why in stuck.stuck.values())
    assert_verified(dead, stuck)
    folded = np.abs(stuck.end_deg - dead.park_deg).max(axis=1) < 1e-8
    assert folded.sum() >= 19 - 2 - len(stuck.refused)


def test_a_goal_of_its_own_is_reached():
    crash = random_crash(field(37), 5)
    goal = random_configuration(crash.plane, 105)
    found = untangle(crash.plane, crash.start_deg, goal, seed=5)
    assert found.free
    assert_verified(crash.plane, found)
    arrived = np.abs(found.end_deg - goal).max(axis=1) < 1e-8
    assert {int(p) for p in crash.plane.positioner_id[~arrived]} == set(found.refused)
    assert arrived.sum() >= 36


def test_where_nothing_overlaps_it_is_an_ordinary_plan_of_little_effort():
    plane = field(37)
    start = random_configuration(plane, 3)
    found = untangle(plane, start, seed=3)
    (stage,) = found.stages
    assert found.overlaps == {}
    settings = PlanSettings(effort=untangling._EFFORT)
    assert stage.plan.to_json() == plan(plane, start, plane.park_deg, seed=3, settings=settings).to_json()


def test_the_same_seed_gives_the_same_stages():
    crash, found = untangled("knot", 2)
    again = untangle(crash.plane, crash.start_deg, seed=2)
    assert [s.plan.to_json() for s in again.stages] == [s.plan.to_json() for s in found.stages]


def test_crashes_are_as_deep_as_bodies_that_touch():
    plane = field(37)
    for seed in range(4):
        crash = random_crash(plane, seed)
        here = tuple(
            Trajectory(int(p), np.zeros(1), a[:1], a[1:])
            for p, a in zip(plane.positioner_id, crash.start_deg, strict=True)
        )
        at_rest = verify(plane, Plan("sdssv", BUFFER_MM, here))
        assert -1.31 < at_rest.min_robot_clearance_mm < -0.99
        assert at_rest.ok
    with pytest.raises(InputError, match="known are buffer"):
        random_crash(plane, 0, "pile")
