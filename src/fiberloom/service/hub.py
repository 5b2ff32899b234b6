"""Events to many clients: a sequence number for each, a bounded queue for every client.

A client that is slow loses events; the gap in the numbers tells it to take a snapshot. Of pictures the oldest
one is dropped. A client that never reads costs its queue and nothing else.
"""

from __future__ import annotations

import asyncio
import json
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

MOST_EVENTS = 256
"""That wait for one client."""
MOST_CLIENTS = 64


class StreamClient:
    """One client: what it has not read yet. `offer` and `show` may be called from any thread."""

    def __init__(self) -> None:
        self._events: deque[str] = deque(maxlen=MOST_EVENTS)
        self._picture: bytes | None = None
        self._loop, self._news = asyncio.get_running_loop(), asyncio.Event()

    def offer(self, text: str) -> None:
        """An event; the oldest one goes where there are too many."""
        self._events.append(text)
        self._wake()

    def show(self, picture: bytes) -> None:
        """A picture, in place of one that was not read."""
        self._picture = picture
        self._wake()

    def _wake(self) -> None:
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._news.set)

    async def next(self) -> list[str | bytes]:
        """Waits for news, and takes all: events in order, then the last picture."""
        await self._news.wait()
        self._news.clear()
        found: list[str | bytes] = []
        while self._events:
            found.append(self._events.popleft())
        if self._picture is not None:
            found.append(self._picture)
            self._picture = None
        return found


class Hub:
    """Clients, and the number of the last event."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._clients: set[StreamClient] = set()
        self.sequence = 0
        """Number of the last event."""
        self.listeners: list[Callable[[str, dict[str, Any]], None]] = []
        """Called with kind and content of every event, e.g. by the log."""

    def publish(self, kind: str, content: dict[str, Any]) -> None:
        """Sends an event to every client: its `kind` and `content`, which JSON can hold."""
        with self._lock:
            self.sequence += 1
            text = json.dumps({"seq": self.sequence, "kind": kind, **content}, default=str)
            for client in self._clients:
                client.offer(text)
        for listener in self.listeners:
            listener(kind, content)

    def show(self, picture: bytes) -> None:
        """Sends a picture to every client."""
        with self._lock:
            for client in self._clients:
                client.show(picture)

    def __len__(self) -> int:
        return len(self._clients)

    def join(self) -> StreamClient | None:
        """A new client; None where there are too many."""
        client = StreamClient()
        with self._lock:
            if len(self._clients) >= MOST_CLIENTS:
                return None
            self._clients.add(client)
        return client

    def leave(self, client: StreamClient) -> None:
        """Nothing is kept for it any more."""
        with self._lock:
            self._clients.discard(client)
