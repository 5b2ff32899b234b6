"""The verifier finds every planted fault, and nothing in plans that are clean."""

from dataclasses import replace

import numpy as np
import pytest
from fields import _lines, _segments, field
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fiberloom._core import planning as core
from fiberloom.planning import MotionLimits, Plan, Trajectory, verify
from fiberloom.planning.obstacles import plain_parts

PLANE = replace(field(2), fiducials=np.zeros((0, 3)), guide_cameras=np.zeros((0, 5)))
"""Two neighbours and nothing else."""
BOTH = tuple(int(p) for p in PLANE.positioner_id)
FREE = PLANE.select([0])
ANY = MotionLimits(speed_deg_s=1e9, acceleration_deg_s2=1e12)
"""Limits that nothing breaks: only the bodies are looked at."""


def plan_of(*motions) -> Plan:
    """One (time, alpha, beta) table per positioner."""
    robots = [Trajectory(p, *np.array(m, dtype=float).T) for p, m in zip(BOTH, motions, strict=True)]
    return Plan("sdssv", 2.0, tuple(robots))


def kinds(found) -> set[str]:
    return {v.kind for v in found.violations}


def sampled(plan: Plan, times) -> np.ndarray:
    lines = [_lines(PLANE, k, robot.at(times)) for k, robot in enumerate(plan.robots)]
    return _segments(*lines) - 2 * plan.collision_buffer_mm


angle = st.floats(0.0, 350.0)
elbow = st.floats(0.0, 180.0)
motion = st.lists(st.tuples(st.floats(0.05, 3.0), angle, elbow), min_size=1, max_size=5)


def table(steps) -> np.ndarray:
    rows = np.array(steps)
    rows[:, 0] = np.cumsum(rows[:, 0]) - rows[0, 0]
    return rows


@example([(1.0, 0.0, 0.0)], [(1.0, 1.0, 0.0), (2.0, 0.0, 0.0), (1.0, 0.0, 1.0)])  # found 3e-5 mm too wide
@settings(max_examples=80, deadline=None)
@given(motion, motion)
def test_the_verifier_agrees_with_dense_sampling(first, second):
    """Samples can miss the deepest moment only by how far the arms go between two of them."""
    plan = plan_of(table(first), table(second))
    found = verify(PLANE, plan, limits=ANY)
    gaps = sampled(plan, np.linspace(0.0, plan.duration_s, 4001))
    way = sum(
        np.abs(np.radians(np.diff(r.points_deg, axis=0)) @ [[22.5, 0], [15, 15]]).sum(axis=1).max()
        if r.moves
        else 0.0
        for r in plan.robots
    )
    # a whole segment may lie between two samples if it is short: its way bounds the miss
    steps = [np.diff(r.time_s).min() for r in plan.robots if r.moves]
    miss = way * min(1.0, plan.duration_s / 4000 / min(steps)) if steps else 0.0
    lowest = gaps.min()
    # the gap is found to 1e-4 mm, as documented; whether it is a touch, to 1e-6 mm
    assert found.min_robot_clearance_mm <= lowest + 1e-4
    assert found.collisions or found.contacts or lowest >= -1e-6
    assert found.min_robot_clearance_mm >= lowest - miss - 2e-4
    assert bool(found.collisions or found.contacts) == (found.min_robot_clearance_mm < -1e-6)


def facing() -> tuple[float, float]:
    """Alpha of each that points its stretched arm at the other's centre."""
    towards = np.degrees(np.arctan2(*(PLANE.centres_mm[1] - PLANE.centres_mm[0])[::-1]))
    off = np.degrees(PLANE.arms[:, 3])
    return (towards - off[0]) % 360.0, (towards + 180.0 - off[1]) % 360.0


def touching_alpha() -> float:
    """The alpha of the first, its arm stretched, at which it just touches the folded second."""
    alpha, other = facing()
    low, high = alpha, alpha + 120.0
    for _ in range(60):
        middle = (low + high) / 2
        gap = sampled(plan_of([(0, middle, 0.0)], [(0, other, 180.0)]), [0.0])[0]
        low, high = (middle, high) if gap < 0 else (low, middle)
    return high


@pytest.mark.parametrize("dwell_s", [1.0, 1e-3, 1e-6])
@pytest.mark.parametrize("deeper_deg", [1.0, 1e-2, 1e-4, 1e-5])
def test_a_planted_collision_is_found_however_short_and_shallow(deeper_deg, dwell_s):
    alpha, other = touching_alpha(), facing()[1]
    away, at = alpha + 20.0, alpha - deeper_deg
    times = np.cumsum([0.0, 3.0, dwell_s / 2, dwell_s / 2, 3.0])
    first = np.column_stack([times, [away, alpha + 1e-4, at, alpha + 1e-4, away], np.zeros(5)])
    plan = plan_of(first, [(0.0, other, 180.0)])
    found = verify(PLANE, plan, limits=ANY)
    assert not found.ok
    (hit,) = found.collisions
    assert {str(hit.positioner_id), hit.other} == {str(p) for p in BOTH}
    assert found.at_fault == set(BOTH)
    np.testing.assert_allclose(hit.time_s, times[2], atol=dwell_s)
    np.testing.assert_allclose(hit.depth, -sampled(plan, times)[2], atol=2e-4)
    assert hit.depth > 0.0


def test_coming_within_a_hair_is_no_collision():
    alpha, other = touching_alpha() + 1e-5, facing()[1]
    first = [(0.0, alpha + 20.0, 0.0), (3.0, alpha, 0.0), (6.0, alpha + 20.0, 0.0)]
    found = verify(PLANE, plan_of(first, [(0.0, other, 180.0)]), limits=ANY)
    assert found.ok
    assert 0.0 < found.min_robot_clearance_mm < 1e-4


def test_bodies_at_rest_that_touch_are_told_but_not_the_plans_fault():
    alpha, other = facing()
    found = verify(PLANE, plan_of([(0.0, alpha, 0.0)], [(0.0, other, 0.0)]))
    assert kinds(found) == {"contact"}
    assert found.ok
    assert found.at_fault == set()
    assert len(found.contacts) == 1


def test_an_obstacle_in_the_way_is_found_and_named():
    plane = field(100)
    gaps = plane.centres_mm[:, None] - plane.fiducials[None, :, :2]
    row, disc = np.unravel_index(np.argmin((gaps**2).sum(axis=2)), gaps.shape[:2])
    alone = plane.select([row])
    turn = [(0.0, 0.0, 30.0), (30.0, 360.0, 30.0)]  # sweeps its whole surroundings
    plan = Plan("sdssv", 2.0, (Trajectory(int(alone.positioner_id[0]), *np.array(turn).T),))
    found = verify(alone, plan)
    assert "obstacle" in kinds(found)
    assert f"fiducial {disc}" in {v.other for v in found.collisions}
    assert found.at_fault == {alone.positioner_id[0]}


def test_guide_cameras_are_bodies():
    x, y = PLANE.centres_mm[0]
    camera = replace(FREE, guide_cameras=np.array([[x + 25.0, y - 40, x + 25.0, y + 40, 3.0]]))
    plan = Plan("sdssv", 2.0, (Trajectory(BOTH[0], *np.array([(0, 0, 0), (35.0, 360.0, 0.0)]).T),))
    assert verify(FREE, plan, limits=ANY).ok
    assert {v.other for v in verify(camera, plan, limits=ANY).collisions} == {"guide camera 0"}


def alone(*points) -> Plan:
    return Plan("sdssv", 2.0, (Trajectory(int(FREE.positioner_id[0]), *np.array(points, float).T),))


RAMP = [(0.0, 50.0, 150.0), (0.25, 50.5, 150.5), (0.5, 52.0, 152.0), (0.75, 52.5, 152.5)]


def test_limits_are_checked():
    """Slopes of 2, 6, 2 deg/s with 16 deg/s2 between them (and 8 at the ends)."""
    assert verify(FREE, alone(*RAMP), limits=MotionLimits(6.001, 16.001)).ok
    found = verify(FREE, alone(*RAMP), limits=MotionLimits(5.9, 16.001))
    assert kinds(found) == {"speed"}
    assert found.at_fault == {FREE.positioner_id[0]}
    assert found.violations[0].depth == pytest.approx(0.1, abs=1e-9)
    found = verify(FREE, alone(*RAMP), limits=MotionLimits(6.001, 15.9))
    assert kinds(found) == {"acceleration"}
    assert (found.top_speed_deg_s, found.top_jump_deg_s) == pytest.approx((6.0, 4.0))
    assert found.top_acceleration_deg_s2 == pytest.approx(16.0)


def test_travel_is_checked_but_one_may_come_back_from_beyond():
    out = [(0.0, 363.0, 150.0), (1.0, 363.5, 150.0), (2.0, 364.5, 150.0)]
    assert kinds(verify(FREE, alone(*out))) == {"travel"}
    back = [(0.0, 366.0, 150.0), (1.0, 365.0, 150.0), (2.0, 360.0, 150.0)]
    assert verify(FREE, alone(*back)).ok


@pytest.mark.parametrize(
    "bad",
    [
        [(0.1, 50, 150), (1, 51, 150)],
        [(0, 50, 150), (1, 51, 150), (1, 52, 150)],
        [(0, 50, 150), (2, 51, 150), (1, 52, 150)],
        [(0, 50, 150), (1, np.nan, 150)],
        [(0, 50, 150), (np.inf, 51, 150)],
    ],
)
def test_points_that_are_no_trajectory_are_refused(bad):
    assert kinds(verify(FREE, alone(*bad))) == {"points"}


def test_start_goal_and_approach_are_checked():
    down = [*RAMP, (1.0, 52.25, 152.25), (1.25, 51.75, 151.75), (1.5, 51.5, 151.5)]
    good = {"start_deg": [[50.0, 150.0]], "goal_deg": [[51.5, 151.5]], "approach_deg": 1.0}
    assert verify(FREE, alone(*down), **good).ok
    for key, value, kind in (
        ("start_deg", [[50.0, 150.001]], "start"),
        ("goal_deg", [[51.501, 151.5]], "goal"),
        ("approach_deg", 1.01, "approach"),
    ):
        found = verify(FREE, alone(*down), **(good | {key: value}))
        assert kinds(found) == {kind}
    up_last = alone(*down, (3.0, 51.6, 151.5), (4.0, 51.5, 151.5))
    assert kinds(verify(FREE, up_last, approach_deg=1.0)) == {"approach"}


def turned(plane, angle_deg: float, mirror: bool):
    """The arms of a plane turned about the centre, then mirrored in x (angles change sign)."""
    arms = plane.arms.copy()
    z = (arms[:, 0] + 1j * arms[:, 1]) * np.exp(1j * np.radians(angle_deg))
    sign = -1.0 if mirror else 1.0
    arms[:, 0], arms[:, 1] = sign * z.real, z.imag
    arms[:, 3] = arms[:, 3] + np.radians(angle_deg)
    if mirror:
        arms[:, 3], arms[:, 4] = np.pi - arms[:, 3], -arms[:, 4]
    return arms, sign


@given(motion, motion, st.floats(-180.0, 180.0), st.booleans())
@settings(max_examples=30, deadline=None)
def test_a_turned_or_mirrored_field_has_the_same_gaps(first, second, angle_deg, mirror):
    def gap(arms, sign):
        motions = [table(m) * [1, np.radians(sign), np.radians(sign)] for m in (first, second)]
        wide = np.array([[-10.0, 10.0], [-10.0, 10.0]])
        bodies = core.Bodies(arms, plain_parts(len(arms), (0.0, 14.7276), 2.0), np.zeros((0, 7)))
        rules = core.Rules(speed=1e9, acceleration=1e12, rounding=1e-8, travel=wide)
        found = core.verify(bodies, motions, rules)
        return found["robots"]["gap_mm"]

    # the smallest gap is true to 1e-4 mm each time
    here = gap(PLANE.arms, 1.0)
    np.testing.assert_allclose(gap(*turned(PLANE, angle_deg, mirror)), here, atol=2e-4)
