"""Trajectories under watch: what does not do its part is found, and costs the others nothing."""

import asyncio
import math
from functools import partial

import numpy as np
import pytest
from fakes import FakeBus, LinkedBus

from fiberloom.bus import Client, Command, DeviationKind, MotionWatch, Outcome, Status, WireTrajectory
from fiberloom.bus.identifier import decode

DURATION_S = 20.0
IDS = [1, 2, 3, 4, 5, 6]
OTHERS = [i for i in IDS if i != 3]


class Lenient(MotionWatch):
    """Lets everything go on."""

    async def may_go_on(self, deviations):
        return True


def ramp(end_deg, n=12):
    time_s = np.linspace(0.1, DURATION_S, n)
    return WireTrajectory.from_deg(time_s, np.linspace(0, end_deg, n), np.linspace(0, -end_deg, n))


def setup(bus_of=FakeBus, **kwargs):
    bus = bus_of(IDS)
    client = Client(bus, **kwargs)
    client.ids = IDS
    return bus, client


def moved(client, watch=None):
    return asyncio.run(client.run_trajectories({i: ramp(float(i)) for i in IDS}, watch=watch))


def of(results, ids):
    return {results[i].outcome for i in ids}


def aborts(bus, before_s=math.inf):
    """Positioners that were sent an abort."""
    return {decode(i).positioner for i, _ in bus.sent if decode(i).command == Command.SEND_TRAJECTORY_ABORT}


def misses_start(bus, number):
    bus.lose_request = lambda identifier: identifier[:2] == (number, Command.START_TRAJECTORY)


def test_a_missed_start_stops_the_others_at_once():
    bus, client = setup()
    misses_start(bus, 3)
    watch = MotionWatch()
    results = moved(client, watch)
    assert results[3].outcome is Outcome.NOT_STARTED
    assert of(results, OTHERS) == {Outcome.STOPPED}
    assert [(d.positioner, d.kind) for d in watch.deviations] == [(3, DeviationKind.NOT_STARTED)]
    assert bus.time_s < 1.0


def test_unwatched_a_missed_start_is_found_at_the_end_only():
    """What the watch is for: the test above is red without its polls."""
    bus, client = setup()
    misses_start(bus, 3)
    results = moved(client, MotionWatch(poll_s=math.inf))
    assert results[3].outcome is Outcome.MISPLACED
    assert bus.time_s > DURATION_S


def test_where_the_rule_allows_it_the_others_go_on_and_the_late_one_stays():
    bus, client = setup()
    misses_start(bus, 3)
    results = moved(client, Lenient())
    assert results[3].outcome is Outcome.NOT_STARTED
    assert of(results, OTHERS) == {Outcome.DONE}
    assert not bus.positioners[3].loaded  # a later START does not set it off


def test_a_refused_start_stops_the_others():
    bus, client = setup()
    bus.positioners[3].refuse = {Command.START_TRAJECTORY: 12}
    watch = MotionWatch()
    results = moved(client, watch)
    assert results[3].outcome is Outcome.REFUSED
    assert of(results, OTHERS) == {Outcome.STOPPED}
    assert watch.deviations[0].kind is DeviationKind.REFUSED
    assert bus.time_s < 0.5


class Scripted(FakeBus):
    """Does something once, at a time."""

    at_s, act = math.inf, None

    async def receive(self, timeout_s):
        if self.now_s >= self.at_s:
            self.at_s = math.inf
            self.act()
        return await super().receive(timeout_s)


def test_one_that_comes_to_rest_before_its_end_stops_the_others_within_two_polls():
    bus, client = setup(Scripted)
    bus.at_s = 7.3
    bus.act = lambda: setattr(bus.positioners[3], "busy_until_s", 0.0)
    watch = MotionWatch()
    results = moved(client, watch)
    assert [(d.positioner, d.kind) for d in watch.deviations] == [(3, DeviationKind.LEFT)]
    assert 7.3 < watch.deviations[0].time_s < 8.7
    assert 6.0 < watch.deviations[0].known_s <= 7.4
    assert of(results, OTHERS) == {Outcome.STOPPED}


@pytest.mark.parametrize(
    ("flag", "kind"),
    [(Status.ESTIMATED_POSITION, DeviationKind.LEFT), (Status.COLLISION, DeviationKind.COLLIDED)],
)
def test_a_bit_of_its_status_is_enough_although_it_says_that_it_moves(flag, kind):
    bus, client = setup(Scripted)
    bus.at_s = 7.3
    bus.act = lambda: setattr(bus.positioners[3], "flags", flag)
    watch = MotionWatch()
    results = moved(client, watch)
    assert [(d.positioner, d.kind) for d in watch.deviations] == [(3, kind)]
    assert 7.3 < watch.deviations[0].time_s < 8.7
    assert of(results, OTHERS) == {Outcome.STOPPED}


def test_one_that_falls_silent_stops_none_and_holds_up_none():
    bus, client = setup(Scripted)
    bus.at_s = 7.3
    bus.act = lambda: bus.positioners.pop(3)
    watch = MotionWatch()
    results = moved(client, watch)
    assert results[3].outcome is Outcome.TIMED_OUT
    assert of(results, OTHERS) == {Outcome.DONE}
    assert [(d.positioner, d.kind) for d in watch.deviations] == [(3, DeviationKind.SILENT)]


def silent_in(*gaps_s):
    """A hook that loses each status of positioner 3 in each of these (begin, end) in s."""

    def change(bus, identifier, frame):
        gone = identifier[:2] == (3, Command.GET_STATUS) and any(a < bus.time_s < b for a, b in gaps_s)
        return [] if gone else [(0.0, frame)]

    return change


def told_of(gaps_s):
    bus, client = setup()
    bus.change = partial(silent_in(*gaps_s), bus)
    watch = MotionWatch()
    assert of(moved(client, watch), IDS) == {Outcome.DONE}
    return [(d.positioner, d.kind) for d in watch.deviations]


def test_polls_without_an_answer_do_not_add_up_where_one_in_between_has_some():
    assert told_of([(4.5, 5.4), (6.6, 7.5), (8.7, 9.6)]) == []
    assert told_of([(4.5, 6.6)]) == [(3, DeviationKind.SILENT)]


class Asked(MotionWatch):
    """Keeps what it was asked when it was to choose whom to stop."""

    asked = None

    async def chosen(self, going):
        self.asked = self.asked or going
        return await super().chosen(going)


@pytest.mark.parametrize(("to_s", "unreachable"), [(6.5, set()), (DURATION_S, {3})])
def test_one_that_answers_again_after_a_while_can_be_stopped_with_the_others(to_s, unreachable):
    bus, client = setup(Scripted)
    bus.change = partial(silent_in((3.5, to_s)), bus)
    bus.at_s = 10.3
    bus.act = lambda: setattr(bus.positioners[5], "busy_until_s", 0.0)
    watch = Asked()
    moved(client, watch)
    assert [(d.positioner, d.kind) for d in watch.deviations] == [
        (3, DeviationKind.SILENT),
        (5, DeviationKind.LEFT),
    ]
    assert watch.asked.unreachable == unreachable
    assert watch.asked.reachable == {1, 2, 3, 4, 6} - unreachable


def test_it_is_asked_three_times_over_two_seconds_before_it_is_given_up():
    bus, client = setup()

    async def run():
        await client.goto(None, 1.0, 1.0)
        del bus.positioners[3]
        results = await client.wait_until_done(timeout_s=1.5)
        return results, bus.time_s, [t for t in bus.sent if decode(t[0])[:2] == (3, Command.GET_STATUS)]

    results, end_s, asked = asyncio.run(run())
    assert results[3].outcome is Outcome.TIMED_OUT
    assert of(results, OTHERS) == {Outcome.DONE}
    assert end_s >= 2.0
    assert len(asked) >= 3


def test_what_answers_again_from_its_end_has_arrived():
    """No reply of one positioner from just before the end until four seconds after it."""
    bus, client = setup()

    def change(identifier, frame):
        silent = identifier.positioner == 3 and DURATION_S - 0.5 < bus.time_s < DURATION_S + 4.0
        return [] if silent else [(0.0, frame)]

    bus.change = change
    assert of(moved(client), IDS) == {Outcome.DONE}


def test_a_link_that_is_down_stops_none_and_is_waited_for():
    bus, client = setup(LinkedBus)
    heard = []
    client.on_link(lambda link: heard.append((link.name, link.up)))
    bus.cut(1, 8.0, back_s=25.0)
    watch = MotionWatch()
    results = moved(client, watch)
    assert of(results, IDS) == {Outcome.DONE}
    assert heard == [("right", False), ("right", True)]
    assert {d.kind for d in watch.deviations} == {DeviationKind.LINK_DOWN}
    assert sorted(d.positioner for d in watch.deviations) == [2, 4, 6]


def test_a_link_that_stays_down_leaves_its_own_disconnected():
    bus, client = setup(LinkedBus)
    bus.cut(1, 8.0)
    results = moved(client)
    assert of(results, [2, 4, 6]) == {Outcome.DISCONNECTED}
    assert of(results, [1, 3, 5]) == {Outcome.DONE}
    assert bus.time_s < DURATION_S + 20.0


def test_no_start_is_sent_past_a_link_that_is_down():
    bus, client = setup(LinkedBus)

    async def run():
        await client.send_trajectories({i: ramp(1.0) for i in IDS})
        bus.links[1].goes_down("cut", bus.now_s)
        return await client.run_trajectories({i: ramp(1.0) for i in IDS}, partial=True)

    results = asyncio.run(run())
    assert of(results, [2, 4, 6]) == {Outcome.DISCONNECTED}
    # with partial, those that could be loaded go without the others
    assert of(results, [1, 3, 5]) == {Outcome.DONE}
    whole = asyncio.run(client.run_trajectories({i: ramp(2.0) for i in IDS}))
    assert of(whole, [1, 3, 5]) == {Outcome.STOPPED}


@pytest.mark.parametrize("percent", [0.1, 1.0, 5.0])
def test_lost_replies_leave_every_healthy_one_done(percent):
    for seed in range(5):
        random = np.random.default_rng(seed)
        bus, client = setup()
        bus.change = lambda identifier, frame, r=random: [(0.0, frame)] * (r.random() >= percent / 100)
        assert of(moved(client), IDS) == {Outcome.DONE}, seed


def test_lost_points_are_found_at_the_end_mark_and_sent_anew():
    bus, client = setup()
    lost = iter([True])

    def lose(identifier):
        return identifier[:2] == (3, Command.SEND_TRAJECTORY_DATA) and next(lost, False)

    bus.lose_request = lose
    assert of(moved(client), IDS) == {Outcome.DONE}
    assert sum(command == Command.SEND_NEW_TRAJECTORY for command, _ in bus.positioners[3].requests) == 2


def test_one_lost_reply_hides_no_positioner():
    bus, client = setup()
    lost = iter([True, False])
    bus.change = lambda i, frame: [] if i.positioner == 4 and next(lost, False) else [(0.0, frame)]
    assert asyncio.run(client.discover()) == IDS


def test_stop_all_is_repeated_until_it_is_answered():
    bus, client = setup()

    async def run():
        await client.goto(None, 90.0, 90.0)
        bus.lose_request = lambda i: i.positioner == 3 and bus.time_s < 0.25
        return await client.stop_all()

    results = asyncio.run(run())
    assert of(results, IDS) == {Outcome.DONE}
    assert bus.time_s < 0.5
    assert all(p.busy_until_s <= bus.time_s for p in bus.positioners.values())


def test_stop_all_keeps_the_flags_of_collisions_and_ends_in_time_without_an_answer():
    bus, client = setup()

    async def run():
        bus.collide(2, 0.0)
        await client.goto(None, 90.0, 90.0)
        del bus.positioners[3]
        return await client.stop_all(within_s=0.5)

    results = asyncio.run(run())
    assert results[3].outcome is Outcome.TIMED_OUT
    assert of(results, OTHERS) == {Outcome.DONE}
    assert bus.positioners[2].flags & Status.COLLISION_ALPHA
    assert bus.time_s == pytest.approx(0.5, abs=0.11)


def test_stop_all_raises_on_no_lost_connection():
    bus, client = setup()
    bus.dead = True
    assert of(asyncio.run(client.stop_all()), IDS) == {Outcome.DISCONNECTED}
