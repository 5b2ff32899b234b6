"""Units of a twin behind a CAN@net device on TCP, in real time: what `CanNetTransport` connects to.

One device with four ports; units hang at them. Frames go over at once: the device's queue and the wire's rate
are not modelled.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Iterable, Mapping
from typing import Any, Protocol

from fiberloom.bus.cannet import frame_to_line
from fiberloom.bus.transport import Frame
from fiberloom.errors import InputError
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.camera.exposing import Look
from fiberloom.twin.server.device import Device, Port
from fiberloom.twin.server.told import counts_text

STEP_S = 0.02
"""So often the clock is put forward, while nothing is asked."""
READ_BYTES = 1 << 16


class CanUnits(Protocol):
    """Units on the buses of the device, and what a camera and a report ask of them."""

    port_of: Mapping[int, int]
    """Port of the device at which each unit hangs, by its number."""

    @property
    def time_s(self) -> float:
        """Of the twin."""
        ...

    def run(self, duration_s: float) -> None:
        """Lets time pass, s."""
        ...

    def hear(self, port: int, frame: Frame) -> list[tuple[int, Frame]]:
        """A frame from the host on a port; the replies, each with the number of its unit."""
        ...

    def look(self) -> Look:
        """What a camera sees now."""
        ...

    def contacts(self) -> int:
        """How often arms have touched."""
        ...


class CanUnitsServer:
    """Serves units until `close`; one host at a time, a second one is hung up on. Implements `Watched`."""

    def __init__(self, units: CanUnits, address: Address, faults: FaultClock, speed: float = 1.0) -> None:
        """`address` of the device; `faults` of the same units; `speed`: seconds of theirs in one of ours."""
        self.units, self.address, self._faults, self._speed = units, address, faults, speed
        self.device = Device(self._on_frame, lambda: units.time_s)
        self._begun_s = time.monotonic()
        self._server: asyncio.Server | None = None
        self._clock: asyncio.Task[None] | None = None
        self._host: asyncio.StreamWriter | None = None
        self.traffic = {"clients": 0, "frames_in": 0, "frames_out": 0, "refused_clients": 0}

    async def open(self) -> None:
        """Listens, and starts the clock. InputError where the address is taken."""
        try:
            self._server = await asyncio.start_server(self._client, self.address.host, self.address.port)
        except OSError as error:
            raise InputError(
                f"--listen {self.address}: {error.strerror or error}; choose another address"
            ) from None
        self.address = Address(self.address.host, self._server.sockets[0].getsockname()[1])
        self._begun_s = time.monotonic() - self.units.time_s / self._speed
        self._clock = asyncio.create_task(self._tick())

    def close(self) -> None:
        """Hangs up and stops the clock."""
        self.hang_up()
        if self._server is not None:
            self._server.close()
        if self._clock is not None:
            self._clock.cancel()

    def hang_up(self) -> None:
        """Ends the connection of the host; it may come again."""
        if self._host is not None:
            self._host.close()

    def report(self) -> dict[str, Any]:
        """Time and traffic so far."""
        return {"time_s": self.units.time_s, **self.traffic, "contacts": self.units.contacts()}

    def told(self, report: dict[str, Any]) -> str:
        """A `report` of this server as a line of text."""
        return counts_text(report)

    def look(self) -> Look:
        """What a camera sees now."""
        self._forward()
        return self.units.look()

    def faults(self) -> frozenset[str]:
        """Of the camera: none."""
        return frozenset()

    async def _tick(self) -> None:
        while True:
            self._forward()
            await asyncio.sleep(STEP_S)

    def _forward(self) -> None:
        """Puts the clock of the units to now, with a stop at each fault that begins or ends."""
        now_s = (time.monotonic() - self._begun_s) * self._speed
        while (left_s := now_s - self.units.time_s) > 1e-9:
            self.units.run(min(left_s, max(self._faults.next_s - self.units.time_s, 1e-6)))
            self._faults.follow()

    async def _client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._host is not None:
            self.traffic["refused_clients"] += 1
            writer.close()
            return
        self._host = writer
        self.traffic["clients"] += 1
        self.device.say = self._say
        with contextlib.suppress(OSError, asyncio.CancelledError):  # cancelled where the loop ends
            while data := await reader.read(READ_BYTES):
                self._forward()
                self.device.take(data)
                await writer.drain()
        self.device.restart()
        self._host = None
        writer.close()

    def _say(self, line: str) -> None:
        if self._host is not None:
            self._host.write(line.encode("ascii") + b"\n")

    def _on_frame(self, port: Port, frame: Frame) -> None:
        self.traffic["frames_in"] += 1
        for number, reply in self._faults.carried(self.units.hear(port.number, frame)):
            self._answer(self.device.ports[self.units.port_of[number]], reply)

    def _answer(self, port: Port, reply: Frame) -> None:
        if port.running and port.passes(reply.id):
            self.traffic["frames_out"] += 1
            self._say(frame_to_line(port.number, reply))


def shared_out(numbers: Iterable[int], ports: Iterable[int]) -> dict[int, int]:
    """Units by `numbers`, in equal parts one after the other at `ports`."""
    import numpy as np

    every = list(ports)
    shares = np.array_split(np.array(list(numbers), dtype=np.int64), len(every))
    return {int(number): port for port, share in zip(every, shares, strict=True) for number in share}
