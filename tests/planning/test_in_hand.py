"""Arms on their way keep more than the buffer, to go on from a stop; at their ends they need not."""

from functools import cache

import numpy as np
import pytest
from fields import _lines, field, signed

from fiberloom.planning import Plan, PlanSettings, plan, random_configuration, random_pair, verify
from fiberloom.planning.bodies import CollisionBodies
from fiberloom.planning.overlaps import Surroundings
from fiberloom.units import deg_to_rad

BUFFER_MM = 2.0
FREE_DEG = 1.5 * 5.85 + 0.01
"""Around start and place above the goal: the steps in which nothing is kept, to the middle of the next."""
NOTHING = PlanSettings(in_hand_mm=0.0)


@cache
def planned(n: int, seed: int, in_hand_mm: float) -> tuple[Plan, np.ndarray]:
    plane = field(n)
    start_deg, goal_deg = random_pair(plane, seed)
    made = plan(plane, start_deg, goal_deg, seed=seed, settings=PlanSettings(in_hand_mm=in_hand_mm))
    return made, goal_deg


def gap_on_the_way(plane, made: Plan, goal_deg: np.ndarray, step_s: float = 0.01) -> float:
    """Least gap of buffers, mm, of an arm that moves far from its ends to another arm; numpy alone."""
    times = np.arange(0.0, made.duration_s, step_s)
    places = [robot.at(times) for robot in made.robots]
    lines = [_lines(plane, k, place) for k, place in enumerate(places)]
    on_way = []
    for place, goal in zip(places, goal_deg, strict=True):
        far = [np.abs(place - end).max(axis=1) > FREE_DEG for end in (place[0], goal + 0.82)]
        moves = np.abs(np.gradient(place, axis=0)).max(axis=1) > 1e-9
        on_way.append(far[0] & far[1] & moves)
    least = np.inf
    for i, j in plane.neighbour_pairs():
        gaps = signed(lines[i], lines[j]) - 2 * BUFFER_MM
        least = min(least, gaps[on_way[i] | on_way[j]].min(initial=np.inf))
    return float(least)


@pytest.mark.parametrize("seed", range(3))
def test_an_arm_on_its_way_keeps_a_twentieth_of_a_millimetre_in_hand(seed):
    made, goal_deg = planned(61, seed, 0.05)
    assert made.refused == {}
    assert gap_on_the_way(field(61), made, goal_deg) > 0.05


def test_without_it_arms_pass_as_near_as_the_buffer():
    gaps = [gap_on_the_way(field(61), *planned(61, seed, 0.0)) for seed in range(6)]
    print(f"\nleast gaps, mm: {np.round(gaps, 3)}")
    assert 0.0 < min(gaps) < 0.04


def stops_that_overlap(in_hand_mm: float, off_deg: float) -> int:
    """Of 400 stops on the way, those from which `plan` would leave some where they are."""
    plane = field(100)
    around = Surroundings(plane, CollisionBodies.of(plane))
    count = 0
    for seed in range(4):
        made, _ = planned(100, seed, in_hand_mm)
        rng = np.random.default_rng(seed)
        for time_s in rng.uniform(0.0, made.duration_s, 100):
            here = np.array([robot.at(np.array([time_s]))[0] for robot in made.robots])
            here += rng.uniform(-off_deg, off_deg, here.shape)
            count += bool(around.overlapping(deg_to_rad(here)))
    return count


def test_fewer_stops_leave_arms_that_overlap():
    """With angles far off, and three times as much in hand as usual: few overlap with the usual anyway."""
    with_it, without = stops_that_overlap(0.15, 0.8), stops_that_overlap(0.0, 0.8)
    print(f"\n{with_it} of 400 stops, {without} with nothing in hand")
    assert with_it < without / 2


@pytest.mark.parametrize(("seed", "which"), [(3, 0), (14, 0), (2, 1), (20, 1)])
def test_starts_and_goals_that_are_nearer_to_each_other_are_left_and_reached(seed, which):
    plane = field(61)
    ends_deg = (
        random_configuration(plane, seed, margin_mm=0.002, approach_deg=0.0),
        random_configuration(plane, seed + 50, margin_mm=0.002),
    )
    gaps = Surroundings(plane, CollisionBodies.of(plane)).gaps_of_pairs_mm(deg_to_rad(ends_deg[which]))[2]
    assert 0.0 < gaps.min() < 0.03
    made = plan(plane, *ends_deg, seed=seed)
    assert made.refused.keys() == plan(plane, *ends_deg, seed=seed, settings=NOTHING).refused.keys()


def test_what_is_in_hand_is_spent_where_it_would_keep_one_from_its_goal():
    """So much that hardly an arm gets past another, or a fiducial."""
    in_hand_mm = 3.0
    plane, settings = field(19), PlanSettings(in_hand_mm=in_hand_mm, effort=0.1)
    for seed in range(4):
        start_deg, goal_deg = random_pair(plane, seed)
        made = plan(plane, start_deg, goal_deg, seed=seed, settings=settings)
        assert made.refused == {}
        assert verify(plane, made, start_deg=start_deg, goal_deg=goal_deg).ok
        assert gap_on_the_way(plane, made, goal_deg) < in_hand_mm / 5


def test_one_alone_passes_between_fiducials_where_there_is_no_room_for_it():
    whole = field(61)
    start_deg, goal_deg = random_pair(whole, 0)
    for row in range(whole.n):
        ends_deg = start_deg[[row]], goal_deg[[row]]
        made = plan(whole.select([row]), *ends_deg, settings=PlanSettings(in_hand_mm=5.0))
        assert made.refused == {}
