"""Links: the ways from the host to the positioners, each of which can break and come back by itself.

A transport over several links has `links` and `link_of(positioner)`. One that has neither counts as a single
link that is up until the transport raises TransportLost.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

FIRST_RETRY_S = 0.5
LONGEST_RETRY_S = 10.0
PATIENCE_S = 20.0
"""So long a question waits for a link that has just broken, in the time of its transport."""
LOOK_AGAIN_S = 0.1


@dataclass
class Link:
    """One gateway or CAN channel. Times are those of the transport's clock."""

    name: str
    up: bool = True
    since_s: float = 0.0
    """When it went up or down."""
    reason: str = ""
    """Why it is down; empty while it is up."""

    def goes_down(self, reason: str, now_s: float) -> None:
        """It has broken; the first reason counts."""
        if self.up:
            self.up, self.reason, self.since_s = False, reason, now_s

    def comes_up(self, now_s: float) -> None:
        """It carries frames again."""
        if not self.up:
            self.up, self.reason, self.since_s = True, "", now_s

    def __str__(self) -> str:
        return f"{self.name}: {'up' if self.up else f'down, {self.reason}'}"


def retries_s() -> Iterator[float]:
    """How long to wait before each further attempt to reconnect: 0.5, 1, 2, ... 10, 10 s."""
    wait_s = FIRST_RETRY_S
    while True:
        yield wait_s
        wait_s = min(2.0 * wait_s, LONGEST_RETRY_S)


def notice_silence(writer: asyncio.StreamWriter) -> None:
    """One that vanished without a word is noticed within ten seconds, by what it does not confirm.

    `writer` of a connection over TCP.
    """
    sock = writer.get_extra_info("socket")
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    options = (("TCP_KEEPIDLE", 4), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3), ("TCP_USER_TIMEOUT", 5000))
    for name, value in options:
        if hasattr(socket, name):  # not everywhere
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def links_of(transport: object) -> Sequence[Link]:
    """The links of a transport; none where it does not tell."""
    links: Sequence[Link] = getattr(transport, "links", ())
    return links


def cut_off(transport: object, positioners: Iterable[int]) -> set[int]:
    """Those of `positioners` that no frame reaches now: their link is down, or all of them are.

    A positioner that has not answered yet may hang on any link.
    """
    links = links_of(transport)
    if all(link.up for link in links):  # nearly always: asked once, and not for each of 500
        return set()
    find = getattr(transport, "link_of", lambda positioner: None)
    all_down = not any(link.up for link in links)

    def is_cut(link: Link | None) -> bool:
        return all_down if link is None else not link.up

    return {positioner for positioner in positioners if is_cut(find(positioner))}


class LinkWatch:
    """Tells which links have changed since it was last asked."""

    def __init__(self, transport: object) -> None:
        self._transport = transport
        self._seen = {link.name: (link.up, link.since_s) for link in links_of(transport)}

    def changes(self) -> list[Link]:
        """Links that went down or up, also those that did both."""
        changed = []
        for link in links_of(self._transport):
            now = (link.up, link.since_s)
            if self._seen.get(link.name, (True, 0.0)) != now:
                self._seen[link.name] = now
                changed.append(link)
        return changed


class LinkPatience:
    """Waits before a question for links that have broken: once for each break."""

    def __init__(self, transport: object, sleep: Callable[[float], Awaitable[None]]) -> None:
        """`transport` with a clock, and what lets its time pass."""
        self._transport, self._sleep = transport, sleep
        self._given_up: set[tuple[str, float]] = set()

    async def wait(self) -> None:
        """Until all links are up, but for those that were waited for in vain."""
        left_s = PATIENCE_S
        while waited := self._down():
            if left_s <= 0.0:
                self._given_up |= waited
                return
            await self._sleep(LOOK_AGAIN_S)
            left_s -= LOOK_AGAIN_S

    def _down(self) -> set[tuple[str, float]]:
        down = {(link.name, link.since_s) for link in links_of(self._transport) if not link.up}
        return down - self._given_up
