"""The twin behind CAN@net devices on TCP: the project's own client drives it, and things go wrong.

The server's clock is the wall's, ten times as fast; nothing here depends on how fast the machine is,
but for time limits that are a hundred times what is needed.
"""

import asyncio
import contextlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fiberloom.bus import CanNetTransport, Client, Command, Outcome, Status, WireTrajectory
from fiberloom.bus.identifier import encode
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.faults.grammar import parse_faults
from fiberloom.twin.faults.schedule import schedule_faults
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.server import BACKLOG_BYTES, ServerSettings, TwinServer, places_of

PLANE = generate(load_instrument("sdssv"), seed=8, n_positioners=8)
UNITS = draw_units(PLANE, seed=2)
IDS = [int(i) for i in PLANE.positioner_id]
PORT_OF = {i: port for i, (_, port) in zip(IDS, places_of(8, 1), strict=True)}
VICTIM, HEALTHY = IDS[0], IDS[1:]
START = (10.0, 170.0)
SPEED = 10.0


@contextlib.asynccontextmanager
async def served(faults="", **kwargs):
    kwargs = {"speed": SPEED} | kwargs
    schedule = schedule_faults(parse_faults(faults), IDS, [(0, p) for p in (1, 2, 3, 4)], 0)
    twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False)
    server = TwinServer(twin, [Address("127.0.0.1", 0)], schedule=schedule, settings=ServerSettings(**kwargs))
    await server.open()
    try:
        yield server
    finally:
        server.close()


@contextlib.asynccontextmanager
async def connected(server, retries=1):
    transport = await CanNetTransport.open([str(server.listeners[0].address)])
    client = Client(transport, retries=retries)
    try:
        yield client
    finally:
        await client.close()


def run(scenario, **kwargs):
    """Runs a scenario with a server and a client; no scenario may take a minute."""

    async def whole():
        async with served(**kwargs) as server, connected(server) as client:
            client.ids = IDS
            return await scenario(server, client)

    return asyncio.run(asyncio.wait_for(whole(), 60.0))


def outcomes(results):
    return {i: r.outcome for i, r in results.items()}


async def until(server, time_s):
    """Waits for the twin's time."""
    while server.time_s < time_s:
        await asyncio.sleep(0.005)


async def arrive(client, ids, alpha_deg, beta_deg, timeout_s=5.0):
    begun = await client.goto(ids, alpha_deg, beta_deg)
    return await client.wait_until_done(begun.ok_ids, timeout_s, poll_s=0.02)


def test_found_moved_and_where_they_say():
    async def scenario(server, client):
        assert await client.discover() == sorted(IDS)
        done = await arrive(client, IDS, 22.5, 160.0)
        trajectories = {i: WireTrajectory.from_deg([0.1, 2.0], [22.5, 30.0], [160.0, 150.0]) for i in IDS}
        followed = await client.run_trajectories(trajectories)
        angles, ok = await client.positions_deg(IDS)
        return done, followed, angles, ok, server.report()

    # at the speed of the wall: a motion is watched by the client's clock
    done, followed, angles, ok, report = run(scenario, speed=1.0)
    assert done.ok.all()
    assert followed.ok.all()
    assert ok.all()
    np.testing.assert_allclose(angles, np.tile([30.0, 150.0], (8, 1)), atol=0.01)
    assert report["overflowed"] == report["lost"] == report["unread"] == 0
    assert report["clients"] == 1
    # every request was answered: what came in, by unicast or to each of four ports, went out
    assert report["frames_out"] >= report["frames_in"]


def test_a_broadcast_on_one_port_is_for_that_port():
    async def scenario(server, client):
        await client.exchange.transport.close()
        return [await heard_on(server, port) for port in (1, 2, 3, 4)]

    heard = run(scenario)
    assert [len(h) for h in heard] == [2, 2, 2, 2]
    assert sorted(np.ravel(heard)) == sorted(IDS)


async def heard_on(server, port):
    """Who answers GET_ID when only this port is asked."""
    address = server.listeners[0].address
    reader, writer = await asyncio.open_connection(address.host, address.port)
    for n in (1, 2, 3, 4):
        writer.write(f"CAN {n} INIT STD 1000\nCAN {n} FILTER ADD EXT 0 0\nCAN {n} START\n".encode())
    writer.write(f"M {port} CED 00000400\n".encode())
    lines = [await asyncio.wait_for(reader.readline(), 10.0) for _ in range(12 + 2)]
    writer.close()
    return [int(line.split()[3], 16) >> 18 for line in lines[12:]]


def test_positioners_go_on_while_nobody_is_connected():
    async def scenario():
        async with served() as server:
            async with connected(server) as client:
                begun = await client.goto(IDS, 40.0, 140.0)
                client.ids = IDS
                moving = await client.status(IDS)
            async with connected(server) as client:  # at once: the device must let go of the first
                await client.discover()
                done = await client.wait_until_done(timeout_s=10.0, poll_s=0.02)
                angles, _ = await client.positions_deg(IDS)
        return begun, moving, done, angles

    begun, moving, done, angles = asyncio.run(scenario())
    assert begun.ok.all()
    assert not any(Status(r.values[0]) & Status.DISPLACEMENT_COMPLETED for r in moving.values())
    assert done.ok.all()
    np.testing.assert_allclose(angles, np.tile([40.0, 140.0], (8, 1)), atol=0.01)


def test_a_second_host_is_turned_away_and_the_first_stays():
    async def scenario(server, client):
        with pytest.raises(InputError, match=r"no other client|no answer"):
            await CanNetTransport.open([str(server.listeners[0].address)], timeout_s=3.0)
        return await client.status(IDS), server.traffic.refused_clients

    status, refused = run(scenario)
    assert status.ok.all()
    assert refused == 1


def test_lost_replies_end_in_time_outs_and_nothing_hangs():
    async def scenario(server, client):
        lost = await client.command(Command.GET_STATUS, IDS, timeout_s=0.3)
        await until(server, 1.6)
        return lost, await client.status(IDS), server.traffic.lost

    # asked twice, 0.3 s each: all of it is within the loss
    lost, after, count = run(scenario, faults="lost=1@0+1.5", speed=1.0)
    assert set(outcomes(lost).values()) == {Outcome.TIMED_OUT}
    assert after.ok.all()
    assert count == 16


def test_some_lost_replies_are_made_up_for_by_asking_again():
    async def scenario(server, client):
        client.retries = 8
        return await client.positions_deg(IDS)

    angles, ok = run(scenario, faults="lost=0.4")
    assert ok.all()
    np.testing.assert_allclose(angles, np.tile(START, (8, 1)), atol=0.7)


def test_late_replies_meet_no_newer_request():
    async def scenario(server, client):
        first = await client.command(Command.GET_STATUS, IDS, timeout_s=0.1)
        again = await client.command(Command.GET_STATUS, IDS, timeout_s=5.0)
        return first, again, client.exchange.strays

    # 4 s of the twin are 0.4 s here
    first, again, strays = run(scenario, faults="late=1:4")
    assert set(outcomes(first).values()) == {Outcome.TIMED_OUT}
    assert again.ok.all()
    assert strays >= 8


def test_bus_off_silences_one_port_until_it_is_set_up_anew():
    async def scenario():
        async with served("busoff=1@0+3") as server:
            async with connected(server) as client:
                client.ids = IDS
                during = await client.command(Command.GET_STATUS, IDS, timeout_s=0.3)
                events = client.exchange.transport.events
                await until(server, 4.0)
                after = await client.command(Command.GET_STATUS, IDS, timeout_s=0.3)
            async with connected(server) as client:
                anew = await client.status(IDS)
        return during, events, after, anew

    during, events, after, anew = asyncio.run(scenario())
    silent = {i for i, r in during.items() if r.outcome is Outcome.TIMED_OUT}
    assert len(silent) == 2
    assert {PORT_OF[i] for i in silent} == {int(events[-1].split()[-2])}
    assert [e.split(": ")[1][4:] for e in events] == ["ERRORWARNING SET", "BUSOFF"]
    assert set(after.failed) == silent  # the controller stays off the bus
    assert anew.ok.all()


@pytest.mark.clock
def test_what_does_not_fit_the_queue_is_gone_and_the_device_says_so():
    async def scenario(server, client):
        # past the client's pacing: 300 requests to one positioner in one go, four for each uid
        frames = [f"M {PORT_OF[VICTIM]} CED {encode(VICTIM, 1, 1 + k % 63):08X}" for k in range(300)]
        gateway = client.exchange.transport._gateways[0]
        gateway.write([*frames, f"CAN {PORT_OF[VICTIM]} STATUS"])
        await client.sleep(0.3)
        return client.exchange.transport.events, client.exchange.strays, server.report()

    # slowly, so that the queue does not empty while the lines are read
    events, answered, report = run(scenario, speed=0.02)
    assert 0 < report["overflowed"] <= 199
    assert answered < 301
    assert report["frames_in"] == 300
    words = events[0].split()
    assert words[-2] == "--OT-"
    assert int(words[-1]) < 20
    # the client itself keeps below
    paced = run(flood, speed=1.0)
    assert paced["overflowed"] == 0


async def flood(server, client):
    await client.discover()
    await client.exchange.unicast(Command.GET_ID, [VICTIM] * 500, [b""] * 500, 20.0)
    return server.report()


@pytest.mark.clock
def test_a_power_cut_ends_in_silence_then_in_the_bootloader_then_as_new():
    async def scenario(server, client):
        await client.goto(IDS, 60.0, 120.0)
        await until(server, 2.0)
        off = await client.command(Command.GET_STATUS, IDS, timeout_s=0.03)
        await until(server, 3.5)
        in_boot = await client.wait_until_done(IDS, 2.0, poll_s=0.02)
        boot = await client.command(Command.GET_FIRMWARE_VERSION, [VICTIM])
        refused = await client.goto([VICTIM], 60.0, 120.0)
        await until(server, 15.0)
        version = await client.command(Command.GET_FIRMWARE_VERSION, [VICTIM])
        status = await client.status([VICTIM])
        moved = await client.goto([VICTIM], 60.0, 120.0)
        waited = await client.wait_until_done([VICTIM], 2.0, poll_s=0.02)
        return off, in_boot, boot, refused, version, status, moved, waited

    answers = run(scenario, faults=f"powercut=#{VICTIM}@1+2")
    off, in_boot, boot, refused, version, status, moved, waited = answers
    assert [i for i, r in off.items() if r.outcome is Outcome.TIMED_OUT] == [VICTIM]
    assert in_boot[VICTIM].outcome is Outcome.REFUSED  # its status is another
    assert all(in_boot[i].ok for i in HEALTHY)
    assert boot[VICTIM].ok
    assert refused[VICTIM].outcome is Outcome.REFUSED  # 11: not in the bootloader
    assert version[VICTIM].ok
    assert version[VICTIM].values != boot[VICTIM].values
    # it was in motion: its position is a guess, and without a datum nothing moves
    bits = Status(status[VICTIM].values[0])
    assert Status.ESTIMATED_POSITION in bits
    assert not bits & Status.DATUM_ALPHA_INITIALIZED
    assert moved[VICTIM].outcome is Outcome.REFUSED
    assert waited[VICTIM].outcome is Outcome.MISPLACED  # it rests, but not where it was sent


def test_a_liar_reports_arrival_and_a_stuck_hall_sensor_is_a_collision():
    liar, stuck = IDS[2], IDS[3]

    async def scenario(server, client):
        done = await arrive(client, IDS, 30.0, 150.0)
        await client.sleep(0.1)
        others = [i for i in IDS if i != stuck]
        await arrive(client, others, 30.0, 150.0)  # the collision stopped them
        with server.real.held() as twin:
            truth = dict(zip(IDS, twin.truth(), strict=True))
        angles, _ = await client.positions_deg([liar])
        return done, truth, angles

    done, truth, angles = run(scenario, faults=f"lying=#{liar},stuck_hall=#{stuck}")
    assert done[stuck].outcome is Outcome.COLLIDED
    assert np.abs(angles - [30.0, 150.0]).max() < 0.01
    assert np.abs(truth[liar] - START).max() < 0.7
    assert np.abs(truth[HEALTHY[0]] - [30.0, 150.0]).max() < 0.7


def test_a_server_that_goes_leaves_everybody_disconnected():
    async def scenario(server, client):
        waiting = asyncio.create_task(client.wait_until_done(IDS, 1e6, expected_s=1e6))
        await asyncio.sleep(0.05)
        server.listeners[0].host.transport.abort()
        return await waiting, await client.status(IDS)

    waited, status = run(scenario)
    assert set(outcomes(waited).values()) == {Outcome.DISCONNECTED}
    assert set(outcomes(status).values()) == {Outcome.DISCONNECTED}


def test_a_gateway_that_stops_reading_is_a_lost_connection(monkeypatch):
    async def scenario(server, client):
        monkeypatch.setattr("fiberloom.bus.cannet._STALL_S", 0.05)
        writer = client.exchange.transport._gateways[0].writer
        monkeypatch.setattr(writer, "drain", asyncio.Event().wait)
        await client.status(IDS)
        return await client.status(IDS), client.exchange.transport.links[0]

    status, link = run(scenario)
    assert set(outcomes(status).values()) == {Outcome.DISCONNECTED}
    assert "no longer takes" in link.reason


async def survives(data):
    """Sends rubbish, hangs up, and asks something sensible."""
    async with served() as server:
        address = server.listeners[0].address
        _, writer = await asyncio.open_connection(address.host, address.port)
        for piece in data:
            writer.write(piece)
            await asyncio.sleep(0)
        with contextlib.suppress(ConnectionError):
            await writer.drain()
        writer.close()
        async with connected(server) as client:
            client.ids = IDS
            return await client.status(IDS)


@settings(max_examples=15, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(
        st.binary(max_size=300)
        | st.sampled_from(
            [b"CAN 1 START\n", b"M 1 CED 000", b"M 1 CED 00000400\n", b"\n" * 5000, b"A" * 100_000]
        ),
        max_size=8,
    )
)
def test_rubbish_on_the_socket_harms_nobody(data):
    assert asyncio.run(survives(data)).ok.all()


def test_an_address_in_use_is_an_input_error():
    async def scenario(server, client):
        other = TwinServer(Twin(PLANE, UNITS, threads=1), [server.listeners[0].address])
        with pytest.raises(InputError, match="choose another address"):
            await other.open()

    run(scenario)


class Deaf:
    """A socket that nobody reads."""

    waiting = 0

    def write(self, data):
        self.waiting += len(data)

    def get_write_buffer_size(self):
        return self.waiting

    def is_closing(self):
        return False


def test_what_a_host_does_not_read_is_thrown_away_and_counted():
    async def scenario(server, client):
        listener = server.listeners[0]
        mine, listener.host.transport = listener.host.transport, Deaf()
        for _ in range(BACKLOG_BYTES // 50):
            listener.write("M 1 CED 00040C10 01 02 03 04 05 06 07 08 and so on and so on and so on")
        kept, listener.host.transport = listener.host.transport.waiting, mine
        return kept, server.traffic.unread

    kept, unread = run(scenario)
    assert BACKLOG_BYTES <= kept < BACKLOG_BYTES + 100
    assert unread > 5000


# who waits for a device, and what else the schedule does


async def visitor(server):
    """A connection of another program, by its two ends."""
    address = server.listeners[0].address
    return await asyncio.open_connection(address.host, address.port)


def test_one_host_may_wait_for_a_moment_a_third_may_not():
    async def scenario(server, client):
        patient, writer = await visitor(server)
        for _ in range(2):
            hurried, other = await visitor(server)
            assert await hurried.read() == b""  # hung up on
            other.close()
        refused = server.traffic.refused_clients
        assert await patient.read() == b""
        writer.close()
        return refused, server.traffic.refused_clients, await client.status(IDS)

    refused, at_last, status = run(scenario)
    assert refused >= 2
    assert at_last == 3
    assert status.ok.all()


def test_what_a_host_says_while_it_waits_is_answered_in_its_turn(monkeypatch):
    monkeypatch.setattr("fiberloom.twin.server.server.GRACE_S", 30.0)

    async def scenario():
        async with served() as server:
            _, first = await visitor(server)
            await asyncio.sleep(0.05)
            reader, second = await visitor(server)
            second.write(b"DEV IDENT")
            await second.drain()
            await asyncio.sleep(0.05)
            second.write(b"IFY\n")
            await asyncio.sleep(0.05)
            first.close()
            answer = await reader.readline()
            second.close()
            return answer, server.traffic.clients

    answer, clients = asyncio.run(asyncio.wait_for(scenario(), 20.0))
    assert answer == b"R CAN@net NT 420\n"
    assert clients == 2


def test_one_that_waited_and_went_leaves_its_place_to_the_next(monkeypatch):
    monkeypatch.setattr("fiberloom.twin.server.server.GRACE_S", 30.0)

    async def scenario(server, client):
        _, gone = await visitor(server)
        gone.close()
        await asyncio.sleep(0.05)
        reader, next_one = await visitor(server)
        await asyncio.sleep(0.05)
        await client.close()
        next_one.write(b"DEV IDENTIFY\n")
        answer = await reader.readline()
        next_one.close()
        return answer, server.traffic.refused_clients

    assert run(scenario) == (b"R CAN@net NT 420\n", 0)


def test_served_in_the_bootloader_none_moves():
    async def scenario(server, client):
        moved = await client.goto(IDS, 60.0, 120.0)
        with server.real.held() as twin:
            return moved, twin.truth()

    moved, truth = run(scenario, bootloader=True)
    assert set(outcomes(moved).values()) == {Outcome.REFUSED}
    np.testing.assert_allclose(truth, np.tile(START, (8, 1)), atol=0.7)


def test_faults_of_camera_and_sensor_come_and_go_by_the_twins_time():
    async def scenario(server, client):
        before = server.faults()
        await until(server, 2.2)
        during = server.faults(), (await arrive(client, [VICTIM], 20.0, 160.0))[VICTIM].outcome
        await until(server, 30.2)
        after = server.faults()
        with server.real.held() as twin:
            return before, during, after, twin.dark.tolist(), server.look().lit_mm, server.happened

    before, during, after, dark, lit_mm, happened = run(
        scenario, faults=f"camera_half@2+28,stuck_hall=#{VICTIM}@2+28,dark=#{IDS[1]}@2+1"
    )
    assert before == after == frozenset()
    assert during == ({"camera_half"}, Outcome.COLLIDED)
    assert not any(dark)
    assert np.isfinite(lit_mm).all()
    assert len(happened) == 6
    assert sum(text.endswith(" ends") for text in happened) == 3


def test_what_a_camera_sees_of_a_twin_that_is_not_served_yet():
    twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False)
    look = TwinServer(twin, [Address("127.0.0.1", 0)]).look()
    np.testing.assert_array_equal(look.lit_mm, twin.fibre_xy("metrology"))
    assert look.time_s == twin.time_s
