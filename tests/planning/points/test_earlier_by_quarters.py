"""Plans end earlier by quarters of a step than the paths of the search, and are as safe."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from test_fewer_points import as_sent
from tests.planning.fields import field

from fiberloom.planning import Plan, PlanSettings, plan, random_pair, verify
from fiberloom.planning.trajectories import Trajectory

BUFFER_MM = 3.0
SETTINGS = PlanSettings(collision_buffer_mm=BUFFER_MM)
ACCELERATION_DEG_S2 = 47.0  # the instrument's
GRID_DEG = 5.85  # in a step at full speed
CORNER_DEG_S = 5.851  # half of a step of the grid in half a second
APPROACH_S = 0.25


def made_of(n: int, seed: int, settings: PlanSettings = SETTINGS):
    """Plane, start, goal and plan of a random pair."""
    plane = field(n)
    start_deg, goal_deg = random_pair(plane, seed=seed, collision_buffer_mm=BUFFER_MM)
    return plane, start_deg, goal_deg, plan(plane, start_deg, goal_deg, seed=seed, settings=settings)


def quarter_s(made: Plan) -> float:
    return made.statistics["step_s"] / 4


def later(robot: Trajectory, made: Plan, rest_s: float) -> Trajectory:
    """A quarter of a step later from a moment at which it rests; it begins its approach as before."""
    end_s = made.duration_s - APPROACH_S
    moves_later = (robot.time_s > rest_s) & (robot.time_s < end_s - 1e-9)
    return replace(robot, time_s=robot.time_s + np.where(moves_later, quarter_s(made), 0.0))


def axis_motion(robot: Trajectory, axis: int, end_s: float):
    """Durations in s and speeds in deg/s between the points of an axis, until the approach."""
    rows = robot.corners(axis)
    rows = rows[robot.time_s[rows] <= end_s + 1e-9]
    duration_s = np.diff(robot.time_s[rows])
    speed_deg_s = np.diff(robot.points_deg[rows, axis]) / duration_s
    return duration_s, np.where(np.abs(speed_deg_s) < 1e-5, 0.0, speed_deg_s)


def rests_before_reversals_s(made: Plan) -> list[float]:
    """How long each axis rests before it turns back."""
    found = []
    for robot in made.robots:
        for axis in (0, 1):
            before, rest_s = 0.0, 0.0
            for duration_s, speed in zip(
                *axis_motion(robot, axis, made.duration_s - APPROACH_S), strict=True
            ):
                if speed == 0.0:
                    rest_s += duration_s
                    continue
                if before * speed < 0.0:
                    found.append(rest_s)
                before, rest_s = speed, 0.0
    return found


@pytest.mark.parametrize(("n", "seed"), [(2, 29), (7, 3), (12, 1), (19, 35), (19, 47)])
def test_a_plan_is_verified_as_it_is_sent_and_ends_before_its_paths(n, seed):
    plane, start_deg, goal_deg, made = made_of(n, seed)
    earlier = made.statistics["quarters_earlier"]
    assert made.refused == {}
    assert earlier > 0
    assert made.duration_s == (made.statistics["steps"] + 0.5) * 4 * quarter_s(made) + APPROACH_S
    assert (made.statistics["steps"] + earlier / 4) % 1 == 0.0  # where the paths end
    approach_deg = plane.instrument.axes[0].approach_deg
    sent = replace(made, robots=tuple(as_sent(robot) for robot in made.robots))
    for motion in (made, sent):
        found = verify(plane, motion, start_deg=start_deg, goal_deg=goal_deg, approach_deg=approach_deg)
        assert found.ok, str(found)


def test_all_threads_make_the_same_plan():
    with ThreadPoolExecutor(3) as pool:
        plans = [made.to_json() for *_, made in pool.map(lambda _: made_of(7, 3), range(3))]
    assert plans[1:] == plans[:-1]
    assert made_of(7, 3)[3].to_json() == plans[0]


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 5])
def test_one_that_goes_straight_to_its_goal_does_so_at_full_speed(seed):
    """On its path it takes whole steps, and is slower by what is left of the last one."""
    plane, start_deg, goal_deg, made = made_of(1, seed)
    way_deg = np.abs(goal_deg + plane.instrument.axes[0].approach_deg - start_deg).max()
    assert made.statistics["steps"] * 4 == np.ceil(4 * way_deg / GRID_DEG)


def test_an_arm_that_waits_for_another_just_passes_it():
    """The first one arrives last: its last move waits for the second, and begins 3 quarters of a step before
    that on its path. If the second begins a quarter of a step later they touch."""
    plane, start_deg, goal_deg, made = made_of(2, 105, replace(SETTINGS, in_hand_mm=0.0))
    assert (made.statistics["quarters_earlier"], made.statistics["steps"]) == (3, 46.25)
    assert verify(plane, made, start_deg=start_deg, goal_deg=goal_deg).ok
    first, second = made.robots
    rest_s = 10.5 * quarter_s(made)
    assert (second.at([rest_s]) == second.at([11.5 * quarter_s(made)])).all()
    touching = verify(plane, replace(made, robots=(first, later(second, made, rest_s))))
    assert [found.kind for found in touching.violations] == ["robots"]


def test_an_axis_that_turns_back_rests_for_a_quarter_of_a_step_at_least():
    """On its path it rests for half of a step."""
    *_, made = made_of(19, 28)
    assert made.statistics["quarters_earlier"] == 6
    assert min(rests_before_reversals_s(made)) == pytest.approx(quarter_s(made))


@pytest.mark.parametrize(("n", "seed"), [(2, 44), (2, 50), (19, 28), (19, 35)])
def test_no_corner_is_sharper_than_on_a_path(n, seed):
    *_, made = made_of(n, seed)
    assert made.statistics["quarters_earlier"] > 0
    assert min(rests_before_reversals_s(made)) >= quarter_s(made) - 1e-9
    for robot in made.robots:
        for axis in (0, 1):
            duration_s, speed = axis_motion(robot, axis, made.duration_s - APPROACH_S)
            steps = np.abs(np.diff(speed, prepend=0.0))
            mean_s = 0.5 * (duration_s + np.roll(duration_s, 1))
            mean_s[:1] = duration_s[:1]
            assert steps.max(initial=0.0) < CORNER_DEG_S
            assert (steps / mean_s).max(initial=0.0) < ACCELERATION_DEG_S2


def test_plans_for_lateness_keep_the_steps_of_their_paths():
    *_, made = made_of(7, 3, replace(SETTINGS, late_s=1.0))
    assert made.late_s == 1.0
    assert made.statistics["quarters_earlier"] == 0
    assert made.statistics["steps"] % 1 == 0.0


def test_a_budget_that_is_used_up_leaves_the_paths_as_they_are():
    *_, made = made_of(7, 3, replace(SETTINGS, budget_s=0.0))
    assert made.statistics["quarters_earlier"] == 0
