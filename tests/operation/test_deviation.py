"""One positioner does not do its part in a move of a field: the verifier decides whether the others go on."""

import asyncio
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fiberloom.bus.motion import Deviation, DeviationKind
from fiberloom.bus.outcome import Outcome
from fiberloom.calibration.transmission.maps import identity
from fiberloom.drive.sdssv.drive import when_linked
from fiberloom.health.status import FibreStatus
from fiberloom.instruments import generate, load_instrument
from fiberloom.operation import motion as operation
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.move import Goals
from fiberloom.operation.safety.choice import cut_off_at
from fiberloom.operation.safety.deviation import MotionRule
from fiberloom.operation.safety.hearing import Hearing
from fiberloom.operation.safety.judge import Evidence
from fiberloom.planning import Plan, Trajectory, plan, random_pair, verify
from fiberloom.twin import draw_units
from fiberloom.twin.hardware import field_hardware

PLANE = generate(load_instrument("sdssv"), seed=5, n_positioners=19)
GOAL_DEG = random_pair(PLANE, 5)[1]
FOLDED_DEG = np.tile(PLANE.park_deg, (19, 1)) if PLANE.park_deg.ndim == 1 else PLANE.park_deg
PLANNED = plan(PLANE, FOLDED_DEG, GOAL_DEG, seed=5)


class Recorder:
    def __init__(self):
        self.events = []

    def event(self, kind, text, positioner_id=None):
        self.events.append((kind, positioner_id, text))

    def __getattr__(self, name):
        return lambda *args: None


def rule():
    events = []
    return MotionRule(PLANE, PLANNED, lambda *event: events.append(event), lambda: 0.0), events


def allowed(kind, row, time_s=0.4, known_s=0.0):
    made, _ = rule()
    deviation = Deviation(int(PLANE.positioner_id[row]), kind, time_s, known_s)
    return asyncio.run(made.may_go_on([deviation]))


def test_the_rule_is_the_verifiers_and_allows_some_and_not_others():
    verdicts = [allowed(DeviationKind.NOT_STARTED, row) for row in range(19)]
    assert len(set(verdicts)) == 2
    # the same question, put to the verifier about the whole field
    for row, verdict in enumerate(verdicts):
        robots = list(PLANNED.robots)
        robots[row] = cut_off_at(robots[row], np.zeros(1))[0]
        whole = Plan(PLANNED.instrument, PLANNED.collision_buffer_mm, tuple(robots))
        assert verdict == (not verify(PLANE, whole).collisions)


@pytest.mark.parametrize("refused", range(0, 19, 6))
def test_a_goal_that_the_plan_refused_elsewhere_changes_nothing(refused):
    blocked = replace(PLANNED, refused={int(PLANE.positioner_id[refused]): "blocked"})
    for row in (0, 9, 18):
        made = MotionRule(PLANE, blocked, lambda *_: None, lambda: 0.0)
        deviation = Deviation(int(PLANE.positioner_id[row]), DeviationKind.NOT_STARTED, 0.4, 0.0)
        assert asyncio.run(made.may_go_on([deviation])) == allowed(DeviationKind.NOT_STARTED, row)


def test_a_collision_stops_all_and_a_link_that_is_down_none():
    assert not any(allowed(DeviationKind.COLLIDED, row, 5.0, 4.0) for row in range(19))
    assert all(allowed(DeviationKind.LINK_DOWN, row, 5.0, 4.0) for row in range(19))


def test_one_that_was_near_its_end_may_rest_where_an_early_one_may_not():
    early = [allowed(DeviationKind.SILENT, row, 2.0, 0.5) for row in range(19)]
    late = [
        allowed(DeviationKind.SILENT, row, PLANNED.duration_s, PLANNED.duration_s - 0.5) for row in range(19)
    ]
    assert sum(late) > sum(early)


def test_two_that_rest_are_both_remembered():
    made, events = rule()
    ids = [int(i) for i in PLANE.positioner_id[:2]]

    async def both():
        for i in ids:
            await made.may_go_on([Deviation(i, DeviationKind.REFUSED, 0.1)])

    asyncio.run(both())
    assert made.resting_rows().tolist() == [0, 1]
    assert [e[2] for e in events] == [ids[0], ids[0], ids[1], ids[1]]


def test_cut_off_it_stays_where_it_was_then():
    whole = Trajectory(
        7, np.array([0.0, 2.0, 4.0]), np.array([0.0, 20.0, 0.0]), np.array([180.0, 90.0, 90.0])
    )
    (half,) = cut_off_at(whole, np.array([3.0]))
    np.testing.assert_allclose(half.at([1.0, 3.0, 9.0]), [[10.0, 135.0], [10.0, 90.0], [10.0, 90.0]])
    (at_once,) = cut_off_at(whole, np.zeros(1))
    assert not at_once.moves
    np.testing.assert_allclose(at_once.at(5.0), [0.0, 180.0])


def moved(faults, seed=5):
    """A blind move, with recoveries; the motion and the contacts in the twin's own truth."""
    hardware = field_hardware(PLANE, draw_units(PLANE, seed), seed, faults=faults)
    recorder = Recorder()
    motion = FieldMotion(PLANE, identity(PLANE.positioner_id), hardware, recorder)

    async def run():
        await motion.connect()
        await motion.go(Goals.without_targets(PLANE, GOAL_DEG))

    asyncio.run(run())
    return motion, hardware.truth.touches(), recorder.events


def faults_of(motion):
    return {int(p): f for p, f in zip(PLANE.positioner_id, motion.state.faults, strict=True) if f is not None}


def at_goal(motion):
    miss_mm = np.hypot(*(motion.moves[-1].measurement.xy_mm - motion.state.metrology_mm(GOAL_DEG)).T)
    return miss_mm < 0.5


@pytest.mark.parametrize("row", [0, 4, 9])
def test_one_that_misses_its_start_is_healthy_and_comes_to_its_goal(row):
    motion, touches, events = moved(f"nostart=#{PLANE.positioner_id[row]}")
    assert touches == []
    assert faults_of(motion) == {}
    assert at_goal(motion).all()
    assert any(kind == "deviation" and "did not start" in text for kind, _, text in events)


@pytest.mark.parametrize("kind", ["refuse", "reboot"])
def test_one_that_does_not_start_is_flagged_alone_and_touches_none(kind):
    victim = int(PLANE.positioner_id[4])
    motion, touches, _ = moved(f"{kind}=#{victim}")
    assert touches == []
    assert faults_of(motion) == {victim: FibreStatus.DEAD}
    assert at_goal(motion)[motion.state.mobile & ~motion.state.blocked].all()


@pytest.mark.parametrize("kind", ["mute", "deaf"])
def test_one_that_falls_silent_in_a_move_is_flagged_alone(kind):
    victim = int(PLANE.positioner_id[4])
    motion, touches, _ = moved(f"{kind}=#{victim}@6")
    assert touches == []
    assert faults_of(motion) == {victim: FibreStatus.DEAD}
    assert at_goal(motion)[motion.state.mobile & ~motion.state.blocked].all()


def test_one_that_answers_again_is_no_longer_held_to_be_dead():
    victim = int(PLANE.positioner_id[2])
    motion, touches, events = moved(f"mute=#{victim}@6+45")
    assert touches == []
    assert ("answers", victim, "answers again, and is where it reports") in events
    assert faults_of(motion) == {}
    assert at_goal(motion).all()


def test_one_that_is_silent_at_the_begin_moves_once_it_answers():
    victim = int(PLANE.positioner_id[4])
    motion, touches, events = moved(f"mute=#{victim}+10")
    assert touches == []
    assert ("dead", victim, "does not answer on the bus") in events
    assert ("answers", victim, "answers again, and is where it reports") in events
    assert faults_of(motion) == {}
    assert at_goal(motion).all()
    assert victim in motion.client.ids  # a stop reaches it


def test_lost_replies_flag_none():
    motion, _, _ = moved("lost=0.01")
    assert faults_of(motion) == {}
    assert at_goal(motion).all()


# judging


def evidence(outcome, heard, **how):
    xy = np.zeros((1, 2))
    base = {"outcomes": [outcome], "seen": np.array([True]), "heard": np.array([heard])}
    base |= {"measured_mm": xy, "before_mm": xy + 5.0, "reported_mm": xy, "goal_mm": xy}
    return Evidence(**(base | how))


def hearing(heard):
    made = Hearing(1)
    made.hears(np.array([0]), np.array([heard]))
    return made


@pytest.mark.parametrize(
    ("outcome", "heard", "fault"),
    [
        (Outcome.TIMED_OUT, True, None),
        (Outcome.TIMED_OUT, False, FibreStatus.DEAD),
        (Outcome.DISCONNECTED, True, None),
        (Outcome.DISCONNECTED, False, FibreStatus.DISCONNECTED),
        (Outcome.NOT_STARTED, True, None),
        (Outcome.REFUSED, True, FibreStatus.DEAD),
    ],
)
def test_missing_answers_are_no_fault_of_one_that_answers_now(outcome, heard, fault):
    assert hearing(heard).judged(evidence(outcome, heard)) == [fault]


def test_what_answers_now_is_judged_by_the_image():
    wrong = evidence(Outcome.TIMED_OUT, True, measured_mm=np.array([[2.0, 0.0]]))
    assert hearing(True).judged(wrong) == [FibreStatus.ASTRAY]


def test_one_that_does_not_start_twice_is_dead():
    made = hearing(True)
    outcomes = [Outcome.NOT_STARTED, Outcome.DONE, Outcome.NOT_STARTED, Outcome.NOT_STARTED]
    told = [made.judged(evidence(outcome, True))[0] for outcome in outcomes]
    assert told == [None, None, None, FibreStatus.DEAD]


@pytest.mark.parametrize(("heard", "off_mm", "taken"), [(True, 0.1, [0]), (True, 0.9, []), (False, 0.1, [])])
def test_a_fault_from_silence_is_taken_back_by_an_answer_that_the_image_confirms(heard, off_mm, taken):
    made = hearing(False)
    made.judged(evidence(Outcome.TIMED_OUT, False))
    made.hears(np.array([0]), np.array([heard]))
    after = evidence(Outcome.DONE, heard, measured_mm=np.array([[off_mm, 0.0]]))
    assert made.taken_back(after, np.array([0.3])) == taken


@pytest.mark.parametrize(("off_mm", "taken"), [(0.1, [0]), (0.4, [])])
def test_one_that_was_silent_at_the_begin_comes_back_by_the_rule_of_the_begin_check(off_mm, taken):
    """In a move 0.4 mm would do; but this one's report was never checked."""
    made = Hearing(1)
    made.silent_at_the_begin(0)
    made.hears(np.array([0]), np.array([True]))
    after = evidence(Outcome.DONE, True, measured_mm=np.array([[off_mm, 0.0]]))
    assert made.taken_back(after, np.array([0.3])) == taken


def test_links_are_waited_for_before_a_move():
    times = iter(range(100))
    exchange = SimpleNamespace(cut_off=lambda ids: set(ids) if next(times) < 4 else set())

    async def wait(done, deadline_s):
        while not done():
            pass
        return True

    exchange.wait = wait
    client = SimpleNamespace(exchange=exchange, time_s=0.0)
    assert asyncio.run(when_linked(client, [1]))


@pytest.mark.slow
def test_without_polls_a_missed_start_is_seen_too_late(monkeypatch):
    """What the polls are for: unwatched, arms touch in one of these."""

    def unwatched(*args):
        return MotionRule(*args, poll_s=math.inf)

    monkeypatch.setattr(operation, "MotionRule", unwatched)
    for i in PLANE.positioner_id[:8]:
        _, touches, events = moved(f"nostart=#{i}")
        assert not any(kind == "deviation" for kind, *_ in events)
        if touches:
            return
    pytest.fail("no arms touch")
