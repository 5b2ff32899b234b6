"""Bodies that overlap when a plan begins: the verifier lets them part, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from fields import _lines, field, signed
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fiberloom.planning import MotionLimits, Plan, Trajectory, verify
from fiberloom.planning.overlaps import signed_distance_mm

PLANE = replace(field(2), fiducials=np.zeros((0, 3)), guide_cameras=np.zeros((0, 5)))
"""Two neighbours and nothing else."""
BOTH = tuple(int(p) for p in PLANE.positioner_id)
BUFFER_MM = 2.0
SLACK_MM = 1e-3
USUAL = MotionLimits(speed_deg_s=1e9, acceleration_deg_s2=1e12)
"""Only the bodies are looked at."""
PARTING = replace(USUAL, separating=True)


def plan_of(first, second=None) -> Plan:
    """Tables of (time, alpha, beta); the second positioner is folded when left out."""
    second = [(0.0, facing()[1], 180.0)] if second is None else second
    robots = [Trajectory(p, *np.array(m, float).T) for p, m in zip(BOTH, (first, second), strict=True)]
    return Plan("sdssv", BUFFER_MM, tuple(robots))


def facing() -> tuple[float, float]:
    """Alpha of each at which its stretched arm points at the other's centre."""
    towards = np.degrees(np.arctan2(*(PLANE.centres_mm[1] - PLANE.centres_mm[0])[::-1]))
    off = np.degrees(PLANE.arms[:, 3])
    return (towards - off[0]) % 360.0, (towards + 180.0 - off[1]) % 360.0


def gaps(plan: Plan, times: np.ndarray) -> np.ndarray:
    lines = [_lines(PLANE, k, robot.at(times)) for k, robot in enumerate(plan.robots)]
    return signed(*lines) - 2 * plan.collision_buffer_mm


def fall(plan: Plan, count: int = 20001) -> float:
    """By how much the gap falls below the largest until then, or below 0 after that was reached."""
    gap = gaps(plan, np.linspace(0.0, plan.duration_s, count))
    return float((np.minimum(np.maximum.accumulate(gap), 0.0) - gap).max())


def alpha_at(gap_mm: float) -> float:
    """The alpha of the first, its arm stretched, at which the gap to the folded second is this."""
    low, high = facing()[0], facing()[0] + 120.0
    for _ in range(60):
        middle = (low + high) / 2
        deep = gaps(plan_of([(0, middle, 0.0)]), np.zeros(1))[0] < gap_mm
        low, high = (middle, high) if deep else (low, middle)
    return high


def kinds(found) -> set[str]:
    return {v.kind for v in found.violations}


def through(*alphas: float) -> Plan:
    """The first goes through these angles, a second each."""
    return plan_of([(float(k), alpha, 0.0) for k, alpha in enumerate(alphas)])


def test_bodies_that_overlap_may_part_if_they_are_told_to_and_only_then():
    out = through(alpha_at(-1.0), alpha_at(0.5))
    assert fall(out) == 0.0
    assert verify(PLANE, out, limits=PARTING).ok
    assert kinds(verify(PLANE, out, limits=PARTING)) == set()
    assert kinds(verify(PLANE, out, limits=USUAL)) == {"robots"}
    assert not verify(PLANE, out, limits=USUAL).ok
    assert verify(PLANE, out, limits=PARTING).min_robot_clearance_mm == pytest.approx(-1.0, abs=1e-6)


def test_what_still_overlaps_at_the_end_is_told():
    found = verify(PLANE, through(alpha_at(-1.0), alpha_at(-0.4)), limits=PARTING)
    assert found.ok
    (left,) = found.contacts
    assert (left.kind, left.time_s) == ("contact", 1.0)
    assert left.depth == pytest.approx(0.4, abs=1e-6)


@pytest.mark.parametrize(
    ("way_mm", "depth_mm"),
    [
        ((-1.0, -1.01, 0.5), 0.01),  # deeper at first
        ((-1.0, -0.3, -0.31, 0.5), 0.01),  # out, a little in, out
        ((-1.0, -0.3, -0.9, 0.5), 0.6),
        ((-1.0, 0.3, -0.05, 0.5), 0.05),  # free, and back
        ((-1.0, -1.002, 0.5), 0.002),
        ((-1.0, 0.3, -1e-4, 0.3), 1e-4),  # once free there is no slack
    ],
)
def test_a_gap_that_falls_is_found_with_its_depth(way_mm, depth_mm):
    plan = through(*map(alpha_at, way_mm))
    found = verify(PLANE, plan, limits=PARTING)
    assert not found.ok
    assert kinds(found) == {"closing"}
    (hit,) = found.collisions
    # true to 1e-5 mm or 2 %
    assert hit.depth == pytest.approx(depth_mm, rel=0.021, abs=1.1e-5)
    assert {str(hit.positioner_id), hit.other} == {str(p) for p in BOTH}
    assert "overlaps" in str(hit)


def test_less_than_a_micrometre_is_no_fall():
    assert verify(PLANE, through(*map(alpha_at, (-1.0, -1.0006, 0.5))), limits=PARTING).ok
    assert verify(PLANE, through(*map(alpha_at, (-1.0, -0.4, -0.4006, 0.5))), limits=PARTING).ok
    small = [-1.0 + 0.0007 * (k % 2) - 0.0004 * k for k in range(12)]  # many small ones add up
    assert kinds(verify(PLANE, through(*map(alpha_at, small)), limits=PARTING)) >= {"closing"}


def test_a_dip_within_a_straight_motion_is_found():
    """Past the other's end and out again: both ends of the motion are farther than the start of the dip."""
    high = alpha_at(-0.5)
    low = high - 0.1
    while gaps(through(low), np.zeros(1))[0] < -0.5:
        low -= 0.1
    plan = through(low + 0.2, high)
    assert fall(plan) > 1.0
    found = verify(PLANE, plan, limits=PARTING)
    assert "closing" in kinds(found)
    assert found.collisions[0].depth == pytest.approx(fall(plan), rel=0.021)


def test_arms_that_cross_part_by_the_shorter_way():
    """Crossed by a false angle: the distance is 0 all the while, the signed gap grows only outwards."""
    alpha, other = facing()
    crossed = [(0.0, alpha - 8.0, 0.0), (4.0, alpha - 60.0, 0.0)]
    second = [(0.0, other, 60.0)]
    plan = plan_of(crossed, second)
    start = gaps(plan, np.zeros(1))[0]
    assert start < -2 * BUFFER_MM - 0.3
    back = plan_of([(0.0, alpha - 8.0, 0.0), (4.0, alpha + 60.0, 0.0)], second)
    verdicts = [verify(PLANE, p, limits=PARTING).ok for p in (plan, back)]
    assert verdicts == [fall(p) < SLACK_MM for p in (plan, back)]
    assert sorted(verdicts) == [False, True]


def test_the_planner_and_the_test_agree_on_crossed_segments():
    rng = np.random.default_rng(1)
    p, q = rng.uniform(-3.0, 3.0, (2, 5000, 4))
    assert (signed(p, q) < 0.0).sum() > 500
    np.testing.assert_allclose(signed_distance_mm(p, q), signed(p, q), atol=1e-9)


def test_an_arm_parts_from_a_fiducial():
    x, y = PLANE.centres_mm[0]
    alone = PLANE.select([0])
    alpha, towards = 100.0, np.radians(100.0) + PLANE.arms[0, 3]
    disc = np.array([[x + 19.0 * np.cos(towards), y + 19.0 * np.sin(towards), 2.0]])
    plane = replace(alone, fiducials=disc)

    def turned(*alphas):
        points = np.array([(float(k), a, 0.0) for k, a in enumerate(alphas)])
        return Plan("sdssv", BUFFER_MM, (Trajectory(BOTH[0], *points.T),))

    assert verify(plane, turned(alpha + 8.0, alpha + 40.0), limits=PARTING).ok
    assert kinds(verify(plane, turned(alpha + 8.0, alpha + 40.0), limits=USUAL)) == {"obstacle"}
    over = verify(plane, turned(alpha + 8.0, alpha - 40.0), limits=PARTING)
    assert kinds(over) == {"obstacle_closing"}
    assert over.collisions[0].other == "fiducial 0"
    left = verify(plane, turned(alpha + 8.0, alpha + 9.0), limits=PARTING)
    assert (left.ok, kinds(left)) == (True, {"obstacle_contact"})


def motions(alpha_deg: float, beta_deg: float):
    """That begin within these angles of the stretched arm that points at the other's centre."""
    begin = st.tuples(st.just(0.0), st.floats(-alpha_deg, alpha_deg), st.floats(0.0, beta_deg))
    point = st.tuples(st.floats(0.05, 3.0), st.floats(-40.0, 40.0), st.floats(0.0, 60.0))
    return st.tuples(begin, st.lists(point, max_size=3)).map(lambda parts: [parts[0], *parts[1]])


def near_each_other(first, second) -> Plan:
    """Both arms around the line between the centres."""
    tables = []
    for steps, alpha in zip((first, second), facing(), strict=True):
        rows = np.array(steps) + np.array([0.0, alpha, 0.0])
        rows[:, 0] = np.cumsum(rows[:, 0]) - rows[0, 0]
        tables.append(rows)
    return plan_of(*tables)


@settings(max_examples=120, deadline=None)
@given(motions(40.0, 170.0), motions(40.0, 170.0))
def test_the_flag_changes_nothing_for_bodies_that_do_not_overlap_at_the_start(first, second):
    plan = near_each_other(first, second)
    assume(gaps(plan, np.zeros(1))[0] > 0.0)
    assert verify(PLANE, plan, limits=PARTING) == verify(PLANE, plan, limits=USUAL)


@settings(max_examples=60, deadline=None)
@given(motions(15.0, 20.0), motions(15.0, 20.0))
def test_parting_agrees_with_dense_sampling(first, second):
    """A fall that samples see is found; one that is found is seen by samples, or is as small as they miss."""
    plan = near_each_other(first, second)
    assume(gaps(plan, np.zeros(1))[0] < -1e-3)
    assume(any(robot.moves for robot in plan.robots))
    found = verify(PLANE, plan, limits=PARTING)
    seen = fall(plan)
    steps = [np.abs(np.diff(r.points_deg, axis=0)).sum() for r in plan.robots]
    shortest = min(np.diff(r.time_s).min() for r in plan.robots if r.moves)
    missed = np.radians(sum(steps)) * 23.0 * min(1.0, plan.duration_s / 20000 / shortest)
    closing = max((v.depth for v in found.collisions), default=0.0)
    # the depth of a fall is told to within what the gap has risen between two looks before it
    assert closing >= 0.5 * seen or seen <= SLACK_MM + 1e-9
    assert closing <= seen + missed + 2e-3
