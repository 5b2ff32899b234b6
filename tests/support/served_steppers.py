"""A field of steppers observed over TCP: a served twin, and a host that knows its units from a bench."""

import asyncio
import os
import socket
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from fiberloom.drive.steppers.kept import save_units
from fiberloom.field import Field
from fiberloom.operation.outside.steppers import STEPPERS
from fiberloom.operation.results.observation import Observation
from fiberloom.targets.generate import random_targets
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.can_units import CanUnitsServer
from fiberloom.twin.steppers.kinds import KINDS
from fiberloom.twin.steppers.served import GatewayServer, RadioServer, RobotUnits
from fiberloom.twin.steppers.source import StepperSource

SEED, SPEED = 0, 10.0  # times real time: both ends and other tests share the cores
SERVERS = {
    "moons": GatewayServer,
    "lamost": RadioServer,
    "megara": lambda bus, *rest: CanUnitsServer(RobotUnits(bus), *rest),
}


# each worker of a test run begins elsewhere
_TRIPLES = iter(range(20000 + 3 * (os.getpid() % 1000), 60000, 3))


def free_ports():
    """The first of three in a row that nothing listens on, others at each call."""
    for first in _TRIPLES:
        with suppress(OSError):
            for port in range(first, first + 3):
                with closing(socket.socket()) as one:
                    one.bind(("127.0.0.1", port))
            return first
    raise AssertionError("no ports are free")


class Beside:
    """A camera beside the server's process, as in a real array."""

    def __init__(self, array, noise_um):
        self._camera = NoiseCamera(array, noise_um, SEED)

    def measure(self, expected_mm=None):
        return self._camera.measure(expected_mm)


@dataclass
class Served:
    """How a field over TCP went."""

    seen: Observation
    off_um: Any
    """(N,) fibres in truth from the goals of their units."""
    server: Any
    source: StepperSource

    @property
    def named(self):
        """Numbers with a fault, by status."""
        return self.seen.summary()["faults"]


def address_of(name, server):
    """As `--bus` has it."""
    prefix = STEPPERS[name].at or "cannet://"
    return f"{prefix}{server.address}"


async def hang_up_in_mid_move(server, bus):
    """Ends the connections of a server when arms unfold."""
    while not (bus.array.counts[:, 1] != 0).any():
        await asyncio.sleep(0.01)
    for door in range(getattr(server, "doors", 1)):
        server.hang_up(*([door] if hasattr(server, "doors") else []))


def observed(plane, folder, faults="", meanwhile=None, camera=None):
    """A field by TCP. `meanwhile(server, bus)`: a coroutine that runs beside it, e.g. to hang up."""
    name = plane.instrument.name
    source = StepperSource(plane, KINDS[name], SEED, "noise", faults)
    folder.mkdir(exist_ok=True)
    save_units(source.known, plane, folder / "units.npz")
    clock = FaultClock(source.bus, source.schedule, SEED)
    server = SERVERS[name](source.bus, Address("127.0.0.1", free_ports()), clock, SPEED)
    camera = camera or Beside(source.bus.array, plane.instrument.metrology.noise_rms_um)

    async def scenario():
        await server.open()
        kind = STEPPERS[name]
        address = address_of(name, server)
        opened = kind(plane, address.removeprefix(kind.at), camera, speed=SPEED)
        opened.know(folder / "units.npz")
        beside = asyncio.create_task(meanwhile(server, source.bus)) if meanwhile else None
        try:
            targets = random_targets(plane, 3 * len(plane), seed=1)
            return await Field(plane, opened, SEED).observe(targets, out=folder / "run")
        finally:
            if beside is not None:
                beside.cancel()
            server.close()

    seen = asyncio.run(scenario())
    goal_mm = plane.forward(seen.assignment.alpha_deg, seen.assignment.beta_deg)
    off_um = 1e3 * np.hypot(*(source.bus.array.fibre_xy() - goal_mm).T)
    return Served(seen, off_um, server, source)


@contextmanager
def observed_at_once(plane, folder, **fields):
    """Starts several fields, each by what `observed` takes: they wait for clocks, not for one another.

    Gives a function that waits for the field of a name and returns it.
    """
    with ThreadPoolExecutor(len(fields)) as pool:
        begun = {name: pool.submit(observed, plane, folder / name, **how) for name, how in fields.items()}
        yield lambda name: begun[name].result()


def loses_nothing(over_tcp, clients, within_um):
    """A field whose connections dropped in mid-move: so many came in all, and every fibre arrived."""
    assigned = over_tcp.seen.assignment.target >= 0
    assert over_tcp.server.report()["clients"] == clients
    assert over_tcp.named == {}
    assert over_tcp.off_um[assigned].max() < within_um
