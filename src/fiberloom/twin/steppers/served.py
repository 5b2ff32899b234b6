"""MOONS' units of the twin behind three gateways on TCP, in real time: what `TcpGateways` connects to."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import time
from typing import Any

import numpy as np

from fiberloom.drive.moons.frames import GATEWAYS
from fiberloom.errors import InputError
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.camera.exposing import Look
from fiberloom.twin.steppers.moons import MoonsBus

STEP_S = 0.02
"""So often the clock is put forward, while nothing is asked."""
READ_BYTES = 1 << 16


class GatewayServer:
    """Gateways at three ports in a row; of each one host at a time, the latest. Implements `Watched`."""

    def __init__(self, bus: MoonsBus, address: Address, faults: FaultClock, speed: float = 1.0) -> None:
        """`bus` of the units; `address` of the first gateway; `speed`: its seconds in one of ours."""
        self.bus, self.address, self._faults, self._speed = bus, address, faults, speed
        self._begun_s = time.monotonic()
        self._servers: list[asyncio.Server] = []
        self._hosts: dict[int, asyncio.StreamWriter] = {}
        self._clock: asyncio.Task[None] | None = None
        self.traffic = {"clients": 0, "bytes_in": 0, "bytes_out": 0}

    async def open(self) -> None:
        """Listens, and starts the clock. InputError where a port is taken."""
        for gateway in range(GATEWAYS):
            port = self.address.port + gateway
            try:
                server = await asyncio.start_server(
                    functools.partial(self._client, gateway), self.address.host, port
                )
            except OSError as error:
                self.close()
                raise InputError(
                    f"--listen {self.address}: port {port}: {error.strerror or error}; choose another address"
                ) from None
            self._servers.append(server)
        self._begun_s = time.monotonic() - self.bus.time_s / self._speed
        self._clock = asyncio.create_task(self._tick())

    def close(self) -> None:
        """Hangs up and stops the clock."""
        for host in self._hosts.values():
            host.close()
        for server in self._servers:
            server.close()
        if self._clock is not None:
            self._clock.cancel()

    def report(self) -> dict[str, Any]:
        """What happened so far."""
        return self.traffic | {"time_s": self.bus.time_s, "contacts": self.bus.array.contacts()}

    def told(self, report: dict[str, Any]) -> str:
        """A `report` of this server as a line of text."""
        return (
            "{time_s:.1f} s of twin time: {clients} connections, {bytes_in} bytes in, {bytes_out} out; arms "
            "touched {contacts} times"
        ).format(**report)

    def look(self) -> Look:
        """What a camera sees now."""
        self._advance()
        array = self.bus.array
        return Look(self.bus.time_s, np.where(array.dark[:, None], np.nan, array.fibre_xy()))

    def faults(self) -> frozenset[str]:
        """Of the camera: none."""
        return frozenset()

    async def _client(self, gateway: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if (before := self._hosts.get(gateway)) is not None:
            before.close()
        self._hosts[gateway] = writer
        self.traffic["clients"] += 1
        with contextlib.suppress(OSError):
            while data := await reader.read(READ_BYTES):
                self._advance()
                self.traffic["bytes_in"] += len(data)
                self._say(self._faults.carried(self.bus.take(gateway, data)))
        writer.close()

    async def _tick(self) -> None:
        while True:
            self._advance()
            await asyncio.sleep(STEP_S)

    def _advance(self) -> None:
        """Brings the units to now, event by event."""
        now_s = (time.monotonic() - self._begun_s) * self._speed
        while (left_s := now_s - self.bus.time_s) > 1e-9:
            next_s = min(self._faults.next_s, self.bus.next_s) - self.bus.time_s
            said = self._faults.carried(self.bus.run(min(left_s, max(next_s, 1e-6))))
            self._faults.follow()
            self._say(said)

    def _say(self, words: list[tuple[int, bytes]]) -> None:
        for gateway, data in words:
            writer = self._hosts.get(gateway)
            if writer is not None and not writer.is_closing():
                writer.write(data)
                self.traffic["bytes_out"] += len(data)
