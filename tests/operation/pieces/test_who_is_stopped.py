"""A collision while somebody cannot be reached: the verifier says which of the others are stopped."""

import asyncio
import math
import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from fiberloom.bus.links import Link
from fiberloom.bus.motion import Deviation, DeviationKind, Going
from fiberloom.calibration.transmission.maps import identity
from fiberloom.drive.sdssv.rest import AtRest
from fiberloom.instruments import generate, load_instrument
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.move import Goals
from fiberloom.operation.safety.choice import Choice, ahead, cut_off_at, rank
from fiberloom.operation.safety.deviation import STOPS, MotionRule
from fiberloom.planning import plan, random_pair, verify
from fiberloom.planning.verification import Violation
from fiberloom.studies.paper.no_record import NoRecord
from fiberloom.twin import draw_units
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.hardware import field_hardware


def field(n, seed):
    """Layout, goals and the plan there from the folded places."""
    plane = generate(load_instrument("sdssv"), seed=seed, n_positioners=n)
    goal_deg = random_pair(plane, seed)[1]
    return plane, goal_deg, plan(plane, plane.park_deg, goal_deg, seed=seed)


class Heard(NoRecord):
    """Keeps events."""

    def __init__(self):
        self.events = []

    def event(self, kind, text, positioner_id=None):
        self.events.append((kind, text))


# the choice


def going(plane, time_s, collided, unreachable):
    ids = set(plane.positioner_id.tolist()) - {collided}
    cut = frozenset(unreachable) & ids
    return Going(time_s, frozenset(ids) - cut, cut)


def rule(plane, planned, collided, time_s, heard=None, clock=None):
    made = MotionRule(plane, planned, (heard or Heard()).event, clock or (lambda: 0.0))
    deviation = Deviation(collided, DeviationKind.COLLIDED, time_s, time_s - 0.1)
    assert not asyncio.run(made.may_go_on([deviation]))
    return made


def rested(robot, time_s):
    return cut_off_at(robot, np.array([time_s]))[0]


def meets(plane, planned, stop, collided, time_s):
    """Whether anybody meets anybody in the whole field, by the verifier."""
    robots = [rested(r, time_s) if r.positioner_id in {*stop, collided} else r for r in planned.robots]
    return bool(verify(plane, replace(planned, robots=tuple(robots))).collisions)


CASES = [(seed, time_s) for seed in range(8) for time_s in (4.0, 8.0, 12.0)]


def test_where_any_choice_is_free_of_contacts_the_one_that_is_made_is():
    """Held against every choice there is, in fields of seven."""
    freed, stopping_all_touches = 0, 0
    for seed, time_s in CASES:
        plane, _, planned = field(7, seed)
        collided = int(plane.positioner_id[3])
        on = going(plane, time_s, collided, plane.positioner_id[1::2].tolist())
        choice = rule(plane, planned, collided, time_s).best(on, time_s + np.linspace(0.0, 0.5, STOPS))
        every = [set(c) for k in range(len(on.reachable) + 1) for c in combinations(sorted(on.reachable), k)]
        free = [stop for stop in every if not meets(plane, planned, stop, collided, time_s)]
        if not choice.contacts:
            assert choice.stop in free
            assert len(choice.stop) == max(map(len, free))
            freed += 1
        else:  # only where a place in between, or a moment later, is not free
            assert not free or meets_later(plane, planned, free, collided, time_s)
        stopping_all_touches += meets(plane, planned, on.reachable, collided, time_s)
    assert freed >= 6
    assert stopping_all_touches >= 2  # what the rule is for


def meets_later(plane, planned, choices, collided, time_s):
    return all(meets(plane, planned, stop, collided, time_s + 0.5) for stop in choices)


def test_what_a_choice_says_of_contacts_the_whole_field_confirms():
    """In fields where many are let go, one because of the other; held against whole trajectories."""
    let_go, touching = [], 0
    for seed, time_s in [(seed, time_s) for seed in range(6) for time_s in (3.0, 6.0)]:
        plane, _, planned = field(61, seed)
        ids = plane.positioner_id.tolist()
        collided = ids[30]
        on = going(plane, time_s, collided, ids[seed % 3 :: 3])
        made = MotionRule(plane, planned, Heard().event, lambda: 0.0)
        asyncio.run(made.may_go_on([Deviation(collided, DeviationKind.COLLIDED, time_s, time_s)]))
        when_s = time_s + np.linspace(0.0, 0.5, STOPS)
        choice = made.best(on, when_s)
        found = {
            pair for t in when_s for pair in touching_pairs(planned, plane, choice.stop, collided, time_s, t)
        }
        assert {pair_of(c) for c in choice.contacts} == {p for p in found if not p <= choice.stop}
        let_go.append(len(on.reachable) - len(choice.stop))
        touching += bool(choice.contacts)
    print(f"\n{touching} of {len(let_go)} choices are not clear of contacts")
    assert max(let_go) >= 5
    assert touching < 6  # 7 where arms unfold as soon as they can


@pytest.mark.parametrize("now_s", [0.0, 0.01, 3.3, 1e3])
def test_what_is_ahead_is_the_rest_of_the_way(now_s):
    _, _, planned = field(7, 2)
    when_s = np.linspace(0.0, planned.duration_s, 3000)
    for robot in planned.robots:
        left = ahead(robot, now_s)
        np.testing.assert_allclose(left.at(when_s), robot.at(now_s + when_s), atol=1e-9)
        assert left.time_s[0] == 0.0
        assert (np.diff(left.time_s) > 0.0).all()


def pair_of(contact):
    return frozenset({contact.positioner_id} | ({int(contact.other)} if contact.other.isdecimal() else set()))


def touching_pairs(planned, plane, stop, collided, collided_s, stopped_s):
    """Pairs in contact, by whole trajectories: one is cut off when it collided, others when they stop."""
    end_s = dict.fromkeys(stop, stopped_s) | {collided: collided_s}
    robots = (rested(r, end_s[r.positioner_id]) if r.positioner_id in end_s else r for r in planned.robots)
    return {pair_of(c) for c in verify(plane, replace(planned, robots=tuple(robots))).collisions}


def test_without_anybody_out_of_reach_a_collision_stops_all():
    plane, _, planned = field(7, 1)
    collided = int(plane.positioner_id[3])
    on = going(plane, 8.0, collided, [])
    made = rule(plane, planned, collided, 8.0)
    assert asyncio.run(made.chosen(on)) == on.reachable


def test_of_choices_that_all_touch_the_one_with_fewer_and_later_contacts_is_made():
    def choice(*times):
        return Choice(frozenset(), tuple(Violation("robots", k, "99", t, 1.0) for k, t in enumerate(times)))

    ranked = [choice(), choice(5.0), choice(2.0), choice(9.0, 9.0)]
    assert sorted((ranked[k] for k in (2, 0, 3, 1)), key=rank) == ranked


def test_where_no_choice_is_proven_an_alarm_says_so():
    plane, _, planned = field(7, 1)
    heard = Heard()
    collided = int(plane.positioner_id[3])
    made = rule(plane, planned, collided, 8.0, heard)
    made.best = lambda on, _: Choice(on.reachable, (Violation("robots", 1, "2", 9.0, 1.0),))
    asyncio.run(made.chosen(going(plane, 8.0, collided, [int(plane.positioner_id[0])])))
    assert [kind for kind, _ in heard.events][-1] == "alarm"
    assert "arms may touch" in heard.events[-1][1]


def chosen_slowly(takes_s):
    """The instants of rest that each choice was made for, and the events; each takes so long."""
    plane, _, planned = field(7, 1)
    heard, asked, clock = Heard(), [], [100.0]
    collided = int(plane.positioner_id[3])
    made = rule(plane, planned, collided, 8.0, heard, clock=lambda: clock[0])

    def best(on, resting_s):
        asked.append((resting_s[0], resting_s[-1]))
        clock[0] += takes_s[len(asked) - 1]
        return Choice(on.reachable)

    made.best = best
    asyncio.run(made.chosen(going(plane, 8.0, collided, [int(plane.positioner_id[0])])))
    return asked, heard.events


def test_a_choice_that_took_longer_than_it_allowed_for_is_made_anew():
    asked, events = chosen_slowly([0.7, 0.6])
    assert asked == [pytest.approx((8.0, 8.6)), pytest.approx((8.7, 8.7 + 1.4 + 0.3))]
    assert "alarm" not in [kind for kind, _ in events]


def test_where_it_is_always_late_an_alarm_says_so():
    asked, events = chosen_slowly([0.4, 0.9, 2.0])
    assert len(asked) == 3
    assert (
        "alarm",
        "the choice of who is stopped took 2.0 s: arms may be further than it was proven for",
    ) in events


# in the twin


class Gone(BaseException):
    """The host was killed."""


class CutBus:
    """The bus of a twin behind two gateways; the cable of the second is cut for a time."""

    dies_s = math.inf
    """The host is killed then: nothing more is sent, not even a stop."""

    def __init__(self, twin, inner, cut_s, back_s):
        self.twin, self.inner, self.due = twin, inner, [(cut_s, True), (back_s, False)]
        self.links = [Link("gateway 1"), Link("gateway 2")]
        self.behind = set(twin.plane.positioner_id[1::2].tolist())
        self.known = set()

    def link_of(self, positioner):
        """Of one that has answered."""
        return self.links[int(positioner in self.behind)] if positioner in self.known else None

    def follow(self):
        while self.due and self.twin.time_s >= self.due[0][0]:
            _, down = self.due.pop(0)
            for positioner in self.behind:
                for kind in ("deaf", "mute"):
                    (self.twin.inject if down else self.twin.clear)(Fault(kind, positioner))
            (self.links[1].goes_down if down else lambda _, at_s: self.links[1].comes_up(at_s))(
                "cut", self.twin.time_s
            )

    @property
    def time_s(self):
        return self.inner.time_s

    async def send(self, frames):
        self.follow()
        self.alive()
        await self.inner.send(frames)

    def alive(self):
        if self.time_s >= self.dies_s:
            raise Gone

    async def receive(self, timeout_s):
        self.alive()
        frames = await self.inner.receive(min(timeout_s, 0.05))
        self.follow()
        self.known |= {frame.id >> 18 for frame in frames} & set(self.twin.plane.positioner_id.tolist())
        return frames

    async def close(self):
        pass


def moved(n, seed, row, stuck_s, cut_s, back_s=44.0):
    """A blind move in which one positioner stalls while a cable is cut; its events and the true contacts."""
    plane, goal_deg, _ = field(n, seed)
    text = f"stuck_hall=#{plane.positioner_id[row]}@{stuck_s}"
    hardware = field_hardware(plane, draw_units(plane, seed), seed, faults=text)
    bus = CutBus(hardware.truth, hardware.transport, cut_s, back_s)
    heard = Heard()
    motion = FieldMotion(plane, identity(plane.positioner_id), replace(hardware, transport=bus), heard)

    async def run():
        await motion.connect()
        await motion.go(Goals.without_targets(plane, goal_deg))

    asyncio.run(run())
    return heard.events, hardware.truth.touches()


STALLS = {"n": 19, "seed": 1, "row": 6, "stuck_s": 6.0, "cut_s": 4.0}


def test_a_collision_while_a_cable_is_cut_leads_to_no_other():
    events, touches = moved(**STALLS)
    assert touches == []
    told = [text for kind, text in events if kind == "deviation" and "no stop reaches" in text]
    assert len(told) >= 1
    assert re.match(r"[1-9]\d* are stopped, [1-9]\d* go on", told[0])
    assert told[0].endswith("proven clear of contacts")


@pytest.mark.slow
def test_with_all_stopped_that_can_be_reached_arms_touch(monkeypatch):
    """What the choice is for."""

    async def reachable(_, on):
        return on.reachable

    monkeypatch.setattr(MotionRule, "chosen", reachable)
    _, touches = moved(**STALLS)
    assert touches


def test_when_the_cable_is_back_all_are_stopped():
    events, touches = moved(**STALLS, back_s=9.0)
    assert touches == []
    (first, *_), (then, *_) = [[t for _, t in events if part in t] for part in ("no stop reaches", "all ")]
    assert re.match(r"[1-9]\d* are stopped, [1-9]\d* go on", first)
    assert re.fullmatch(r"all 1\d on the way are stopped", then)


def killed_and_begun_again(back_s=500.0, cut_s=4.0, faults="", seed=1, n=19):
    """A host is killed in a move while a cable is cut; the next one moves on. Its events, true contacts."""
    plane, goal_deg, _ = field(n, seed)
    hardware = field_hardware(plane, draw_units(plane, seed), seed, faults=faults)
    bus = CutBus(hardware.truth, hardware.transport, cut_s, back_s)
    heard = Heard()
    first, second = (
        FieldMotion(plane, identity(plane.positioner_id), replace(hardware, transport=bus), recorder)
        for recorder in (Heard(), heard)
    )

    async def run():
        await first.connect()
        bus.dies_s = 8.0
        with pytest.raises(Gone):
            await first.go(Goals.without_targets(plane, goal_deg))
        bus.dies_s, bus.known = math.inf, set()
        await second.connect()
        await second.go(Goals.without_targets(plane, plane.park_deg))

    asyncio.run(run())
    return heard.events, hardware.truth.touches()


@pytest.mark.parametrize("back_s", [14.0, 500.0])
def test_a_host_that_is_killed_while_a_cable_is_cut_leaves_nobody_in_anybodys_way(back_s):
    events, touches = killed_and_begun_again(back_s)
    assert touches == []
    waited, *later = [text for kind, text in events if kind == "alarm" and "still moving" in text]
    assert waited.startswith("10 positioners are still moving at the begin; no answer from ")
    # of the 19 six have come to rest at their goals meanwhile
    assert later == (
        ["13 positioners were still moving at the begin; all are stopped"] if back_s < 20.0 else []
    )


STALLS_ALONE = {"cut_s": 900.0, "back_s": 950.0, "faults": "mute=#251@6,stuck_hall=#204@13"}


def test_one_that_collides_while_nobody_knows_the_plans_stops_all():
    """One does not answer, so the others go on as the dead host had them; then an arm runs into another."""
    events, touches = killed_and_begun_again(**STALLS_ALONE)
    assert touches == []
    waits, stops = [text for kind, text in events if kind == "alarm" and "still moving" in text]
    assert waits.startswith("18 positioners are still moving at the begin; no answer from 251")
    assert stops.endswith("positioners were still moving at the begin; all are stopped")


@pytest.mark.slow
def test_not_stopped_they_would_touch(monkeypatch):
    """What it is for."""
    on_the_way = AtRest._on_the_way

    async def nobody_collides(rest):
        return (await on_the_way(rest))[0], False

    monkeypatch.setattr(AtRest, "_on_the_way", nobody_collides)
    _, touches = killed_and_begun_again(**STALLS_ALONE)
    assert touches


STALLS_WHILE_CUT = {"cut_s": 4.0, "back_s": 40.0, "seed": 2, "faults": "stuck_hall=#275@5"}


def test_after_a_collision_nobody_moves_before_the_silent_ones_have_come_to_rest():
    """All that can be reached are stopped; nine behind the cut cable are still on their way."""
    events, touches = killed_and_begun_again(**STALLS_WHILE_CUT)
    assert touches == []
    *_, waits = [text for kind, text in events if kind == "alarm" and "waiting" in text]
    assert "no answer from 204, 206, 228" in waits
    assert "in whose way none may come" in waits


def test_one_that_gives_no_answer_is_stopped_too():
    """It may hear: nobody runs into it, nor it into anybody."""
    _, touches = killed_and_begun_again(
        cut_s=900.0, back_s=950.0, seed=3, faults="mute=#251@6,stuck_hall=#275@11"
    )
    assert touches == []


@pytest.mark.slow
def test_planned_by_where_they_are_on_their_way_arms_touch(monkeypatch):
    """What that wait is for."""

    async def stopped_only(rest, left_moving):
        await rest._stop_the_moving()

    monkeypatch.setattr(AtRest, "reach", stopped_only)
    assert killed_and_begun_again(**STALLS_WHILE_CUT)[1]


@pytest.mark.slow
def test_stopped_at_once_they_would_be(monkeypatch):
    """What the wait is for."""
    assert killed_and_begun_again(500.0, seed=2)[1] == []
    monkeypatch.setattr(AtRest, "_unheard", [])
    assert killed_and_begun_again(500.0, seed=2)[1]
