"""LAMOST over TCP: packets of many units on one connection, observed with a noisy camera."""

import asyncio

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.connect import open_hardware
from fiberloom.drive.lamost import RadioPacket, RadioReader, TcpRadio, decoded, encoded, radio_address
from fiberloom.drive.lamost.radio import packet_of
from fiberloom.errors import InputError
from fiberloom.targets.generate import random_targets
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.server.address import Address
from fiberloom.twin.steppers.array import StepperArray
from fiberloom.twin.steppers.megara import MegaraBus
from fiberloom.twin.steppers.served import RadioServer
from support.served_steppers import SEED, free_ports, hang_up_in_mid_move, loses_nothing, observed_at_once

N = 7
PLANE = fl.FocalPlane.of("lamost", seed=SEED, n=N)


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """Fields over TCP by name."""
    folder = tmp_path_factory.mktemp("fields")
    with observed_at_once(PLANE, folder, whole={}, dropped={"meanwhile": hang_up_in_mid_move}) as field:
        yield field


def test_a_whole_field_is_observed_over_tcp(field, tmp_path):
    over_tcp = field("whole")
    seen, server = over_tcp.seen, over_tcp.server
    assigned = seen.assignment.target >= 0
    assert over_tcp.named == {}
    assert len(seen.summary()["moves"]) == 2
    assert over_tcp.off_um[assigned].max() < 40.0
    here = fl.Field.twin(PLANE, seed=SEED, camera="noise")
    within = here.run.observe(random_targets(PLANE, 3 * N, seed=1), out=tmp_path / "within")
    blind = [run.moves[0].measured_error_um[assigned] for run in (seen, within)]
    np.testing.assert_allclose(*blind, atol=0.5)  # the same units, seen by the same draw of noise
    assert server.report()["contacts"] == 0
    assert server.report()["clients"] == 1


def test_a_connection_that_drops_in_mid_move_loses_nothing(field):
    loses_nothing(field("dropped"), clients=2, within_um=40.0)


def test_half_a_packet_of_a_lost_connection_does_not_eat_the_next_one():
    bus = MegaraBus(StepperArray(PLANE, seed=0))
    server = RadioServer(bus, Address("127.0.0.1", free_ports()), FaultClock(bus, (), SEED))
    one = int(PLANE.positioner_id[0])
    long, short = (packet_of(4 * one, data) for data in (b"\x02\x00\x00\x00\x00", b"\x06"))
    half = long[:3]
    assert len(half) + len(short) < len(long)  # together still no whole packet

    async def scenario():
        await server.open()
        try:
            _, before = await asyncio.open_connection("127.0.0.1", server.address.port)
            before.write(half)
            while server.traffic["bytes_in"] < len(half):
                await asyncio.sleep(0.01)
            before.close()
            reader, writer = await asyncio.open_connection("127.0.0.1", server.address.port)
            writer.write(short)
            try:
                return await asyncio.wait_for(reader.read(100), 5.0)
            finally:
                writer.close()
        finally:
            server.close()

    assert decoded(asyncio.run(scenario())).identifier >> 2 == one


def test_half_an_answer_of_a_lost_connection_does_not_eat_the_next_one():
    long, short = (packet_of(4, data) for data in (b"\x02\x00\x00\x00\x00", b"\x06"))
    answers = [long[:3], short]

    async def scenario():
        async def serve(reader, writer):
            writer.write(answers.pop(0))
            await writer.drain()
            if not answers:
                await reader.read()  # until the other side ends
            writer.close()

        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        radio = TcpRadio(*server.sockets[0].getsockname()[:2])
        await radio.open()
        try:
            return await radio.receive(10.0)
        finally:
            await radio.close()
            server.close()
            await server.wait_closed()
            await asyncio.sleep(0.05)

    assert asyncio.run(scenario()) == [short]


def test_a_stream_is_cut_into_packets_whatever_is_between_them():
    one, two = (encoded(RadioPacket(1, 4 * unit, b"\x04")) for unit in (1, 2))
    reader = RadioReader()
    assert reader.feed(one[:3]) == []
    assert reader.feed(one[3:] + b"\xff\x00" + two) == [one, two]
    damaged = bytes([one[0], one[1] ^ 1, *one[2:]])
    assert two in reader.feed(damaged + two + two)


def test_where_nothing_listens_it_says_where():
    port = free_ports()
    with pytest.raises(InputError, match=f"radio 127.0.0.1:{port}: no connection"):
        asyncio.run(TcpRadio("127.0.0.1", port).open())
    with pytest.raises(InputError, match="lamost are behind radio://HOST"):
        open_hardware(PLANE, "cannet://127.0.0.1", None)


@pytest.mark.parametrize("text", ["", ":4900", "host:0", "host:65536", "host:a"])
def test_addresses(text):
    with pytest.raises(InputError, match="with a port 1 to 65535"):
        radio_address(text)
    assert radio_address("host") == ("host", 4900)
    assert radio_address("host:4800") == ("host", 4800)
