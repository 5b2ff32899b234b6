"""The gateways of MOONS over TCP: three ports in a row, one gateway each."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from functools import partial

from fiberloom.bus.links import Link
from fiberloom.drive.kept_connection import KeptConnection, all_of
from fiberloom.drive.moons.frames import GATEWAYS, UnitPlace
from fiberloom.errors import InputError
from fiberloom.files import LAST_PORT, host_and_port

FIRST_PORT = 4700
"""Of the first gateway; the others follow (ukatc/fpu_driver)."""


def gateway_address(text: str) -> tuple[str, int]:
    """Host and first port of HOST or HOST:PORT; InputError for anything else."""
    return host_and_port(text, f"first of {GATEWAYS} gateways", FIRST_PORT, LAST_PORT - GATEWAYS + 1)


class TcpGateways:
    """Implements `fiberloom.drive.moons.link.Gateways`, in real time or in that of a faster twin."""

    def __init__(self, host: str, first_port: int = FIRST_PORT, speed: float = 1.0) -> None:
        """`host` and `first_port` of the gateways; `speed`: seconds of their clock in one of ours."""
        self._host, self._port, self._speed = host, first_port, speed
        self._said: asyncio.Queue[tuple[int, bytes]] = asyncio.Queue()
        self._connections = [
            KeptConnection(host, first_port + gateway, partial(self._take, gateway))
            for gateway in range(GATEWAYS)
        ]

    def _take(self, gateway: int, data: bytes) -> None:
        self._said.put_nowait((gateway, data))

    async def open(self) -> None:
        """Connects; a gateway without power is called again and again. InputError where none answers."""
        there = [await connection.connect() for connection in self._connections]
        if not any(there):
            why = self._connections[0].link.reason
            ports = f"{self._port} to {self._port + GATEWAYS - 1}"
            raise InputError(
                f"gateways {self._host}:{ports}: no connection ({why}); look at address, power and network"
            )
        for connection in self._connections:
            connection.keep()

    @property
    def links(self) -> Sequence[Link]:
        """One for each gateway."""
        return [connection.link for connection in self._connections]

    def link_of(self, positioner: int) -> Link:
        """That of the gateway of a unit."""
        return self._connections[UnitPlace.of(positioner).gateway].link

    @property
    def time_s(self) -> float:
        """Monotonic."""
        return time.monotonic() * self._speed

    async def send(self, gateway: int, data: bytes) -> None:
        """Bytes to a gateway; lost where there is no connection to it."""
        await self._connections[gateway].send(data)

    async def receive(self, timeout_s: float) -> list[tuple[int, bytes]]:
        """What gateways have said; waits up to `timeout_s` of their time for anything."""
        return await all_of(self._said, timeout_s / self._speed)

    async def close(self) -> None:
        """Lets go. Closing twice does no harm."""
        for connection in self._connections:
            await connection.close()
