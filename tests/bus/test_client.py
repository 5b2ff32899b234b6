"""The client against scripted positioners: every request ends in a clear outcome, in time."""

import asyncio
from random import Random

import numpy as np
import pytest
from fakes import FakeBus
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom.bus import Client, Command, Frame, Outcome, Response, Status, WireTrajectory
from fiberloom.bus.identifier import decode, encode
from fiberloom.errors import InputError


def setup(*numbers, **kwargs):
    bus = FakeBus(numbers)
    client = Client(bus, **kwargs)
    client.ids = sorted(numbers)
    return bus, client


def outcomes(results):
    return [r.outcome for r in results.values()]


def ramp(end_deg, n=5, duration_s=2.0):
    return WireTrajectory.from_deg(
        np.linspace(0.1, duration_s, n), np.linspace(0, end_deg, n), np.linspace(0, -end_deg, n)
    )


def test_discover_finds_those_on_the_bus():
    bus, client = setup(7, 3, 500)
    assert asyncio.run(client.discover()) == [3, 7, 500]
    # once, and until two rounds have brought no other
    assert bus.sent == [(encode(0, Command.GET_ID), b"")] * 3


def test_firmware_version_and_positions():
    _, client = setup(1, 2)
    assert asyncio.run(client.firmware_versions()) == {1: "04.01.21", 2: "04.01.21"}

    async def run():
        await client.set_position([2], 90.0, -45.0)
        return await client.positions_deg()

    angles, ok = asyncio.run(run())
    np.testing.assert_allclose(angles, [[0, 0], [90, -45]], atol=1e-6)
    assert ok.all()


def test_a_goto_is_waited_for():
    bus, client = setup(1, 2)

    async def run():
        begun = await client.goto(None, [10.0, 20.0], 30.0)
        return begun, await client.wait_until_done()

    begun, done = asyncio.run(run())
    assert begun.ok.all()
    assert begun[1].values == (2000, 2000)
    assert done.ok.all()
    assert 1.0 <= bus.time_s < 1.3
    assert bus.positioners[2].goal[0] == round(20 / 360 * 2**30)


def test_a_refusal_carries_its_code():
    bus, client = setup(1, 2)
    bus.positioners[2].refuse[Command.GO_TO_ABSOLUTE_POSITION] = 4
    results = asyncio.run(client.goto(None, 1.0, 1.0))
    assert outcomes(results) == [Outcome.DONE, Outcome.REFUSED]
    assert results[2].code is Response.DATUM_NOT_INITIALIZED
    assert "positioner 2: refused (DATUM_NOT_INITIALIZED)" in str(results)


def test_a_silent_positioner_times_out_and_the_others_go_on():
    _, client = setup(1, 2)
    results = asyncio.run(client.command(Command.GET_STATUS, [1, 9, 2]))
    assert outcomes(results) == [Outcome.DONE, Outcome.TIMED_OUT, Outcome.DONE]


def test_a_lost_reply_is_asked_for_again_when_that_does_no_harm():
    bus, client = setup(1)
    lost = iter([True])
    bus.change = lambda i, f: [] if next(lost, False) else [(0.0, f)]
    assert asyncio.run(client.positions()).ok.all()
    assert len(bus.positioners[1].requests) == 2


def test_a_relative_move_is_never_sent_twice():
    bus, client = setup(1)
    bus.change = lambda i, f: []
    results = asyncio.run(client.goto([1], 5.0, 5.0, relative=True))
    assert outcomes(results) == [Outcome.TIMED_OUT]
    assert len(bus.positioners[1].requests) == 1


def test_an_absolute_move_whose_reply_got_lost_is_under_way():
    bus, client = setup(1)
    bus.positioners[1].move_s = 20.0
    lost = iter([True])
    bus.change = lambda i, f: [] if next(lost, False) else [(0.0, f)]
    assert outcomes(asyncio.run(client.goto([1], 5.0, 5.0))) == [Outcome.DONE]


def test_a_reply_with_a_foreign_uid_is_no_reply():
    bus, client = setup(1, retries=0)
    bus.change = lambda i, f: [(0.0, Frame(f.id ^ (5 << 4), f.data))]
    results = asyncio.run(client.positions())
    assert outcomes(results) == [Outcome.TIMED_OUT]
    assert client.exchange.strays == 1


def test_doubled_replies_are_dropped():
    bus, client = setup(1)
    bus.change = lambda i, f: [(0.0, f), (0.01, f)]

    async def run():
        first = await client.positions()
        await client.sleep(0.1)
        return first, await client.status()

    first, second = asyncio.run(run())
    assert first.ok.all()
    assert second.ok.all()
    assert client.exchange.strays == 1


def test_a_late_reply_does_not_answer_a_newer_request():
    bus, client = setup(1, retries=0)
    late = iter([1.5])
    bus.change = lambda i, f: [(next(late, 0.0), f)]

    async def run():
        first = await client.positions()  # gives up after 1 s
        bus.positioners[1].goal = [5, 5]
        bus.change = lambda i, f: [(0.9, f)]  # the newer reply comes after the late one
        return first, await client.positions()

    first, second = asyncio.run(run())
    assert outcomes(first) == [Outcome.TIMED_OUT]
    assert second[1].values == (5, 5)
    assert client.exchange.strays == 1


def test_a_lost_connection_ends_everything_at_once():
    bus, client = setup(1, 2)

    async def run():
        await client.goto(None, 1.0, 1.0)
        bus.dead = True
        return await client.wait_until_done(timeout_s=1e9), await client.positions()

    waited, asked = asyncio.run(run())
    assert outcomes(waited) == outcomes(asked) == [Outcome.DISCONNECTED] * 2
    assert "closed" in client.exchange.lost


def test_a_clock_that_stands_still_is_a_lost_connection():
    bus, client = setup(1)

    async def nothing(timeout_s):
        return []

    bus.receive = nothing
    assert outcomes(asyncio.run(client.positions())) == [Outcome.DISCONNECTED]
    assert "clock" in client.exchange.lost


def test_a_positioner_that_never_arrives_times_out():
    bus, client = setup(1, 2)
    bus.positioners[2].move_s = 1e5

    async def run():
        await client.goto(None, 1.0, 1.0)
        return await client.wait_until_done(timeout_s=30.0)

    assert outcomes(asyncio.run(run())) == [Outcome.DONE, Outcome.TIMED_OUT]
    assert bus.time_s == pytest.approx(30.0, abs=0.2)


def test_a_positioner_that_falls_silent_in_a_move_does_not_hold_up_the_others():
    bus, client = setup(*range(1, 11))

    async def run():
        await client.goto(None, 1.0, 1.0)
        del bus.positioners[4]
        return await client.wait_until_done(timeout_s=1000.0)

    results = asyncio.run(run())
    assert results.failed.keys() == {4}
    assert results[4].outcome is Outcome.TIMED_OUT
    assert bus.time_s < 10.0


def test_a_collision_is_delivered_and_stops_the_others():
    bus, client = setup(1, 2, 3)
    heard = []
    client.on_collision(heard.append)

    async def run():
        await client.goto(None, 90.0, 90.0)
        bus.collide(2, 0.3)
        return await client.wait_until_done(expected_s=10.0)

    results = asyncio.run(run())
    assert outcomes(results) == [Outcome.STOPPED, Outcome.COLLIDED, Outcome.STOPPED]
    assert [c.positioner for c in heard] == [2] == [c.positioner for c in client.collisions]
    assert bus.time_s < 0.4
    for number in (1, 3):
        assert bus.positioners[number].requests[-1][0] == Command.SEND_TRAJECTORY_ABORT


def test_a_collision_seen_only_in_the_status_counts():
    bus, client = setup(1, 2)

    async def run():
        await client.goto(None, 90.0, 90.0)
        bus.positioners[1].flags = Status.COLLISION_BETA
        return await client.wait_until_done(stop_on_collision=False)

    assert outcomes(asyncio.run(run())) == [Outcome.COLLIDED, Outcome.DONE]


def test_stop_clears_collisions():
    bus, client = setup(1)

    async def run():
        bus.collide(1, 0.0)
        await client.sleep(0.1)
        before = await client.wait_until_done()
        await client.stop()
        return before, await client.wait_until_done()

    before, after = asyncio.run(run())
    assert (outcomes(before), outcomes(after)) == ([Outcome.COLLIDED], [Outcome.DONE])


def test_modes_use_the_protocols_numbers():
    bus, client = setup(1)

    async def run():
        for closed in (True, False):
            for detection in (True, False):
                await client.set_loop(closed=closed, collision_detection=detection)
        await client.set_precise_moves(on=True)
        await client.set_precise_moves(on=False)
        await client.home()
        await client.home(axis="alpha")
        await client.home(axis="beta")
        await client.set_speed(None, 1000, 2000)

    asyncio.run(run())
    numbers = [c for c, _ in bus.positioners[1].requests]
    assert numbers == [118, 122, 119, 123, 120, 124, 121, 125, 128, 130, 129, 131, 20, 21, 22, 40]


def test_a_speed_out_of_range_is_refused_before_it_is_sent():
    bus, client = setup(1)
    with pytest.raises(InputError, match="beta speed 6000 rpm"):
        asyncio.run(client.set_speed(None, 1000, 6000))
    assert not bus.sent


def test_trajectories_arrive_point_by_point_and_run():
    bus, client = setup(1, 2, 3)
    trajectories = {1: ramp(10.0, 33), 2: ramp(-5.0, 2), 3: ramp(1.0, 7)}
    results = asyncio.run(client.run_trajectories(trajectories))
    assert results.ok.all(), str(results)
    for number, trajectory in trajectories.items():
        sent = bus.positioners[number]
        assert sent.ends == (len(trajectory.alpha), len(trajectory.beta))
        expected = np.concatenate([trajectory.alpha, trajectory.beta])
        np.testing.assert_array_equal(sent.points, expected)
        assert tuple(sent.goal) == trajectory.end_counts
    assert 2.0 <= bus.time_s < 2.3


def test_trajectory_data_is_the_same_bytes_as_recorded():
    bus, client = setup(1)
    trajectory = WireTrajectory(np.array([[2982616, 200]]), np.array([[-1, 4000]]))
    asyncio.run(client.send_trajectories({1: trajectory}))
    frames = [(decode(i)[1], d.hex()) for i, d in bus.sent]
    assert frames == [
        (10, "0100000001000000"),
        (11, "d8822d00c8000000"),
        (11, "ffffffffa00f0000"),
        (12, ""),
    ]


def test_no_bite_is_sent_before_the_last_is_answered():
    bus, client = setup(1, bite=3)
    asyncio.run(client.send_trajectories({1: ramp(1.0, 6)}))
    data = [decode(i) for i, _ in bus.sent if decode(i).command == 11]
    assert len(data) == 12
    assert [i.uid for i in data] == list(range(1, 13))  # in order, none reused while in flight


def test_one_lost_data_reply_sends_the_whole_trajectory_again():
    bus, client = setup(1, 2)
    lost = iter([False, True])
    bus.change = lambda i, f: [] if i.command == 11 and next(lost, False) else [(0.0, f)]
    trajectories = {1: ramp(10.0), 2: ramp(20.0)}
    results = asyncio.run(client.send_trajectories(trajectories))
    assert results.ok.all(), str(results)
    for number, trajectory in trajectories.items():
        expected = np.concatenate([trajectory.alpha, trajectory.beta])
        np.testing.assert_array_equal(bus.positioners[number].points, expected)


def test_nobody_starts_when_one_refuses_its_trajectory():
    bus, client = setup(1, 2)
    bus.positioners[2].refuse[Command.TRAJECTORY_DATA_END] = 2
    results = asyncio.run(client.run_trajectories({1: ramp(10.0), 2: ramp(20.0)}))
    assert outcomes(results) == [Outcome.STOPPED, Outcome.REFUSED]
    assert results[2].code is Response.INVALID_TRAJECTORY
    assert bus.positioners[1].goal == [0, 0]
    assert not bus.positioners[1].loaded
    assert not bus.positioners[2].loaded


def test_the_others_start_when_a_part_of_the_plan_is_wanted():
    bus, client = setup(1, 2)
    bus.positioners[2].refuse[Command.SEND_NEW_TRAJECTORY] = 4
    results = asyncio.run(client.run_trajectories({1: ramp(10.0), 2: ramp(20.0)}, partial=True))
    assert outcomes(results) == [Outcome.DONE, Outcome.REFUSED]
    assert bus.positioners[1].goal[0] > 0


def test_arrival_claimed_without_motion_is_found_after_the_abort():
    bus, client = setup(1, 2)
    bus.positioners[2].lies = True
    results = asyncio.run(client.run_trajectories({1: ramp(10.0), 2: ramp(20.0)}))
    assert outcomes(results) == [Outcome.DONE, Outcome.MISPLACED]


def test_more_requests_than_uids_wait_for_their_turn():
    _, client = setup(1)

    async def run():
        many = [client.positions([1]) for _ in range(150)]
        return await asyncio.gather(*many)

    assert all(r.ok.all() for r in asyncio.run(run()))


def test_one_batch_larger_than_the_uid_pool_is_answered():
    _, client = setup(1, 2)
    replies = asyncio.run(client.exchange.unicast(Command.GET_STATUS, [1, 2] * 100, [b""] * 200, 1.0))
    assert all(r is not None for r in replies)


def test_concurrent_requests_keep_their_own_deadlines():
    bus, client = setup(1, retries=0)

    async def run():
        silent = client.command(Command.GET_STATUS, [9], timeout_s=5.0)
        quick = client.command(Command.GET_STATUS, [8], timeout_s=0.5)
        ends = []

        async def timed(request):
            await request
            ends.append(bus.time_s)

        await asyncio.gather(timed(silent), timed(quick))
        return ends

    assert asyncio.run(run()) == pytest.approx([0.5, 5.0], abs=2e-3)  # the shortest wait is 1 ms


def test_unfit_trajectories_are_named():
    with pytest.raises(InputError, match="alpha: times must grow"):
        WireTrajectory.from_deg([0.1, 0.1001], [0, 1], [0, 1])
    with pytest.raises(InputError, match="at least one"):
        WireTrajectory.from_deg([], [], [])
    with pytest.raises(InputError, match="720"):
        WireTrajectory.from_deg([0.1, 1.0], [0, 800], [0, 1])
    with pytest.raises(InputError, match="2 times but 3 angles"):
        WireTrajectory.from_deg([0.1, 1.0], [0, 1, 2], [0, 1])


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1).map(Random), st.integers(0, 60), st.booleans())
def test_whatever_the_bus_does_everyone_gets_an_outcome(random, percent, dies):
    bus, client = setup(1, 2, 3, 4, 5)
    loss = percent / 100

    def change(identifier, frame):
        copies = random.choices([0, 1, 2], [loss, 1 - loss, 0.1])[0]
        if random.random() < 0.05:
            frame = Frame(random.getrandbits(29), frame.data)
        return [(random.choice([0.0, 0.01, 3.0]), frame)] * copies

    bus.change = change
    bus.lose_request = lambda identifier: random.random() < loss

    async def run():
        trajectories = {i: ramp(float(i), 4) for i in bus.positioners}
        first = await client.run_trajectories(trajectories, partial=True)
        bus.dead = dies
        await client.goto(None, 3.0, 3.0)
        return first, await client.wait_until_done(timeout_s=20.0)

    for results in asyncio.run(run()):
        assert list(results) == [1, 2, 3, 4, 5]
        assert all(isinstance(r.outcome, Outcome) for r in results.values())
        for number in results.ok_ids:
            assert results[number].outcome is Outcome.DONE
    assert not client.exchange._pending
    assert not client.exchange._deadlines
