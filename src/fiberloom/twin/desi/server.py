"""DESI's twin behind a CAN@net device on TCP, in real time: what `CanNetTransport` connects to.

One device with four ports; positioners are shared out over them. Frames go over at once: the device's queue
and the wire's rate are not modelled.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Iterable
from typing import Any

import numpy as np

from fiberloom.bus.cannet import frame_to_line
from fiberloom.bus.transport import Frame
from fiberloom.drive.desi.frames import DesiFrame
from fiberloom.errors import InputError
from fiberloom.twin.desi.array import DesiTwin
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.faults.schedule import ScheduledFault
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.camera.exposing import Look
from fiberloom.twin.server.device import PORTS, Device, Port
from fiberloom.twin.server.told import counts_text

STEP_S = 0.02
"""So often the clock is put forward, while nothing is asked."""
READ_BYTES = 1 << 16


class DesiServer:
    """Serves a twin until `close`; one host at a time, a second one is hung up on."""

    def __init__(
        self,
        twin: DesiTwin,
        address: Address,
        *,
        schedule: Iterable[ScheduledFault] = (),
        speed: float = 1.0,
        seed: int = 0,
    ) -> None:
        """`schedule`: faults that begin and end in the twin's time; `speed`: its seconds in one of ours;
        `seed`: of replies that are lost.
        """
        self.twin, self.address, self._speed = twin, address, speed
        self.device = Device(self._on_frame, lambda: twin.time_s)
        shares = np.array_split(twin.plane.positioner_id, len(PORTS))
        self._port_of = {int(i): port for port, share in zip(PORTS, shares, strict=True) for i in share}
        self._faults = FaultClock(twin, schedule, seed)
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
        self._begun_s = time.monotonic() - self.twin.time_s / self._speed
        self._clock = asyncio.create_task(self._tick())

    def close(self) -> None:
        """Hangs up and stops the clock."""
        for closing in (self._host, self._server):
            if closing is not None:
                closing.close()
        if self._clock is not None:
            self._clock.cancel()

    def report(self) -> dict[str, Any]:
        """Time and traffic so far."""
        return {"time_s": self.twin.time_s, **self.traffic, "contacts": self.twin.contacts()}

    def told(self, report: dict[str, Any]) -> str:
        """A `report` of this server as a line of text."""
        return counts_text(report)

    def look(self) -> Look:
        """What a camera sees now."""
        self._forward()
        lit_mm = np.where(self.twin.dark[:, None], np.nan, self.twin.fibre_xy())
        return Look(self.twin.time_s, lit_mm)

    def faults(self) -> frozenset[str]:
        """Of the camera: none."""
        return frozenset()

    async def _tick(self) -> None:
        while True:
            self._forward()
            await asyncio.sleep(STEP_S)

    def _forward(self) -> None:
        """Puts the twin's clock to now."""
        late_s = (time.monotonic() - self._begun_s) * self._speed - self.twin.time_s
        if late_s > 0.0:
            self.twin.run(late_s)
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
        """A frame from the host. A broadcast comes by every port, and is heard by all once and again."""
        self.traffic["frames_in"] += 1
        for reply in self._faults.carried(self.twin.send([(frame.id, frame.data)])):
            self._answer(reply)

    def _answer(self, reply: DesiFrame) -> None:
        port = self.device.ports[self._port_of[reply.can_id]]
        if port.running and port.passes(reply.identifier):
            self.traffic["frames_out"] += 1
            self._say(frame_to_line(port.number, Frame(reply.identifier, reply.data)))
