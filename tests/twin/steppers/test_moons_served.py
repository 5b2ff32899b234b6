"""MOONS over TCP: a whole observation through three ports, and what is told where there is none."""

import asyncio
import os
import socket
from contextlib import closing, suppress

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.connect import open_hardware
from fiberloom.drive.moons.tcp import TcpGateways, gateway_address
from fiberloom.drive.steppers.kept import save_units
from fiberloom.errors import InputError
from fiberloom.field import Field
from fiberloom.operation.source import OpenedMoons
from fiberloom.targets.generate import random_targets
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.server.address import Address
from fiberloom.twin.steppers.kinds import KINDS
from fiberloom.twin.steppers.served import GatewayServer
from fiberloom.twin.steppers.source import StepperSource

N, SEED, SPEED = 7, 0, 15.0


def free_ports():
    """The first of three in a row that nothing listens on."""
    # each worker of a test run begins elsewhere
    for first in range(20000 + 3 * (os.getpid() % 1000), 60000, 3):
        with suppress(OSError):
            for port in range(first, first + 3):
                with closing(socket.socket()) as one:
                    one.bind(("127.0.0.1", port))
            return first
    raise AssertionError("no ports are free")


class Scored:
    """The camera that scores, beside the server's process in a real array."""

    def __init__(self, server):
        self._camera = NoiseCamera(server.bus.array, 1.0, SEED)

    def measure(self, expected_mm=None):
        return self._camera.measure(expected_mm)


@pytest.fixture(scope="module")
def plane():
    return fl.FocalPlane.of("moons", seed=SEED, n=N)


def observed(plane, folder, faults=""):
    """Summary of a field by TCP, the true errors in um of those with a target, and the server."""
    source = StepperSource(plane, KINDS["moons"], SEED, "noise", faults)
    save_units(source.known, plane, folder / "units.npz")
    clock = FaultClock(source.bus, source.schedule, SEED)
    server = GatewayServer(source.bus, Address("127.0.0.1", free_ports()), clock, SPEED)
    opened = OpenedMoons(plane, str(server.address), Scored(server), speed=SPEED)
    opened.know(folder / "units.npz")

    async def scenario():
        await server.open()
        try:
            field = Field(plane, opened, SEED)
            return await field.observe(random_targets(plane, 3 * N, seed=1), out=folder / "run")
        finally:
            server.close()

    seen = asyncio.run(scenario())
    goal_mm = plane.forward(seen.assignment.alpha_deg, seen.assignment.beta_deg)
    off_um = 1e3 * np.hypot(*(server.bus.array.fibre_xy() - goal_mm).T)
    return seen, off_um, server


def test_a_whole_field_is_observed_over_tcp(plane, tmp_path):
    seen, off_um, server = observed(plane, tmp_path)
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
    seen, off_um, _ = observed(plane, tmp_path, "deaf=1")
    (deaf,) = seen.summary()["faults"]["dead"]
    blocked = seen.summary()["faults"].get("blocked", [])
    others = (seen.assignment.target >= 0) & ~np.isin(plane.positioner_id, [deaf, *blocked])
    assert others.sum() >= 2
    assert np.median(off_um[others]) < 10.0
    assert off_um[others].max() < 30.0  # 20 um is what one in a thousand is beyond


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
    with pytest.raises(InputError, match="the first of 3 ports"):
        gateway_address(text)
    assert gateway_address("host") == ("host", 4700)
    assert gateway_address("host:4800") == ("host", 4800)


def test_a_connection_that_ends_while_something_is_sent_is_told_by_silence():
    gateways = TcpGateways("127.0.0.1")

    class Ended:
        """A writer whose connection the reader finds ended first."""

        def write(self, data):
            gateways._writers.pop(0)

        async def drain(self):
            raise ConnectionResetError("reset by peer")

    gateways._writers[0] = Ended()
    asyncio.run(gateways.send(0, b"frame"))
    assert gateways._writers == {}
