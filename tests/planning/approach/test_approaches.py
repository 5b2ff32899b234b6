"""Where usual approaches would touch, positioners come to their goals lower, later, or axis after axis."""

from dataclasses import replace

import numpy as np
import pytest
from made import LEAST_DEG, RADIUS_MM, SDSSV, USUAL_DEG, apart, bare, facing, last_falls

from fiberloom._core import twin
from fiberloom.planning import MotionLimits, Plan, PlanSettings, plan, random_pair, verify
from fiberloom.twin.gears import draw_gear

TOGETHER = PlanSettings(approach_turns=1)
WHOLE = PlanSettings(least_approach_deg=USUAL_DEG)
AS_BEFORE = PlanSettings(approach_turns=1, least_approach_deg=USUAL_DEG)
TURN_S = 0.25


def checked(plane, goal_deg, settings: PlanSettings | None = None) -> Plan:
    made = plan(plane, plane.park_deg, goal_deg, settings=settings)
    limits = MotionLimits(least_approach_deg=settings.least_approach_deg if settings else None)
    found = verify(
        plane, made, start_deg=plane.park_deg, goal_deg=goal_deg, approach_deg=USUAL_DEG, limits=limits
    )
    assert found.ok, found
    return made


def test_the_least_approach_closes_the_backlash_of_every_gear_that_is_accepted():
    assert SDSSV.least_approach_deg == pytest.approx(LEAST_DEG)
    assert SDSSV.least_approach_deg > 0.244 / 0.85  # the slope that acceptance lets pass
    assert SDSSV.alpha.model_copy(update={"backlash_deg": 0.0}).least_approach_deg == USUAL_DEG
    assert SDSSV.alpha.model_copy(update={"backlash_deg": 0.8}).least_approach_deg == USUAL_DEG


@pytest.mark.parametrize("seed", range(20))
def test_the_least_approach_closes_the_backlash_of_gears_of_the_twin(seed):
    """From above with the gear at the wrong contact, the motor goes down by the backlash and more."""
    at = np.linspace(0.0, 360.0, 36001)
    for axis in (0, 1):
        gear = draw_gear(axis, np.random.default_rng([seed, axis]))
        row = np.frombuffer(gear.tobytes(), dtype=np.float64)
        low, backlash = (np.degrees(x) for x in twin.transmission(row, 1024.0, np.radians(at)))
        high, _ = twin.transmission(row, 1024.0, np.radians(at + LEAST_DEG))
        assert (np.degrees(high) - low - backlash).min() > 0.0


def test_most_goals_whose_usual_approaches_touch_are_reached():
    """All forty were refused; now three are: the approach of each crosses the goal of the other."""
    plane, arrived = bare(2), 0
    for goal_deg in facing(1)[:40]:
        assert len(checked(plane, goal_deg, AS_BEFORE).refused) == 1
        made = checked(plane, goal_deg, PlanSettings(effort=0.05))
        arrived += not made.refused
        if not made.refused:
            assert made.approaches
            np.testing.assert_allclose(made.end_deg, goal_deg, atol=1e-8)
    assert arrived >= 37


def offsets(made: Plan) -> list[tuple[int, int]]:
    """For each positioner with an approach of its own, the turns of alpha and beta."""
    begin_s = (made.statistics["steps"] + 0.5) * made.statistics["step_s"]
    turns = [np.round((np.array(a.begin_s) - begin_s) / TURN_S, 6) for a in made.approaches.values()]
    return [(int(a), int(b)) for a, b in turns]


def test_lowered_on_one_axis_or_on_both():
    heights = set()
    for goal_deg in facing(1)[:40]:
        made = checked(bare(2), goal_deg, TOGETHER)
        for own in made.approaches.values():
            heights.add(tuple(np.round(own.height_deg, 6)))
            assert own.begin_s[0] == own.begin_s[1]
    low, high = round(LEAST_DEG, 6), USUAL_DEG
    assert heights == {(low, high), (high, low), (low, low)}


def test_one_after_the_other_and_one_axis_after_the_other():
    """Not lowered: only the time helps."""
    seen = set()
    for goal_deg in facing(1)[:40]:
        made = checked(bare(2), goal_deg, WHOLE)
        if made.refused or not made.approaches:
            continue
        seen |= set(offsets(made))
        assert all(own.height_deg == (USUAL_DEG, USUAL_DEG) for own in made.approaches.values())
    assert {(1, 1), (0, 1), (1, 0)} <= seen


def test_who_needs_no_turn_of_its_own_does_not_wait():
    """All have ended with the first turn but those that come later."""
    plane = bare(19)
    _, goal_deg = random_pair(plane, 3)
    for pair in facing(1):
        two = bare(2)
        made = plan(two, two.park_deg, pair, settings=WHOLE)
        if (1, 1) in (offsets(made) if made.approaches and not made.refused else []):
            break
    goal_deg = np.where(np.isin(plane.positioner_id, two.positioner_id)[:, None], goal_deg, plane.park_deg)
    rows = plane.index_of(two.positioner_id)
    goal_deg[rows] = pair
    others = np.setdiff1d(np.arange(plane.n), rows)
    goal_deg[others] = plane.park_deg[others] + [30.0, 0.0]
    made = checked(plane, goal_deg, WHOLE)
    ends = [robot.time_s[-1] for robot in made.robots if robot.positioner_id not in made.approaches]
    assert made.approaches
    assert max(ends) <= made.duration_s - TURN_S + 1e-5


def test_every_axis_closes_the_backlash_whatever_the_approach():
    """By the points alone: each axis falls to its goal from what the plan tells, never below the least."""
    plane = bare(2)
    for goal_deg in facing(2)[:25]:
        made = checked(plane, goal_deg)
        for robot, axis, height in last_falls(made):
            own = made.approaches.get(robot.positioner_id)
            asked = USUAL_DEG if own is None else own.height_deg[axis]
            assert height >= asked - 1e-6
            assert asked >= LEAST_DEG - 1e-6
            if own is not None:
                above = robot.at(own.begin_s[axis])[axis] - robot.points_deg[-1, axis]
                assert above == pytest.approx(asked, abs=1e-6)


def test_goals_that_touch_are_refused_as_such():
    plane = bare(2)
    rng = np.random.default_rng(5)
    goals = np.stack([rng.uniform(0, 360, (4000, 2)), rng.uniform(0, 180, (4000, 2))], axis=-1)
    for goal_deg in goals[~apart(plane, goals, 0.0)][:5]:
        (why,) = checked(plane, goal_deg).refused.values()
        one, other = plane.positioner_id.tolist()
        assert why in {
            f"positioner {p}: its goal touches the goal of positioner {q}"
            for p, q in ((one, other), (other, one))
        }


def test_approaches_that_nothing_helps_are_told_apart_from_goals():
    told = set()
    for goal_deg in facing(1)[:40]:
        told |= {" ".join(w.split()[2:-2]) for w in checked(bare(2), goal_deg, AS_BEFORE).refused.values()}
    assert told == {
        "its approach touches the goal of",
        "its goal touches the approach of",
        "its approach touches the approach of",
    }


def with_disc(goal_deg: np.ndarray, above_deg: float, gap_mm: float):
    """One positioner, and a disc beside its arm so far above the goal, by so much from touching."""
    plane = bare(1)
    arm, segment = plane.arms[0], plane.beta_segment_mm[1]
    alpha, beta = np.radians(goal_deg + above_deg) + arm[3:]
    elbow = arm[0] + 1j * arm[1] + arm[2] * np.exp(1j * alpha)
    along = np.exp(1j * (alpha + beta))
    disc = elbow + segment * along + 1j * along * (RADIUS_MM + 1.0 + gap_mm)
    return replace(plane, fiducials=np.array([[disc.real, disc.imag, 1.0]]))


@pytest.mark.parametrize(
    ("above_deg", "gap_mm", "told"),
    [
        (USUAL_DEG, -0.05, None),  # lower
        (LEAST_DEG, -0.02, None),  # one axis after the other
        (0.0, 0.02, "its approach touches fiducial 0"),
        (0.0, -0.05, "its goal touches fiducial 0"),
    ],
)
def test_a_fiducial_beside_the_approach(above_deg, gap_mm, told):
    """The arm turns towards it as the angles grow, by 0.26 mm and more at the tip for a degree of one."""
    goal_deg = np.array([120.0, 60.0])
    plane = with_disc(goal_deg, above_deg, gap_mm)
    number = int(plane.positioner_id[0])
    made = checked(plane, goal_deg[None])
    if told is None:
        assert min(made.approaches[number].height_deg) == pytest.approx(LEAST_DEG)
        assert checked(plane, goal_deg[None], AS_BEFORE).refused[number].endswith("touches fiducial 0")
    else:
        assert made.refused == {number: f"positioner {number}: {told}"}


def test_a_guide_camera_is_named():
    goal_deg = np.array([120.0, 60.0])
    plane = with_disc(goal_deg, 0.0, -0.05)
    x, y, radius = plane.fiducials[0]
    plane = replace(
        plane, fiducials=np.zeros((0, 3)), guide_cameras=np.array([[x, y, x + 0.1, y + 0.1, radius]])
    )
    (why,) = checked(plane, goal_deg[None]).refused.values()
    assert why.endswith("its goal touches guide camera 0")


@pytest.mark.parametrize(
    ("alpha_deg", "told"),
    [
        (362.5, None),
        (
            362.9,
            "its goal with the shortest approach lies beyond the travel of its axes; "
            "alpha needs 362.9 to 363.193 deg, and has -3 to 363 deg",
        ),
        (
            363.5,
            "its goal lies beyond the travel of its axes; "
            "alpha needs 363.5 to 363.793 deg, and has -3 to 363 deg",
        ),
    ],
)
def test_the_end_of_the_travel(alpha_deg, told):
    """Alpha may go to 363 deg, one below its hard stop."""
    plane = bare(1)
    made = checked(plane, np.array([[alpha_deg, 90.0]]))
    number = int(plane.positioner_id[0])
    if told is None:
        assert made.approaches[number].height_deg == pytest.approx((LEAST_DEG, USUAL_DEG))
    else:
        assert made.refused == {number: f"positioner {number}: {told}"}


def test_slow_axes_keep_their_acceleration_in_all_turns():
    settings = PlanSettings(speed_deg_s=5.0, acceleration_deg_s2=3.0)
    plane, some = bare(2), 0
    for goal_deg in facing(1)[:12]:
        made = plan(plane, plane.park_deg, goal_deg, settings=settings)
        assert verify(plane, made, limits=MotionLimits(5.0, 3.0)).ok
        some += len(made.approaches)
    assert some > 6


def test_the_same_arguments_give_the_same_bytes():
    plane, goal_deg = bare(2), facing(1)[3]
    made = checked(plane, goal_deg)
    assert made.approaches
    assert plan(plane, plane.park_deg, goal_deg).to_json() == made.to_json()
