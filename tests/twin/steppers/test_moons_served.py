"""MOONS over TCP: a whole observation through three ports, and what is told where there is none."""

import asyncio
import socket
from contextlib import suppress

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.connect import open_hardware
from fiberloom.drive.kept_connection import KeptConnection
from fiberloom.drive.moons.tcp import TcpGateways, gateway_address
from fiberloom.errors import InputError
from fiberloom.targets.generate import random_targets
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.steppers.kinds import KINDS
from fiberloom.twin.steppers.source import StepperSource
from support.served_steppers import SEED, free_ports, hang_up_in_mid_move, loses_nothing, observed

N = 7


@pytest.fixture(scope="module")
def plane():
    return fl.FocalPlane.of("moons", seed=SEED, n=N)


def test_a_whole_field_is_observed_over_tcp(plane, tmp_path):
    over_tcp = observed(plane, tmp_path)
    seen, off_um, server = over_tcp.seen, over_tcp.off_um, over_tcp.server
    summary, assigned = seen.summary(), seen.assignment.target >= 0
    assert summary["faults"] == {}
    assert len(summary["moves"]) == 1
    assert assigned.sum() >= N - 1
    field = fl.Field.twin(plane, seed=SEED, camera="noise")
    within = field.run.observe(random_targets(plane, 3 * N, seed=1), out=tmp_path / "within")
    np.testing.assert_allclose(off_um[assigned], within.error_um(within.final)[assigned], atol=0.1)
    assert server.report()["contacts"] == 0
    assert server.traffic["clients"] == 3
    assert server.traffic["bytes_out"] > 1000


def test_a_deaf_unit_is_named_and_the_others_arrive(plane, tmp_path):
    over_tcp = observed(plane, tmp_path, "deaf=1")
    seen, off_um = over_tcp.seen, over_tcp.off_um
    (deaf,) = seen.summary()["faults"]["dead"]
    blocked = seen.summary()["faults"].get("blocked", [])
    others = (seen.assignment.target >= 0) & ~np.isin(plane.positioner_id, [deaf, *blocked])
    assert others.sum() >= 2
    assert np.median(off_um[others]) < 10.0
    assert off_um[others].max() < 30.0  # 20 um is what one in a thousand is beyond


def test_connections_that_drop_in_mid_move_lose_nothing(plane, tmp_path):
    over_tcp = observed(plane, tmp_path, meanwhile=hang_up_in_mid_move)
    loses_nothing(over_tcp, clients=6, within_um=30.0)  # three gateways, twice


def test_where_nothing_listens_it_says_where(plane):
    first = free_ports()
    with pytest.raises(InputError, match=f"gateways 127.0.0.1:{first} to {first + 2}: no connection"):
        asyncio.run(TcpGateways("127.0.0.1", first).open())


def test_units_must_be_known(plane):
    camera = NoiseCamera(StepperSource(plane, KINDS["moons"], SEED, "noise", "").bus.array, 1.0)
    with pytest.raises(InputError, match="calibrate steppers"):
        asyncio.run(open_hardware(plane, "gateways://127.0.0.1", camera).open())
    with pytest.raises(InputError, match="gateways://HOST"):
        open_hardware(plane, "cannet://127.0.0.1", camera)


@pytest.mark.parametrize("text", ["", ":4700", "host:0", "host:65535", "host:a"])
def test_addresses(text):
    with pytest.raises(InputError, match=r"first of 3 gateways .* with a port 1 to 65533"):
        gateway_address(text)
    assert gateway_address("host") == ("host", 4700)
    assert gateway_address("host:4800") == ("host", 4800)


def test_a_connection_that_ends_while_something_is_sent_is_told_by_silence():
    connection = KeptConnection("127.0.0.1", 1, lambda data: None)

    class Ended:
        """A writer whose connection has ended."""

        def write(self, data):
            pass

        async def drain(self):
            raise ConnectionResetError("reset by peer")

        def close(self):
            pass

    connection._writer = Ended()
    connection.link.comes_up(0.0)
    asyncio.run(connection.send(b"frame"))
    assert not connection.link.up
    assert connection.link.reason == "reset by peer"


def test_a_connection_comes_back_by_itself():
    heard = []

    async def echo(reader, writer):
        while data := await reader.read(100):
            writer.write(data)
            if data == b"end":
                break
        writer.close()

    async def scenario():
        server = await asyncio.start_server(echo, "127.0.0.1", 0)
        connection = KeptConnection(*server.sockets[0].getsockname()[:2], heard.append)
        assert await connection.connect()
        sock = connection._writer.get_extra_info("socket")
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)  # a host that vanished is noticed
        connection.keep()
        await connection.send(b"end")
        while connection.link.up:
            await asyncio.sleep(0.01)
        await connection.send(b"lost")
        while not connection.link.up:
            await asyncio.sleep(0.01)
        await connection.send(b"again")
        while len(heard) < 2:
            await asyncio.sleep(0.01)
        await connection.close()
        server.close()

    asyncio.run(asyncio.wait_for(scenario(), 20.0))
    assert heard == [b"end", b"again"]


def test_a_refusal_that_comes_while_it_is_closed_does_not_keep_it(monkeypatch):
    """The refusal eats the cancelling; nothing is left that would call again."""

    async def scenario():
        connection = KeptConnection("127.0.0.1", 1, lambda data: None)
        calls = []

        async def refused():
            calls.append(1)
            with suppress(asyncio.CancelledError):
                await asyncio.sleep(10.0)
            return False

        monkeypatch.setattr(connection, "connect", refused)
        connection.keep()
        while not calls:
            await asyncio.sleep(0.01)
        await asyncio.wait_for(connection.close(), 5.0)
        return len(calls)

    assert asyncio.run(scenario()) == 1
