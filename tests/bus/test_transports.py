"""Real transports: a CAN@net gateway over TCP, played by a small server, and python-can."""

import asyncio
from itertools import pairwise

import numpy as np
import pytest
from fakes import FakeBus
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.bus import Client, Command, Frame, Outcome, PythonCanTransport, WireTrajectory, cannet
from fiberloom.bus.cannet import CanNetTransport, frame_to_line, line_to_frame
from fiberloom.bus.identifier import encode
from fiberloom.errors import InputError


class FakeGateway:
    """An NT 420 with positioners on its ports: port -> numbers."""

    def __init__(self, ports, refuse=None, mute=False):
        self.buses = {port: FakeBus(numbers) for port, numbers in ports.items()}
        self.refuse, self.mute = refuse, mute
        self.lines = []
        self.writers = []

    async def __aenter__(self):
        self.server = await asyncio.start_server(self.serve, "127.0.0.1", 0)
        self.address = f"127.0.0.1:{self.server.sockets[0].getsockname()[1]}"
        return self

    async def __aexit__(self, *error):
        self.hang_up()
        self.server.close()

    def hang_up(self):
        for writer in self.writers:
            writer.close()

    async def serve(self, reader, writer):
        self.writers.append(writer)
        while raw := await reader.readline():
            line = raw.decode().rstrip("\n")
            self.lines.append(line)
            if line.startswith("M "):
                await self.carry(line, writer)
            elif not self.mute:
                bad = self.refuse and self.refuse in line
                writer.write(b"R ERR 9 bad baudrate\n" if bad else b"R ok\n")

    async def carry(self, line, writer):
        port, frame = line_to_frame(line)
        bus = self.buses[port]
        await bus.send([frame])
        for reply in await bus.receive(1.0):
            writer.write((frame_to_line(port, reply) + "\n").encode())


def with_gateway(scenario, ports, **kwargs):
    async def run():
        async with FakeGateway(ports, **kwargs) as gateway:
            transport = await CanNetTransport.open([gateway.address], ports=tuple(ports))
            try:
                return await scenario(gateway, transport)
            finally:
                await transport.close()

    return asyncio.run(run())


@given(st.integers(1, 4), st.integers(0, (1 << 29) - 1), st.binary(max_size=8))
def test_a_frame_survives_its_line(port, identifier, data):
    assert line_to_frame(frame_to_line(port, Frame(identifier, data))) == (
        port,
        Frame(identifier, data),
    )


def test_the_golden_line():
    frame = Frame(encode(1, Command.GET_STATUS, 1), b"\x01\xff")
    assert frame_to_line(1, frame) == "M 1 CED 00040C10 01 FF"
    assert frame_to_line(4, Frame(0x400)) == "M 4 CED 00000400"


@pytest.mark.parametrize(
    "line",
    [
        "M 1 CSD 123 01",
        "M 1 FED 00040C10 01",
        "M 1 CER 00040C10 dlc=05",
        "M 5 CED 00040C10",
        "M 1 CED 00040C10 0",
        "M 1 CED 00040C10 01 02 03 04 05 06 07 08 09",
        "M 1 CED FFFFFFFF",
        "R ok",
        "",
        "E 1 BUSOFF",
    ],
)
def test_other_lines_are_no_frames(line):
    assert line_to_frame(line) is None


def test_ports_are_set_up_as_the_device_wants_it():
    async def scenario(gateway, transport):
        return list(gateway.lines)

    lines = with_gateway(scenario, {1: [1], 3: [2]})
    assert lines[:2] == ["CAN 1 STOP", "CAN 3 STOP"]
    assert lines[2:4] == ["CAN 1 INIT STD 1000", "CAN 3 INIT STD 1000"]
    assert lines[6] == "CAN 1 FILTER ADD EXT 00000000 00000000"
    assert lines[-1] == "CAN 3 START"


def test_positioners_are_found_and_spoken_to_on_their_own_port():
    async def scenario(gateway, transport):
        client = Client(transport)
        ids = await client.discover()
        t = [0.1, 0.2, 0.3]
        plan = {i: WireTrajectory.from_deg(t, [0, 1, 2], [0, 0, i]) for i in ids}
        return ids, await client.send_trajectories(plan)

    gateways = []

    async def keep(gateway, transport):
        gateways.append(gateway)
        return await scenario(gateway, transport)

    ids, sent = with_gateway(keep, {1: [5, 6], 2: [7]})
    assert ids == [5, 6, 7]
    assert sent.ok.all()
    carried = [line for line in gateways[0].lines if line.startswith("M ")]
    assert sum("M 2" in line for line in carried) == 3 + 1 + 6 + 1
    assert len(carried) == 3 * 2 + 3 * 8


def test_a_gateway_that_hangs_up_disconnects_its_positioners():
    async def scenario(gateway, transport):
        client = Client(transport)
        await client.discover()
        gateway.hang_up()
        results = await client.wait_until_done(timeout_s=1e6)
        return results, client.exchange.lost, transport.links[0].up, transport.links[0].reason

    results, lost, up, why = with_gateway(scenario, {1: [1, 2]})
    assert [r.outcome for r in results.values()] == [Outcome.DISCONNECTED] * 2
    assert lost is None  # it will reconnect
    assert not up
    assert "closed the connection" in why or "reset" in why.lower()


def test_events_of_the_device_are_kept():
    async def scenario(gateway, transport):
        gateway.writers[0].write(b"E 1 BUSOFF\nrubbish \xff\n")
        client = Client(transport)
        await client.discover()
        return transport.events

    events = with_gateway(scenario, {1: [1]})
    assert events[0].endswith("E 1 BUSOFF")


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [({"refuse": "INIT"}, "answered 'R ERR 9"), ({"mute": True}, "no answer to 'CAN 1 STOP'")],
)
def test_a_gateway_that_does_not_do_its_part_is_named(kwargs, message):
    async def run():
        async with FakeGateway({1: [1]}, **kwargs) as gateway:
            await CanNetTransport.open([gateway.address], ports=(1,), timeout_s=0.2)

    with pytest.raises(InputError, match=message):
        asyncio.run(run())


def test_no_gateway_at_all_is_an_input_error():
    for host, message in [("127.0.0.1:1", "no connection"), ("x:y", "HOST:PORT")]:
        with pytest.raises(InputError, match=message):
            asyncio.run(CanNetTransport.open([host]))
    with pytest.raises(InputError, match="250 kbit/s"):
        asyncio.run(CanNetTransport.open(["127.0.0.1"], bitrate_kbit=250))


def test_the_transmit_queue_of_the_gateway_is_never_overrun():
    # a port takes 100 frames at once and 3500 a second here: 400 must take at least 80 ms
    async def scenario(gateway, transport):
        client = Client(transport)
        await client.discover()
        begin_s = transport.time_s
        await client.exchange.unicast(Command.GET_STATUS, [1] * 400, [b""] * 400, 5.0)
        return transport.time_s - begin_s

    assert with_gateway(scenario, {1: [1]}) > 0.08


async def most_in_a_step(work, count):
    """By how much `count()` grows at most in one step of the loop, until `work` is done."""
    task, counts = asyncio.ensure_future(work), [count()]
    while not task.done():
        await asyncio.sleep(0)
        counts.append(count())
    return max(b - a for a, b in pairwise(counts))


def test_the_loop_goes_on_while_thousands_of_lines_are_read():
    async def scenario(gateway, transport):
        async def all_read():
            gateway.writers[0].write(b"E 1 NOTHING\n" * 3000)
            while len(transport.events) < 3000:
                await asyncio.sleep(0)

        return await most_in_a_step(all_read(), lambda: len(transport.events))

    assert with_gateway(scenario, {1: [1]}) <= 100


def test_the_loop_goes_on_while_hundreds_of_lines_are_written(monkeypatch):
    made = []

    def line(*arguments):
        made.append(arguments)
        return frame_to_line(*arguments)

    async def scenario(gateway, transport):
        client = Client(transport)
        ids = await client.discover()
        monkeypatch.setattr(cannet, "frame_to_line", line)
        asking = client.exchange.unicast(Command.GET_STATUS, ids, [b""] * len(ids), 5.0)
        return await most_in_a_step(asking, lambda: len(made))

    assert with_gateway(scenario, {1: range(1, 301)}) <= 100
    assert len(made) == 300


def test_python_can_carries_the_same_frames():
    import can

    async def positioners(bus, ready):
        """The other end of a virtual CAN bus."""
        fake = FakeBus([1, 2])
        ready.set()
        while True:
            message = await asyncio.to_thread(bus.recv, 0.02)
            if message is not None:
                await fake.send([(message.arbitration_id, bytes(message.data))])
                for reply in await fake.receive(0.1):
                    bus.send(can.Message(arbitration_id=reply.id, data=reply.data))

    async def run():
        other = can.Bus(interface="virtual", channel="fiberloom-test")
        ready = asyncio.Event()
        task = asyncio.create_task(positioners(other, ready))
        client = Client(PythonCanTransport.open("virtual", "fiberloom-test"))
        await ready.wait()
        ids = await client.discover(timeout_s=0.3)
        await client.set_position(None, [1.0, 2.0], -3.0)
        angles, ok = await client.positions_deg()
        task.cancel()
        await client.close()
        other.shutdown()
        return ids, angles, ok

    ids, angles, ok = asyncio.run(run())
    assert ids == [1, 2]
    assert ok.all()
    np.testing.assert_allclose(angles, [[1, -3], [2, -3]], atol=1e-6)


def test_an_unknown_can_interface_is_an_input_error():
    with pytest.raises(InputError, match="nonsense"):
        PythonCanTransport.open("nonsense", "0")
