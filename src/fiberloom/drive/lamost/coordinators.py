"""LAMOST's coordinators over TCP: packets one after the other on one connection. [A] Nothing is public."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence

from fiberloom.bus.links import Link
from fiberloom.drive.kept_connection import KeptConnection, all_of
from fiberloom.drive.lamost.packets import RadioReader
from fiberloom.errors import InputError
from fiberloom.files import host_and_port

RADIO_PORT = 4900
"""[A]."""


def radio_address(text: str) -> tuple[str, int]:
    """Host and port of HOST or HOST:PORT; InputError for anything else."""
    return host_and_port(text, "radio", RADIO_PORT)


class TcpRadio:
    """Implements `fiberloom.drive.lamost.radio.Radio`, in real time or in that of a faster twin."""

    def __init__(self, host: str, port: int = RADIO_PORT, speed: float = 1.0) -> None:
        """`host` and `port` of what speaks to the coordinators; `speed`: its seconds in one of ours."""
        self._speed, self._reader = speed, RadioReader()
        self._heard: asyncio.Queue[bytes] = asyncio.Queue()
        self._connection = KeptConnection(host, port, self._take, self._forget)

    def _forget(self) -> None:
        self._reader = RadioReader()

    def _take(self, data: bytes) -> None:
        for packet in self._reader.feed(data):
            self._heard.put_nowait(packet)

    async def open(self) -> None:
        """Connects. InputError where nothing answers."""
        if not await self._connection.connect():
            link = self._connection.link
            raise InputError(
                f"radio {link.name}: no connection ({link.reason}); look at address, power and network"
            )
        self._connection.keep()

    @property
    def links(self) -> Sequence[Link]:
        """The one connection."""
        return [self._connection.link]

    @property
    def time_s(self) -> float:
        """Monotonic."""
        return time.monotonic() * self._speed

    async def send(self, packets: Sequence[bytes]) -> None:
        """Packets, in order; lost where there is no connection."""
        await self._connection.send(b"".join(packets))

    async def receive(self, timeout_s: float) -> list[bytes]:
        """What was heard; waits up to `timeout_s` of their time for anything."""
        return await all_of(self._heard, timeout_s / self._speed)

    async def close(self) -> None:
        """Lets go. Closing twice does no harm."""
        await self._connection.close()
