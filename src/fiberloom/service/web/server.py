"""The server: uvicorn on one address. What moves is stopped when it is told to end."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import uvicorn
from fastapi import FastAPI

from fiberloom.blocking import STOPS
from fiberloom.errors import InputError
from fiberloom.service.array import Author, ServedArray

GRACE_S = 3
"""So long answers have that are under way when the service ends."""
MESSAGE_BYTES = 1 << 12
"""Of what a client may send on the stream: nothing is expected."""


@dataclass(frozen=True)
class Listening:
    """Where the service listens."""

    host: str
    port: int
    certificate: Path | None = None
    key: Path | None = None

    @property
    def scheme(self) -> str:
        """http or https."""
        return "http" if self.certificate is None else "https"

    @property
    def url(self) -> str:
        """To type into a browser."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}/"

    @classmethod
    def parse(cls, text: str) -> tuple[str, int]:
        """Host and port of HOST:PORT. InputError where it is none."""
        host, _, port = text.rpartition(":")
        host = host.removeprefix("[").removesuffix("]")
        if not (host and port.isascii() and port.isdigit() and 0 <= int(port) < 2**16):
            raise InputError(f"--listen {text}: give HOST:PORT, e.g. 127.0.0.1:8080")
        return host, int(port)

    def bound(self) -> socket.socket:
        """A socket that listens there. InputError where that is not possible."""
        family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        made = socket.socket(family, socket.SOCK_STREAM)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            made.bind((self.host, self.port))
        except OSError as error:
            made.close()
            raise InputError(f"--listen {self.host}:{self.port}: {error.strerror or error}") from None
        return made


class _ArrayServer(uvicorn.Server):
    """Stops the array first, then itself."""

    def __init__(self, config: uvicorn.Config, on_end: Callable[[], object]) -> None:
        super().__init__(config)
        self._on_end = on_end

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Signals end the server, and this process goes on: the first one stops what moves, at once."""
        loop = asyncio.get_running_loop()
        for number in STOPS:
            loop.add_signal_handler(number, self.handle_exit, number, None)
        try:
            yield
        finally:
            for number in STOPS:
                loop.remove_signal_handler(number)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Of a signal `sig` at a `frame`: positioners stop at once, answers end afterwards."""
        self._on_end()
        super().handle_exit(sig, frame)


def serve(
    app: FastAPI, array: ServedArray, at: Listening, sock: socket.socket, begin: Callable[[], object]
) -> None:
    """Serves until a signal comes. Everything is at rest when it returns.

    `app`: of the `array`; `at`: where; `sock`: bound there; `begin`: begins to serve the array.
    """
    config = uvicorn.Config(
        app,
        ws="websockets-sansio",
        ws_max_size=MESSAGE_BYTES,
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=GRACE_S,
        ssl_certfile=at.certificate,
        ssl_keyfile=at.key,
    )
    server = _ArrayServer(config, lambda: array.stop_own(Author("the end of the service", "engineer")))
    try:
        begin()
        server.run([sock])
    finally:
        array.close()
