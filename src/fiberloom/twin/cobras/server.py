"""Boards of the twin on a TCP port, in real time: what cobraCharmer's client and ours connect to."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress

from fiberloom.drive.pfs.frames import TCP_PORT
from fiberloom.errors import InputError
from fiberloom.twin.cobras.array import CobraArray
from fiberloom.twin.cobras.boards import QUIET_S, Answer, Boards


class BoardServer:
    """One FPGA on TCP; one client at a time, the latest (as the FPGA answers its latest connection)."""

    def __init__(self, array: CobraArray, unpowered: set[int] | None = None, speed: float = 1.0) -> None:
        """`array`: the cobras; `unpowered`: boards without power; `speed`: ratio of its clock to ours."""
        self._begun_s, self._speed = time.monotonic(), speed
        self.boards = Boards(array, self.now_s, unpowered or set())
        self._server: asyncio.Server | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    def now_s(self) -> float:
        """Since it was made, by its own clock."""
        return (time.monotonic() - self._begun_s) * self._speed

    async def listen(self, host: str = "127.0.0.1", port: int = TCP_PORT) -> int:
        """Opens the port, 0 for any free one; returns it."""
        try:
            self._server = await asyncio.start_server(self._client, host, port)
        except OSError as error:
            raise InputError(f"cannot listen on {host}:{port}: {error}; take another port") from None
        found: int = self._server.sockets[0].getsockname()[1]
        return found

    async def cut(self) -> None:
        """The connection drops; motors that run go on."""
        if self._writer is not None:
            self._writer.close()

    async def close(self) -> None:
        """Ends everything."""
        self.shut()
        if self._server is not None:
            await self._server.wait_closed()

    def shut(self) -> None:
        """Ends everything, and does not wait for it."""
        for task in self._tasks:
            task.cancel()
        if self._writer is not None:
            self._writer.close()
        if self._server is not None:
            self._server.close()

    async def _client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await self.cut()
        self._writer = writer
        self.boards.connected()
        with suppress(OSError):
            await self._serve(reader, writer)
        writer.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            try:
                data = await asyncio.wait_for(reader.read(1 << 16), QUIET_S / self._speed)
            except TimeoutError:
                self._send_all(writer, self.boards.quiet())
                continue
            if not data:
                return
            self._send_all(writer, self.boards.take(data))

    def _send_all(self, writer: asyncio.StreamWriter, answers: list[Answer]) -> None:
        for answer in answers:
            task = asyncio.create_task(self._send(writer, answer))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _send(self, writer: asyncio.StreamWriter, answer: Answer) -> None:
        await asyncio.sleep(max(answer.at_s - self.now_s(), 0.0) / self._speed)
        with suppress(OSError):
            writer.write(answer.data)
