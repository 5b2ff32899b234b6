"""A TCP connection that is made again by itself where it ends."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from typing import TypeVar

from fiberloom.bus.links import Link, notice_silence, retries_s

CONNECT_S = 3.0
READ_BYTES = 1 << 16

Said = TypeVar("Said")


async def all_of(queue: asyncio.Queue[Said], wait_s: float) -> list[Said]:
    """All that is in a `queue`; waits up to `wait_s` for anything."""
    try:
        found = [await asyncio.wait_for(queue.get(), max(wait_s, 0.0))]
    except TimeoutError:
        return []
    while not queue.empty():
        found.append(queue.get_nowait())
    return found


class KeptConnection:
    """One connection; what is sent while there is none is lost: a command that comes late is worse than none.

    `host` and `port`: whom it calls; `take`: gets the bytes that come; `begin`: called at each new
    connection, for half a message of the last one has no end.
    """

    def __init__(
        self,
        host: str,
        port: int,
        take: Callable[[bytes], None],
        begin: Callable[[], None] = lambda: None,
    ) -> None:
        self.link = Link(f"{host}:{port}", up=False, since_s=time.monotonic())
        self._address, self._take, self._begin = (host, port), take, begin
        self._writer: asyncio.StreamWriter | None = None
        self._reader: asyncio.StreamReader | None = None
        self._task: asyncio.Task[None] | None = None
        self._closed = False

    async def connect(self) -> bool:
        """Tries once, for `CONNECT_S` at most; whether it is connected. Else `link.reason` says why not."""
        try:
            reader, writer = await asyncio.wait_for(asyncio.open_connection(*self._address), CONNECT_S)
            notice_silence(writer)
        except (TimeoutError, OSError, UnicodeError) as error:  # the last of a name that can be none
            self.link.reason = str(error) or "timed out"
            return False
        self._begin()
        self._reader, self._writer = reader, writer
        self.link.comes_up(time.monotonic())
        return True

    def keep(self) -> None:
        """From now on it is read, and made again whenever there is none."""
        self._task = asyncio.create_task(self._kept())

    async def _kept(self) -> None:
        while not self._closed:
            if self.link.up:
                self._ends(await self._read())
            for wait_s in retries_s():
                await asyncio.sleep(wait_s)
                # a refusal that comes as it is cancelled eats that (`asyncio.wait_for` of Python 3.11)
                if self._closed or await self.connect() or self._closed:
                    break

    async def _read(self) -> str:
        """Hands on what comes until the connection ends; why it ended."""
        assert self._reader is not None
        try:
            while data := await self._reader.read(READ_BYTES):
                self._take(data)
        except OSError as error:
            return str(error) or type(error).__name__
        return "the other side has closed it"

    def _ends(self, reason: str) -> None:
        self.link.goes_down(reason, time.monotonic())
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    async def send(self, data: bytes) -> None:
        """Bytes, lost where there is no connection."""
        if (writer := self._writer) is None or not self.link.up:
            return
        try:
            writer.write(data)
            await writer.drain()
        except OSError as error:
            self.link.goes_down(str(error) or type(error).__name__, time.monotonic())
            writer.close()  # who reads it finds its end, and connects again

    async def close(self) -> None:
        """Lets go for good. Closing twice does no harm."""
        self._closed = True
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        if self._writer is not None:
            self._writer.close()
            with contextlib.suppress(OSError):
                await self._writer.wait_closed()
        self._writer = None
