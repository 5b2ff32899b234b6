"""Plans arrive, keep clear, keep their limits, and say who cannot arrive."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fields import SDSSV, field, real_field, sampled_gaps

from fiberloom.bus.trajectory import WireTrajectory
from fiberloom.errors import InputError
from fiberloom.planning import (
    MotionLimits,
    Plan,
    PlanSettings,
    Trajectory,
    bound_s,
    plan,
    plan_corrections,
    random_configuration,
    random_pair,
    verify,
)
from fiberloom.units import counts_to_deg, ticks_to_s

APPROACH_DEG = 0.82


@cache
def solved(n: int, seed: int):
    plane = field(n)
    start_deg, goal_deg = random_pair(plane, seed)
    return plane, start_deg, goal_deg, plan(plane, start_deg, goal_deg, seed=seed)


def assert_sound(plane, start_deg, goal_deg, made) -> None:
    found = verify(plane, made, start_deg=start_deg, goal_deg=goal_deg, approach_deg=APPROACH_DEG)
    assert found.ok, found
    assert found.min_clearance_mm > 0.0


@pytest.mark.parametrize("seed", range(3))
def test_a_hundred_positioners_go_directly_from_a_to_b(seed):
    plane, start_deg, goal_deg, made = solved(100, seed)
    assert made.refused == {}
    assert_sound(plane, start_deg, goal_deg, made)
    least_s = bound_s(plane, start_deg, goal_deg)
    assert least_s < made.duration_s < 1.5 * least_s
    np.testing.assert_allclose(made.end_deg, goal_deg, atol=1e-8)


def test_a_guided_search_looks_at_little_beside_its_paths():
    """Three fields of a hundred: millions of states without the guide."""
    looked_at = sum(solved(100, seed)[3].statistics["expansions"] for seed in range(3))
    print(f"\n{looked_at / 1e6:.1f} millions of states")
    assert looked_at < 1_000_000


def test_a_plan_that_is_cut_short_is_sound_and_says_who_is_given_up():
    plane, start_deg, goal_deg, whole = solved(100, 1)
    # with nothing in hand: otherwise those that meet are tried once more without it, and arrive
    made = plan(plane, start_deg, goal_deg, settings=PlanSettings(budget_s=1e-6, in_hand_mm=0.0))
    assert (made.statistics["cut_short"], whole.statistics["cut_short"]) == (True, False)
    assert_sound(plane, start_deg, goal_deg, made)
    given_up = plane.index_of(list(made.refused))
    assert 0 < len(given_up) < 30
    assert all("no way past its neighbours was found" in why for why in made.refused.values())
    arrive = np.setdiff1d(np.arange(plane.n), given_up)
    np.testing.assert_allclose(made.end_deg[arrive], goal_deg[arrive], atol=1e-8)
    enough = plan(plane, start_deg, goal_deg, seed=1, settings=PlanSettings(budget_s=1e6))
    np.testing.assert_array_equal(enough.end_deg, whole.end_deg)
    assert enough.duration_s == whole.duration_s


def test_the_bound_is_the_longest_way_of_one_axis_with_its_approach():
    plane = field(7)
    start_deg = np.tile([100.0, 180.0], (7, 1))
    goal_deg = start_deg.copy()
    assert bound_s(plane, start_deg, goal_deg) == 0.0
    # down: the place above the goal is nearer, then the approach
    goal_deg[1, 1] -= 58.5
    assert bound_s(plane, start_deg, goal_deg) == pytest.approx(58.5 / 11.7, rel=1e-12)
    # up: beyond the goal and back
    goal_deg[4, 0] += 117.0
    assert bound_s(plane, start_deg, goal_deg) == pytest.approx((117.0 + 2 * APPROACH_DEG) / 11.7, rel=1e-12)
    fourth = int(plane.positioner_id[4])
    assert bound_s(plane, start_deg, goal_deg, refused=[fourth]) == pytest.approx(5.0, rel=1e-12)
    assert bound_s(plane.with_offline([fourth]), start_deg, goal_deg) == pytest.approx(5.0, rel=1e-12)
    half = PlanSettings(speed_deg_s=5.85)
    assert bound_s(plane, start_deg, goal_deg, settings=half, refused={fourth: "why"}) == pytest.approx(10.0)


def test_dense_sampling_in_numpy_agrees_with_the_verifier():
    plane, _, _, made = solved(100, 0)
    found = verify(plane, made)
    arms, discs = sampled_gaps(plane, made)
    # two arms at full speed close in by at most 0.16 mm in half a sample; near the minimum far less
    assert found.min_robot_clearance_mm <= arms + 1e-6
    assert arms < found.min_robot_clearance_mm + 0.02
    assert found.min_obstacle_clearance_mm <= discs + 1e-6
    assert discs < found.min_obstacle_clearance_mm + 0.02


def test_speed_acceleration_and_the_number_of_points_are_kept():
    plane, _, _, made = solved(100, 1)
    found = verify(plane, made, limits=MotionLimits(11.7, 47.0))
    assert found.ok, found
    assert found.top_speed_deg_s > 11.69  # somebody uses what there is
    # a full stop is cut into two corners, and 0.82 deg of approach last 0.25 s
    assert found.top_jump_deg_s < 11.7 / 2 + 0.82 / 0.25


def test_every_move_ends_with_the_approach():
    _, _, goal_deg, made = solved(100, 2)
    for robot, goal in zip(made.robots, goal_deg, strict=True):
        k = np.searchsorted(robot.time_s, robot.time_s[-1] - 0.25 - 1e-9)
        np.testing.assert_allclose(robot.points_deg[k], goal + APPROACH_DEG, atol=1e-8)
        assert (np.diff(robot.points_deg[k:], axis=0) < 0).all()


def above_since_s(robot: Trajectory) -> float:
    """When both axes have come to rest above the goal."""
    moved = (np.abs(np.diff(robot.points_deg[:-1], axis=0)) > 1e-9).any(axis=1)
    return float(robot.time_s[1:-1][moved][-1])


def test_a_motor_rests_as_soon_as_its_arm_is_there():
    """It does not wait above its goal for the last ones."""
    _, _, _, made = solved(100, 2)
    above_s = np.array([above_since_s(robot) for robot in made.robots])
    waits_s = np.array([robot.time_s[-1] for robot in made.robots]) - 0.25 - above_s
    assert made.duration_s - np.median(above_s) > 5.0  # so there is something to gain
    assert np.mean(waits_s < 1.0) > 0.9
    assert waits_s.min() >= 0.0


def test_where_one_may_be_late_all_come_down_together():
    plane, start_deg, goal_deg, _ = solved(100, 2)
    made = plan(plane, start_deg, goal_deg, settings=PlanSettings(late_s=0.5))
    own = made.approaches.keys() | made.refused.keys()
    ends = {robot.time_s[-1] for robot in made.robots if robot.positioner_id not in own}
    assert len(ends) == 1


def on_the_bus(robot: Trajectory) -> Trajectory:
    """Rounded to counts and ticks, with only the points that each axis gets."""
    corners = robot.corners(0), robot.corners(1)
    axes = WireTrajectory.from_deg(robot.time_s, robot.alpha_deg, robot.beta_deg, corners)
    ticks = np.union1d(axes.alpha[:, 1], axes.beta[:, 1])
    alpha, beta = (np.interp(ticks, axis[:, 1], axis[:, 0]) for axis in (axes.alpha, axes.beta))
    return Trajectory(robot.positioner_id, ticks_to_s(ticks), counts_to_deg(alpha), counts_to_deg(beta))


@pytest.mark.parametrize("seed", range(3))
def test_what_the_bus_carries_is_the_plan_with_few_points(seed):
    plane, start_deg, goal_deg, made = solved(100, seed)
    sent = replace(made, robots=tuple(on_the_bus(robot) for robot in made.robots))
    # the start is where the positioner is: half a count beside it at most
    found = verify(plane, sent, start_deg=start_deg, goal_deg=goal_deg, limits=MotionLimits(11.7))
    assert found.ok, found
    assert found.min_clearance_mm == pytest.approx(verify(plane, made).min_clearance_mm, abs=1e-6)
    points = [len(robot.corners(axis)) for robot in made.robots for axis in (0, 1)]
    print(f"\npoints per axis: {np.mean(points):.1f} mean, {max(points)} worst")
    assert np.mean(points) < 12
    assert max(points) <= 40


def test_the_same_seed_gives_the_same_bytes():
    plane, start_deg, goal_deg, made = solved(100, 0)
    again = plan(plane, start_deg, goal_deg, seed=0)
    assert again.to_json() == made.to_json()
    assert plan(plane, start_deg, goal_deg, seed=1).to_json() != made.to_json()


def test_a_turned_field_can_be_planned_as_well():
    plane, start_deg, goal_deg, made = solved(37, 5)
    turn = np.exp(1j * np.radians(77.0))
    arms, fiducials = plane.arms.copy(), plane.fiducials.copy()
    for table in (arms, fiducials):
        z = (table[:, 0] + 1j * table[:, 1]) * turn
        table[:, 0], table[:, 1] = z.real, z.imag
    arms[:, 3] += np.radians(77.0)
    turned = replace(plane, arms=arms, fiducials=fiducials, guide_cameras=np.zeros((0, 5)))
    still = replace(plane, guide_cameras=np.zeros((0, 5)))
    gap = verify(still, made).min_clearance_mm
    # smallest gaps are true to 1e-4 mm each
    assert verify(turned, made).min_clearance_mm == pytest.approx(gap, abs=2e-4)
    assert_sound(turned, start_deg, goal_deg, plan(turned, start_deg, goal_deg, seed=5))


def test_offline_positioners_stand_and_are_gone_round():
    plane = field(61)
    offline = plane.with_offline(plane.positioner_id[[3, 11, 40]])
    start_deg, goal_deg = random_pair(offline, 8)
    made = plan(offline, start_deg, goal_deg)
    assert made.refused == {}
    assert_sound(offline, start_deg, goal_deg, made)
    for row in (3, 11, 40):
        assert not made.robots[row].moves
        np.testing.assert_allclose(made.robots[row].points_deg, [[10.0, 170.0]])


def reaching_over(plane) -> tuple[int, int, np.ndarray]:
    """A positioner, a neighbour, and the first's angles that put its arm on the other's centre."""
    first = 0
    second = int(np.argsort(np.hypot(*(plane.centres_mm - plane.centres_mm[first]).T))[1])
    towards = plane.centres_mm[second] - plane.centres_mm[first]
    alpha = np.degrees(np.arctan2(towards[1], towards[0]) - plane.arms[first, 3])
    return first, second, np.array([alpha % 360.0, 0.5])


def test_who_cannot_arrive_is_named_and_the_others_do():
    """An offline neighbour stands, folded, on the very place that is asked for."""
    plane = field(37)
    first, second, over = reaching_over(plane)
    blocked = plane.with_offline([plane.positioner_id[second]], [[0.0, 180.0]])
    start_deg = np.tile([10.0, 170.0], (37, 1))
    start_deg[second] = [0.0, 180.0]
    goal_deg = random_configuration(blocked, 3)
    goal_deg[first] = over
    made = plan(blocked, start_deg, goal_deg)
    name = int(plane.positioner_id[first])
    assert name in made.refused
    assert f"positioner {name}" in made.refused[name]
    assert f"touches positioner {plane.positioner_id[second]}, which does not move" in made.refused[name]
    # whoever had its goal where the unlucky one now stands may be refused as well, nobody else
    assert len(made.refused) <= 3
    assert_sound(blocked, start_deg, goal_deg, made)


def test_of_two_goals_that_touch_one_is_given_up():
    plane = replace(field(7), fiducials=np.zeros((0, 3)))
    start_deg = np.tile([10.0, 170.0], (7, 1))
    goal_deg = start_deg.copy()
    first, second, over = reaching_over(plane)
    goal_deg[first] = over
    goal_deg[second] = [100.0, 175.0]
    made = plan(plane, start_deg, goal_deg)
    assert len(made.refused) == 1
    assert set(made.refused) <= {int(plane.positioner_id[k]) for k in (first, second)}
    assert_sound(plane, start_deg, goal_deg, made)


def test_a_goal_without_room_for_the_approach_is_named():
    plane = field(7)
    start_deg = np.tile([10.0, 170.0], (7, 1))
    goal_deg = start_deg.copy()
    goal_deg[2] = [363.5, 170.0]
    made = plan(plane, start_deg, goal_deg)
    assert list(made.refused) == [int(plane.positioner_id[2])]
    assert "beyond the travel" in made.refused[int(plane.positioner_id[2])]
    assert_sound(plane, start_deg, goal_deg, made)


def test_who_touches_something_at_the_start_stays_and_the_others_move():
    plane = replace(field(19), fiducials=np.zeros((0, 3)))
    first, second, over = reaching_over(plane)
    start_deg = np.tile([10.0, 170.0], (19, 1))
    start_deg[first] = over
    goal_deg = np.tile([200.0, 170.0], (19, 1))
    made = plan(plane, start_deg, goal_deg)
    tangled = {int(plane.positioner_id[k]) for k in (first, second)}
    assert set(made.refused) == tangled
    found = verify(plane, made)
    assert found.ok
    assert len(found.contacts) == 1
    assert sum(robot.moves for robot in made.robots) == 17


def test_who_is_at_its_goal_stays():
    plane, start_deg, _, _ = solved(37, 5)
    made = plan(plane, start_deg, start_deg)
    assert not any(robot.moves for robot in made.robots)
    assert made.duration_s == 0.0


def test_a_single_positioner_moves_straight_and_fast():
    plane = replace(field(1), fiducials=np.zeros((0, 3)))
    made = plan(plane, [[10.0, 170.0]], [[127.0, 90.0]])
    assert made.duration_s == pytest.approx((117.0 + 0.82) / 11.7, abs=1.2)
    found = verify(plane, made)
    assert found.min_clearance_mm == np.inf or found.min_obstacle_clearance_mm > 0


def test_a_slow_motor_takes_longer_and_keeps_its_limits():
    plane = field(19)
    start_deg, goal_deg = random_pair(plane, 2)
    slow = PlanSettings(speed_deg_s=5.0, acceleration_deg_s2=8.0)
    made = plan(plane, start_deg, goal_deg, settings=slow)
    found = verify(plane, made, limits=MotionLimits(5.0, 8.0))
    assert found.ok, found
    assert made.refused == {}
    assert made.duration_s > np.abs(goal_deg - start_deg).max() / 5.0


def test_without_an_approach_the_motion_ends_at_the_goal():
    plane = field(19)
    start_deg, goal_deg = random_pair(plane, 4)
    made = plan(plane, start_deg, goal_deg, approach_deg=0.0)
    found = verify(plane, made, start_deg=start_deg, goal_deg=goal_deg)
    assert found.ok, found
    np.testing.assert_allclose(made.end_deg, goal_deg, atol=1e-8)


def test_each_positioner_may_have_an_approach_of_its_own():
    plane = field(19)
    start_deg, goal_deg = random_pair(plane, 6)
    heights = np.linspace(0.3, 0.82, 19)
    made = plan(plane, start_deg, goal_deg, approach_deg=heights)
    assert verify(plane, made, goal_deg=goal_deg, approach_deg=heights).ok
    assert not verify(plane, made, approach_deg=0.82).ok


def test_corrections_move_everybody_at_once():
    plane = field(100)
    goal_deg = random_configuration(plane, 1)
    off = np.random.default_rng(2).normal(0.0, 0.05, (100, 2))  # 20 um at the tip
    off[::10] = 0.0
    made = plan_corrections(plane, goal_deg + off, goal_deg)
    assert made.refused == {}
    assert_sound(plane, goal_deg + off, goal_deg, made)
    assert made.duration_s < 2.0
    assert [k for k, r in enumerate(made.robots) if not r.moves] == list(range(0, 100, 10))


def test_corrections_that_meet_when_all_move_at_once_are_put_in_order():
    """One must leave before its neighbour comes: together they would touch."""
    plane = replace(field(2), fiducials=np.zeros((0, 3)), guide_cameras=np.zeros((0, 5)))
    straight = []
    for seed in range(12):
        start_deg, goal_deg = random_pair(plane, seed)
        made = plan_corrections(plane, start_deg, goal_deg)
        assert made.refused == {}
        assert_sound(plane, start_deg, goal_deg, made)
        straight.append("searches" not in made.statistics)
    assert any(straight)
    assert not all(straight)


def test_a_real_field_of_five_hundred():
    """The array of Apache Point, 60 fiducials, 6 guide cameras."""
    plane = real_field()
    start_deg, goal_deg = random_pair(plane, 4)
    made = plan(plane, start_deg, goal_deg)
    assert made.refused == {}
    assert_sound(plane, start_deg, goal_deg, made)
    assert made.duration_s < 1.5 * np.abs(goal_deg - start_deg).max() / 11.7


@pytest.mark.parametrize(
    ("start", "words"),
    [
        (np.zeros((6, 2)), "start_deg: shape (6, 2)"),
        (np.full((7, 2), np.nan), "must be finite"),
    ],
)
def test_bad_input_says_what_is_wrong(start, words):
    with pytest.raises(InputError) as caught:
        plan(field(7), start, np.zeros((7, 2)))
    assert words in str(caught.value)


def test_a_motion_that_fails_its_verification_is_never_given_out(monkeypatch):
    """Whoever is involved stands and is named; the rest is planned anew."""
    from fiberloom.planning import planner

    plane, start_deg, goal_deg, _ = solved(37, 5)
    real, wrong = planner.core.plan, []

    def spoiled(*args, **kwargs):
        motions, *others = real(*args, **kwargs)
        if not wrong:
            wrong.append(motions[4])
            motions[4] = motions[4] * [0.5, 1.0, 1.0]  # twice as fast
        return motions, *others

    monkeypatch.setattr(planner.core, "plan", spoiled)
    made = plan(plane, start_deg, goal_deg)
    number = int(plane.positioner_id[4])
    assert number in made.refused
    assert "did not pass the verifier" in made.refused[number]
    assert_sound(plane, start_deg, goal_deg, made)


def test_where_no_plan_passes_its_verification_none_moves(monkeypatch):
    from fiberloom.planning import planner

    plane, start_deg, goal_deg, _ = solved(37, 5)
    monkeypatch.setattr(planner, "_RETRIES", 1)
    monkeypatch.setattr(planner._Task, "verify", lambda task, made: verify(plane, made, goal_deg=start_deg))
    made = plan(plane, start_deg, goal_deg)
    np.testing.assert_allclose(made.end_deg, start_deg, atol=1e-8)
    assert not any(robot.moves for robot in made.robots)
    assert set(made.refused) == set(plane.positioner_id[(start_deg != goal_deg).any(axis=1)].tolist())
    assert all("did not pass the verifier" in why for why in made.refused.values())


def test_what_the_instrument_says_is_what_is_used():
    narrow = SDSSV.model_copy(update={"bodies": SDSSV.bodies.model_copy(update={"collision_buffer_mm": 1.0})})
    plane = replace(field(7), instrument=narrow)
    made = plan(plane, *random_pair(plane, 0))
    assert made.collision_buffer_mm == 1.0
    assert isinstance(Plan.from_json(made.to_json()), Plan)
