"""Plans in which any one positioner may be late: held against dense samples in numpy, and played."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fields import field, sampled_gaps
from late_oracle import LateOracle

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.planning import (
    Plan,
    PlanSettings,
    Trajectory,
    plan,
    random_configuration,
    random_pair,
    verify,
    verify_late,
)

FOR_GOOD = np.inf
CASES = [(19, 0, 0.5), (19, 1, 1.0), (19, 2, 3.0), (13, 3, FOR_GOOD), (13, 5, FOR_GOOD)]


@cache
def planned(n: int, seed: int, late_s: float) -> Plan:
    return plan(field(n), *random_pair(field(n), seed), seed=seed, settings=PlanSettings(late_s=late_s))


def ids(plane: FocalPlane, rows: tuple[int, int]) -> tuple[int, int]:
    first, second = sorted(int(plane.positioner_id[row]) for row in rows)
    return first, second


def touching(plane: FocalPlane, made: Plan, late_s: float) -> set[tuple[int, int]]:
    """Pairs of positioner_id that touch in some sample within a lateness."""
    oracle = LateOracle(plane, made, 0.1)
    return {ids(plane, pair) for pair in oracle.pairs() if oracle.bears_s(*pair, late_s) < np.inf}


@pytest.mark.parametrize(("n", "seed", "late_s"), CASES)
def test_all_pairs_bear_it_but_those_that_are_told(n, seed, late_s):
    made = planned(n, seed, late_s)
    assert made.late_s == late_s
    assert made.refused == {}
    told = set(verify_late(field(n), made, late_s).failing_pairs)
    found, without = (touching(field(n), p, late_s) for p in (made, planned(n, seed, 0.0)))
    assert found <= told <= set(made.not_late)
    print(f"\n{len(without)} pairs touch, {len(told)} if it is asked for; {len(made.not_late)} on time")
    assert len(told) <= len(without)


def test_fewer_pairs_touch_if_it_is_asked_for():
    """Of one field so many may touch either way: where all others are on the only way, it does not help."""
    asked, without = (
        sum(len(verify_late(field(n), made, late_s).failing_pairs) for n, late_s, made in plans)
        for plans in (
            [(n, late_s, planned(n, seed, late_s)) for n, seed, late_s in CASES],
            [(n, late_s, planned(n, seed, 0.0)) for n, seed, late_s in CASES],
        )
    )
    assert asked < without


@pytest.mark.parametrize("late_s", [0.5, 2.0, FOR_GOOD])
@pytest.mark.parametrize("seed", range(4))
def test_the_proof_agrees_with_the_planner(seed, late_s):
    """Of larger fields: the planner's own list holds all that the proof finds."""
    plane = field(37)
    made = planned(37, seed, late_s)
    assert verify(plane, made, goal_deg=random_pair(plane, seed)[1]).ok
    assert set(verify_late(plane, made, late_s).failing_pairs) <= set(made.not_late)


def test_the_same_arguments_give_the_same_bits():
    for late_s in (1.0, FOR_GOOD):
        settings = PlanSettings(late_s=late_s)
        again = plan(field(19), *random_pair(field(19), 1), seed=1, settings=settings)
        assert again.to_json() == planned(19, 1, late_s).to_json()
        assert again.not_late == planned(19, 1, late_s).not_late


def test_it_is_not_asked_for_as_a_rule():
    made = plan(field(19), *random_pair(field(19), 1), seed=1)
    assert made.to_json() == planned(19, 1, 0.0).to_json()
    assert made.late_s == 0.0
    assert made.not_late == ()
    assert "late_s" not in made.statistics


@pytest.mark.parametrize("late_s", [2.0, FOR_GOOD])
@pytest.mark.parametrize("seed", range(3))
def test_no_goal_is_given_up_for_it(seed, late_s):
    """Goals chosen without regard to each other's ways, in which arms interlock."""
    plane = field(37)
    ends_deg = (
        random_configuration(plane, seed, margin_mm=0.002, approach_deg=0.0),
        random_configuration(plane, seed + 50, margin_mm=0.002),
    )
    made = plan(plane, *ends_deg, seed=seed, settings=PlanSettings(late_s=late_s))
    assert made.refused.keys() == plan(plane, *ends_deg, seed=seed).refused.keys()
    assert verify(plane, made, goal_deg=ends_deg[1]).ok


def test_where_nothing_can_be_had_the_plan_is_as_without_it():
    """Hardly any repairs, and arms that keep far too much: it cannot be had, and no target is lost."""
    plane = field(37)
    ends_deg = random_pair(plane, 2, collision_buffer_mm=3.0)
    poor = PlanSettings(collision_buffer_mm=3.0, effort=0.0)
    given_up = plan(plane, *ends_deg, seed=2, settings=poor)
    asked = plan(plane, *ends_deg, seed=2, settings=replace(poor, late_s=FOR_GOOD))
    assert asked.late_s == 0.0
    assert asked.to_json() == given_up.to_json()


def stopped(made: Plan, row: int, at_s: float) -> Plan:
    """The plan as it is carried out if one stops at that moment and stays; in pure kinematics."""
    robot = made.robots[row]
    before = robot.time_s < at_s
    here = robot.at(np.array([at_s]))[0]
    halted = Trajectory(
        robot.positioner_id,
        np.append(robot.time_s[before], at_s),
        np.append(robot.alpha_deg[before], here[0]),
        np.append(robot.beta_deg[before], here[1]),
    )
    return replace(made, robots=(*made.robots[:row], halted, *made.robots[row + 1 :]))


def crashed(plane: FocalPlane, made: Plan) -> set[int]:
    """Rows that, stopped at one of some random moments, touch another, by the verifier."""
    rng = np.random.default_rng(7)
    out = set()
    for row, robot in enumerate(made.robots):
        for at_s in rng.uniform(0.1, robot.time_s[-1] - 0.1, 6):
            found = verify(plane, stopped(made, row, at_s))
            assert all(ids(plane, _rows(plane, v)) in made.not_late for v in found.collisions)
            if found.collisions:
                out.add(row)
    return out


def _rows(plane: FocalPlane, violation) -> tuple[int, int]:
    first, second = plane.index_of([violation.positioner_id, int(violation.other)])
    return int(first), int(second)


def test_one_that_stops_on_its_way_touches_only_whom_the_plan_names():
    plane = field(19)
    spared = {row for pair in planned(19, 4, FOR_GOOD).not_late for row in plane.index_of(list(pair))}
    assert crashed(plane, planned(19, 4, FOR_GOOD)) <= spared
    with pytest.raises(AssertionError):  # a plan that was not asked for it names none
        crashed(plane, planned(19, 4, 0.0))


def test_one_that_stops_in_front_of_a_free_field_is_seen_by_samples_too():
    plane, made = field(13), planned(13, 3, FOR_GOOD)
    spared = {row for pair in made.not_late for row in plane.index_of(list(pair))}
    for row in sorted(set(range(plane.n)) - spared)[:3]:
        halted = stopped(made, row, 0.4 * made.robots[row].time_s[-1])
        assert min(sampled_gaps(plane, halted, 0.05)) > 0.0


@pytest.mark.parametrize("late_s", [-0.5, np.nan])
def test_a_lateness_that_no_plan_can_be_asked_for(late_s):
    with pytest.raises(InputError, match="late_s"):
        planned(7, 0, late_s)


def test_a_budget_ends_it():
    plane = field(61)
    ends_deg = random_pair(plane, 1)
    made = plan(plane, *ends_deg, seed=1, settings=PlanSettings(late_s=FOR_GOOD, budget_s=0.1))
    assert made.statistics["cut_short"]
    assert made.cpu_s < 5.0
    assert verify(plane, made).ok
