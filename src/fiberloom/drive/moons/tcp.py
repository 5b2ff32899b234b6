"""The gateways of MOONS over TCP: three ports in a row, one gateway each."""

from __future__ import annotations

import asyncio
import contextlib
import time

from fiberloom.drive.moons.frames import GATEWAYS
from fiberloom.errors import InputError

FIRST_PORT = 4700
"""Of the first gateway; the others follow (ukatc/fpu_driver)."""
CONNECT_S = 3.0
READ_BYTES = 1 << 16


def gateway_address(text: str) -> tuple[str, int]:
    """Host and first port of HOST or HOST:PORT; InputError for anything else."""
    host, _, port = text.partition(":")
    last = 65535 - GATEWAYS + 1
    if not host or (port and not (port.isdigit() and 0 < int(port) <= last)):
        raise InputError(f"gateways '{text}': expected HOST or HOST:PORT, the first of {GATEWAYS} ports")
    return host, int(port) if port else FIRST_PORT


class TcpGateways:
    """Implements `fiberloom.drive.moons.link.Gateways`, in real time or in that of a faster twin."""

    def __init__(self, host: str, first_port: int = FIRST_PORT, speed: float = 1.0) -> None:
        """`host` and `first_port` of the gateways; `speed`: seconds of their clock in one of ours."""
        self._host, self._port, self._speed = host, first_port, speed
        self._writers: dict[int, asyncio.StreamWriter] = {}
        self._readers: list[asyncio.Task[None]] = []
        self._said: asyncio.Queue[tuple[int, bytes]] = asyncio.Queue()

    async def open(self) -> None:
        """Connects; a gateway without power is left out. InputError where none answers."""
        why = "no gateway there"
        for gateway in range(GATEWAYS):
            try:
                reader, writer = await asyncio.wait_for(
                    asyncio.open_connection(self._host, self._port + gateway), CONNECT_S
                )
            except (TimeoutError, OSError) as error:
                why = str(error) or "timed out"
                continue
            self._writers[gateway] = writer
            self._readers.append(asyncio.create_task(self._read(gateway, reader)))
        if not self._writers:
            ports = f"{self._port} to {self._port + GATEWAYS - 1}"
            raise InputError(
                f"gateways {self._host}:{ports}: no connection ({why}); look at address, power and network"
            )

    @property
    def time_s(self) -> float:
        """Monotonic."""
        return time.monotonic() * self._speed

    async def send(self, gateway: int, data: bytes) -> None:
        """Bytes to a gateway; lost where there is no connection to it."""
        writer = self._writers.get(gateway)
        if writer is None:
            return
        try:
            writer.write(data)
            await writer.drain()
        except OSError:
            self._writers.pop(gateway, None)  # who reads may have noticed first

    async def receive(self, timeout_s: float) -> list[tuple[int, bytes]]:
        """What gateways have said; waits up to `timeout_s` of their time for anything."""
        try:
            found = [await asyncio.wait_for(self._said.get(), max(timeout_s, 0.0) / self._speed)]
        except TimeoutError:
            return []
        while not self._said.empty():
            found.append(self._said.get_nowait())
        return found

    async def close(self) -> None:
        """Lets go. Closing twice does no harm."""
        for task in self._readers:
            task.cancel()
        for writer in self._writers.values():
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()
        self._writers, self._readers = {}, []

    async def _read(self, gateway: int, reader: asyncio.StreamReader) -> None:
        """Until the connection ends; what is sent after that is lost."""
        with contextlib.suppress(OSError):
            while data := await reader.read(READ_BYTES):
                self._said.put_nowait((gateway, data))
        self._writers.pop(gateway, None)
