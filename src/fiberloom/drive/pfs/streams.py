"""Bytes to and from the FPGA: the contract, and TCP."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from typing import Protocol

from fiberloom.drive.pfs.frames import TCP_PORT
from fiberloom.files import host_and_port


class StreamLost(ConnectionError):
    """The connection is gone."""


class Stream(Protocol):
    """A connection to the FPGA. Its clock may be virtual."""

    @property
    def time_s(self) -> float:
        """Never runs backwards."""
        ...

    async def write(self, data: bytes) -> None:
        """Sends bytes; StreamLost where there is none."""
        ...

    async def read(self, size: int, timeout_s: float) -> bytes:
        """Exactly `size` bytes; TimeoutError where they do not come in time, else StreamLost."""
        ...

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, s."""
        ...

    async def close(self) -> None:
        """Lets go. Closing twice does no harm."""
        ...


Connect = Callable[[], Awaitable[Stream]]
"""Makes a new connection; StreamLost where none listens."""


class TcpStream:
    """A connection over TCP, in real time."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer

    @classmethod
    async def open(cls, host: str, port: int, timeout_s: float = 3.0) -> TcpStream:
        """Connects within `timeout_s`."""
        try:
            return cls(*await asyncio.wait_for(asyncio.open_connection(host, port), timeout_s))
        except (TimeoutError, OSError, UnicodeError) as error:  # the last of a name that can be none
            raise StreamLost(f"FPGA {host}:{port}: no connection ({error or 'timed out'})") from None

    @property
    def time_s(self) -> float:
        """Monotonic."""
        return time.monotonic()

    async def write(self, data: bytes) -> None:
        """Sends bytes."""
        try:
            self._writer.write(data)
            await self._writer.drain()
        except OSError as error:
            raise StreamLost(f"FPGA: {error}") from None

    async def read(self, size: int, timeout_s: float) -> bytes:
        """Exactly `size` bytes within `timeout_s`."""
        try:
            return await asyncio.wait_for(self._reader.readexactly(size), max(timeout_s, 0.0))
        except asyncio.IncompleteReadError:
            raise StreamLost("FPGA: the connection was closed") from None
        except TimeoutError:
            raise
        except OSError as error:
            raise StreamLost(f"FPGA: {error}") from None

    async def sleep(self, duration_s: float) -> None:
        """Waits for so many s."""
        await asyncio.sleep(duration_s)

    async def close(self) -> None:
        """Closes the connection."""
        self._writer.close()
        with contextlib.suppress(OSError):
            await self._writer.wait_closed()


def tcp_address(text: str) -> tuple[str, int]:
    """Host and port of HOST or HOST:PORT."""
    return host_and_port(text, "FPGA", TCP_PORT)


def over_tcp(host: str, port: int = TCP_PORT) -> Connect:
    """Connects to an FPGA at an address, each time anew."""

    async def connect() -> Stream:
        return await TcpStream.open(host, port)

    return connect
