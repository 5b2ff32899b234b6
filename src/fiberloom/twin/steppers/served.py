"""Steppers of the twin on TCP, in real time: MOONS' gateways, MEGARA's buses, LAMOST's coordinators."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from fiberloom.bus.transport import Frame
from fiberloom.drive.lamost import RadioReader, decoded
from fiberloom.drive.lamost.radio import packet_of
from fiberloom.drive.megara.frames import robot_of
from fiberloom.drive.moons.frames import GATEWAYS
from fiberloom.errors import InputError
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.camera.exposing import Look
from fiberloom.twin.server.can_units import READ_BYTES, STEP_S
from fiberloom.twin.server.device import PORTS
from fiberloom.twin.steppers.bus import StepperBus
from fiberloom.twin.steppers.megara import MegaraBus, bus_of
from fiberloom.twin.steppers.moons import MoonsBus

Words = list[tuple[int, bytes]]
"""What is said, each by the number of its door."""


class _DoorServer:
    """Units behind ports in a row, its doors; at each the host that came last. Implements `Watched`."""

    doors = 1

    def __init__(self, bus: StepperBus, address: Address, faults: FaultClock, speed: float = 1.0) -> None:
        """`bus` of the units; `address` of the first door; `speed`: its seconds in one of ours."""
        self.address, self._faults, self._speed = address, faults, speed
        self._units = bus
        self._begun_s = time.monotonic()
        self._servers: list[asyncio.Server] = []
        self._hosts: dict[int, asyncio.StreamWriter] = {}
        self._clock: asyncio.Task[None] | None = None
        self.traffic = {"clients": 0, "bytes_in": 0, "bytes_out": 0}

    def forget(self, door: int) -> None:
        """A host comes to a door: half a word of the one before it is none."""

    def hear(self, door: int, data: bytes) -> Words:
        """Bytes of a host at a door; what is said at once."""
        raise NotImplementedError

    def run(self, duration_s: float) -> Words:
        """Lets time pass, s, up to the next event at most; what units say unasked."""
        raise NotImplementedError

    async def open(self) -> None:
        """Listens, and starts the clock. InputError where a port is taken."""
        for door in range(self.doors):
            port = self.address.port + door
            try:
                server = await asyncio.start_server(
                    functools.partial(self._client, door), self.address.host, port
                )
            except OSError as error:
                self.close()
                raise InputError(
                    f"--listen {self.address}: port {port}: {error.strerror or error}; choose another address"
                ) from None
            self._servers.append(server)
        self._begun_s = time.monotonic() - self._units.time_s / self._speed
        self._clock = asyncio.create_task(self._tick())

    def close(self) -> None:
        """Hangs up and stops the clock."""
        for door in range(self.doors):
            self.hang_up(door)
        for server in self._servers:
            server.close()
        if self._clock is not None:
            self._clock.cancel()

    def hang_up(self, door: int = 0) -> None:
        """Ends the connection at a `door`; its host may come again."""
        if (host := self._hosts.pop(door, None)) is not None:
            host.close()

    def report(self) -> dict[str, Any]:
        """What happened so far."""
        return self.traffic | {"time_s": self._units.time_s, "contacts": self._units.array.contacts()}

    def told(self, report: dict[str, Any]) -> str:
        """A `report` of this server as a line of text."""
        return (
            "{time_s:.1f} s of twin time: {clients} connections, {bytes_in} bytes in, {bytes_out} out; arms "
            "touched {contacts} times"
        ).format(**report)

    def look(self) -> Look:
        """What a camera sees now."""
        self._advance()
        return _look(self._units)

    def faults(self) -> frozenset[str]:
        """Of the camera: none."""
        return frozenset()

    async def _client(self, door: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.hang_up(door)
        self.forget(door)
        self._hosts[door] = writer
        self.traffic["clients"] += 1
        with contextlib.suppress(OSError, asyncio.CancelledError):  # cancelled where the loop ends
            while data := await reader.read(READ_BYTES):
                self._advance()
                self.traffic["bytes_in"] += len(data)
                self._say(self._faults.carried(self.hear(door, data)))
        writer.close()

    async def _tick(self) -> None:
        while True:
            self._advance()
            await asyncio.sleep(STEP_S)

    def _advance(self) -> None:
        """Brings the units to now, event by event."""
        now_s = (time.monotonic() - self._begun_s) * self._speed
        while (left_s := now_s - self._units.time_s) > 1e-9:
            next_s = min(self._faults.next_s, self._units.next_s) - self._units.time_s
            said = self._faults.carried(self.run(min(left_s, max(next_s, 1e-6))))
            self._faults.follow()
            self._say(said)

    def _say(self, words: Words) -> None:
        for door, data in words:
            writer = self._hosts.get(door)
            if writer is not None and not writer.is_closing():
                writer.write(data)
                self.traffic["bytes_out"] += len(data)


class GatewayServer(_DoorServer):
    """MOONS' three gateways: what `TcpGateways` connects to."""

    doors = GATEWAYS

    def __init__(self, bus: MoonsBus, address: Address, faults: FaultClock, speed: float = 1.0) -> None:
        super().__init__(bus, address, faults, speed)
        self.bus = bus

    def hear(self, door: int, data: bytes) -> Words:
        """Bytes of a host to a gateway."""
        return self.bus.take(door, data)

    def run(self, duration_s: float) -> Words:
        """Lets time pass, s."""
        return self.bus.run(duration_s)


class RadioServer(_DoorServer):
    """LAMOST's coordinators behind one port: what `TcpRadio` connects to."""

    def __init__(self, bus: MegaraBus, address: Address, faults: FaultClock, speed: float = 1.0) -> None:
        super().__init__(bus, address, faults, speed)
        self.bus = bus
        self._reader = RadioReader()

    def forget(self, door: int) -> None:
        """Half a packet."""
        self._reader = RadioReader()

    def hear(self, door: int, data: bytes) -> Words:
        """Packets of a host."""
        packets = map(decoded, self._reader.feed(data))
        replies = self.bus.send((packet.identifier, packet.message) for packet in packets)
        return [(door, packet_of(reply.identifier, reply.data)) for reply in replies]

    def run(self, duration_s: float) -> Words:
        """Lets time pass, s. No unit speaks unasked."""
        self.bus.run(duration_s)
        return []


class RobotUnits:
    """MEGARA's robots at the four ports of a CAN@net device. Implements `CanUnits`."""

    def __init__(self, bus: MegaraBus) -> None:
        self._bus = bus
        self.port_of: Mapping[int, int] = {number: PORTS[bus_of(number)] for number in bus.row_of}

    @property
    def time_s(self) -> float:
        """Of the twin."""
        return self._bus.time_s

    def run(self, duration_s: float) -> None:
        """Lets time pass, s."""
        self._bus.run(duration_s)

    def hear(self, port: int, frame: Frame) -> list[tuple[int, Frame]]:
        """A `frame` on a `port`, heard by the robots there alone; their replies."""
        whom, rotor = robot_of(frame.id), frame.id & 3
        here = [number for number, at in self.port_of.items() if at == port and whom in (0, number)]
        replies = self._bus.send((number << 2 | rotor, frame.data) for number in here)
        return [(reply.robot, Frame(reply.identifier, reply.data)) for reply in replies]

    def look(self) -> Look:
        """Fibres that are lit."""
        return _look(self._bus)

    def contacts(self) -> int:
        """So far."""
        return self._bus.array.contacts()


def _look(bus: StepperBus) -> Look:
    array = bus.array
    return Look(bus.time_s, np.where(array.dark[:, None], np.nan, array.fibre_xy()))
