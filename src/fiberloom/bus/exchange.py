"""Requests and their replies: which request waits for which reply, on one transport.

A unicast request is matched by (positioner, command, uid), a broadcast by (command, uid 0). Uids
rotate through 1 to 63, so that a reply that comes after its request was given up meets no newer
request. A task that waits reads the transport for all others too; every wait ends at a deadline in the
transport's time, or at once when the connection is lost. What is asked of a positioner whose link is down
ends at once; the other links go on.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence

from fiberloom.bus.identifier import MAX_POSITIONER, MAX_UID, Identifier, decode, encode
from fiberloom.bus.links import Link, LinkWatch, cut_off
from fiberloom.bus.protocol import Command
from fiberloom.bus.transport import Frame, Transport
from fiberloom.timing import part

# A transport whose clock has not moved after this many empty receives will never reach a deadline.
_STANDSTILL_LIMIT = 1000
_COLLISION_DETECTED = int(Command.COLLISION_DETECTED)
_COMMAND_AND_UID = 0xFF << 10 | MAX_UID << 4
# A transport may count in ticks: less than this could be no time at all for it.
_SHORTEST_WAIT_S = 1e-3
# A task that begins to wait while another listens takes its turn after this time at the latest.
LONGEST_WAIT_S = 0.25
_CENSUS_ROUNDS = 10


class _Waiter:
    """The replies to one bundle of unicast requests."""

    __slots__ = ("keys", "missing", "replies")

    def __init__(self, count: int) -> None:
        self.replies: list[Frame | None] = [None] * count
        self.missing = count
        self.keys: list[int] = []


class _BroadcastWaiter:
    """The replies to one broadcast, by positioner."""

    __slots__ = ("replies", "waited_for")

    def __init__(self, expected: Iterable[int] | None) -> None:
        self.replies: dict[int, Frame] = {}
        self.waited_for = None if expected is None else set(expected)

    def take(self, positioner: int, frame: Frame) -> None:
        self.replies.setdefault(positioner, frame)
        if self.waited_for is not None:
            self.waited_for.discard(positioner)

    def give_up(self, cut_off: Callable[[Iterable[int]], set[int]]) -> None:
        """Waits no longer for positioners that are cut off."""
        if self.waited_for is not None:
            self.waited_for -= cut_off(self.waited_for)

    def complete(self) -> bool:
        return self.waited_for is not None and not self.waited_for


class Exchange:
    """Sends requests over a transport and hands each its reply."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self.lost: str | None = None
        """Why the connection is gone; None while it is up."""
        self.strays = 0
        """Frames that no request waited for: late, doubled, with a foreign uid."""
        self.on_unsolicited: Callable[[Identifier, Frame], None] = lambda identifier, frame: None
        self.on_link: Callable[[Link], None] = lambda link: None
        """Called when a link has gone down or come up."""
        self._links = LinkWatch(transport)
        self._pending: dict[int, tuple[_Waiter, int]] = {}  # by identifier >> 4
        self._broadcasts: dict[int, _BroadcastWaiter] = {}  # by command
        self._broadcast_locks: dict[int, asyncio.Lock] = {}
        self._last_uid: dict[int, int] = {}  # by (identifier >> 4) with uid 0
        self._deadlines: list[float] = []
        self._reader = asyncio.Lock()
        self._standstill = 0

    @property
    def time_s(self) -> float:
        """The transport's clock."""
        return self.transport.time_s

    def cut_off(self, positioners: Iterable[int]) -> set[int]:
        """Those that no frame reaches now: the connection is gone, or their link is down."""
        return cut_off(self.transport, positioners) if self.lost is None else set(positioners)

    async def unicast(
        self,
        command: int,
        positioners: Sequence[int],
        payloads: Sequence[bytes],
        timeout_s: float,
    ) -> list[Frame | None]:
        """Send one frame per row and return each one's reply, None where none came in time.

        `command`: its number; `positioners` and `payloads`: one each per row; `timeout_s`: for each
        reply. A positioner may be named several times; its frames keep their order. Nothing is sent to
        one that is cut off, nor waited for.
        """
        waiter = _Waiter(len(positioners))
        deadline_s = self.time_s + timeout_s
        try:
            await self._send_all(waiter, command, list(zip(positioners, payloads, strict=True)), deadline_s)
            await self.wait(lambda: waiter.missing == 0, deadline_s)
        finally:
            for key in waiter.keys if waiter.missing else ():
                if (entry := self._pending.get(key)) is not None and entry[0] is waiter:
                    del self._pending[key]
        return waiter.replies

    async def _send_all(
        self, waiter: _Waiter, command: int, requests: Sequence[tuple[int, bytes]], deadline_s: float
    ) -> None:
        self._see_links()
        row = 0
        while row < len(requests):
            frames, row = self._numbered(waiter, command, requests, row)
            await self._send(frames)
            # 63 requests of one positioner in flight: those before it have gone out, now it needs a uid
            if row < len(requests) and not await self._wait_for_key(command, requests[row][0], deadline_s):
                break

    @part("bus")
    def _numbered(
        self, waiter: _Waiter, command: int, requests: Sequence[tuple[int, bytes]], first: int
    ) -> tuple[list[tuple[int, bytes]], int]:
        """Frames from row `first` on, and the row to go on with: the first one that no uid is free for."""
        frames: list[tuple[int, bytes]] = []
        gone = self.cut_off(positioner for positioner, _ in requests)
        for row in range(first, len(requests)):
            positioner, payload = requests[row]
            if positioner in gone:
                waiter.missing -= 1
                continue
            key = self._free_key(command, positioner)
            if key is None:
                return frames, row
            self._pending[key] = (waiter, row)
            waiter.keys.append(key)
            frames.append((key << 4, payload))
        return frames, len(requests)

    def _free_key(self, command: int, positioner: int) -> int | None:
        """The next unused uid of this command and positioner, as identifier >> 4."""
        if not 1 <= positioner <= MAX_POSITIONER:
            raise ValueError(f"positioner {positioner}: identifiers hold 1 to {MAX_POSITIONER}")
        base = positioner << 14 | command << 6
        uid = self._last_uid.get(base, 0)
        for _ in range(MAX_UID):
            uid = uid % MAX_UID + 1
            if base | uid not in self._pending:
                self._last_uid[base] = uid
                return base | uid
        return None

    async def _wait_for_key(self, command: int, positioner: int, deadline_s: float) -> bool:
        """Until one is free; False where none was in time."""
        base = positioner << 14 | command << 6
        return await self.wait(
            lambda: any(base | uid not in self._pending for uid in range(1, MAX_UID + 1)), deadline_s
        )

    async def broadcast(
        self,
        command: int,
        payload: bytes,
        timeout_s: float,
        expected: Iterable[int] | None = None,
    ) -> dict[int, Frame]:
        """Send one frame to all positioners; returns the replies by positioner.

        `command`: its number, with `payload`. Ends when all `expected` positioners have answered that are
        not cut off, else at `timeout_s`. One broadcast per command is in flight at a time, because all of
        them share uid 0.
        """
        async with self._broadcast_locks.setdefault(command, asyncio.Lock()):
            waiter = _BroadcastWaiter(expected)
            self._broadcasts[command] = waiter
            try:
                deadline_s = self.time_s + timeout_s
                self._see_links()
                waiter.give_up(self.cut_off)
                await self._send([(encode(0, command), payload)])
                await self.wait(waiter.complete, deadline_s)
            finally:
                del self._broadcasts[command]
            return waiter.replies

    async def census(self, command: int, timeout_s: float) -> dict[int, Frame]:
        """Broadcast a `command` without payload until two rounds in a row bring no new positioner.

        Returns the first reply of each. The first round lasts for half of `timeout_s`; each further one ends
        when all that are known have answered, or after a quarter. Three rounds fit into `timeout_s`, which
        is waited for in any case; at most ten are sent.
        """
        async with self._broadcast_locks.setdefault(command, asyncio.Lock()):
            waiter = self._broadcasts[command] = _BroadcastWaiter(None)
            try:
                self._see_links()
                await self._rounds(waiter, encode(0, command), timeout_s)
            finally:
                del self._broadcasts[command]
            return waiter.replies

    async def _rounds(self, waiter: _BroadcastWaiter, identifier: int, timeout_s: float) -> None:
        deadline_s, quiet = self.time_s + timeout_s, -1
        for _ in range(_CENSUS_ROUNDS):
            begun_s, known = self.time_s, len(waiter.replies)
            waiter.waited_for = set(waiter.replies) or None
            await self._send([(identifier, b"")])
            # looked at whenever something comes, else at the reader's own pace
            while not waiter.complete() and self.time_s < begun_s + timeout_s / 4 and not self.lost:
                await self._listen_once(max(deadline_s, begun_s + timeout_s / 4))
            quiet = 0 if len(waiter.replies) > known or quiet < 0 else quiet + 1
            if quiet == 2 or self.lost:
                break
        await self.wait(lambda: False, deadline_s)

    async def _listen_once(self, deadline_s: float) -> None:
        self._deadlines.append(deadline_s)
        try:
            async with self._reader:
                await self._receive()
        finally:
            self._deadlines.remove(deadline_s)

    async def sleep(self, duration_s: float) -> None:
        """Lets the transport's time pass, still listening."""
        await self.wait(lambda: False, self.time_s + duration_s)

    async def wait(self, done: Callable[[], bool], deadline_s: float, early_s: float = 0.0) -> bool:
        """Listens until `done()` or the deadline, at most `early_s` before it; True when done."""
        self._deadlines.append(deadline_s)
        try:
            while not done():
                if self.lost or self.time_s >= deadline_s - early_s:
                    return False
                async with self._reader:
                    if not done() and not self.lost:
                        await self._receive()
            return True
        finally:
            self._deadlines.remove(deadline_s)

    async def _send(self, frames: list[tuple[int, bytes]]) -> None:
        if self.lost or not frames:
            return
        try:
            await self.transport.send(frames)
        except OSError as error:
            self.lost = str(error) or type(error).__name__

    async def _receive(self) -> None:
        # every task that is ready sends first: on a virtual clock, receiving makes time pass
        await asyncio.sleep(0)
        # no longer than the earliest deadline of those that wait
        before_s = self.time_s
        try:
            left_s = min(self._deadlines) - before_s
            wait_s = min(max(left_s, _SHORTEST_WAIT_S), LONGEST_WAIT_S)
            frames = await self.transport.receive(wait_s)
        except OSError as error:
            self.lost = str(error) or type(error).__name__
            return
        self._watch_clock(bool(frames) or self.time_s > before_s)
        self._dispatch(frames)
        self._see_links()

    def _see_links(self) -> None:
        """Tells of links that have changed; gives up what waits behind one that is down."""
        changed = self._links.changes()
        if any(not link.up for link in changed):
            gone = self.cut_off({key >> 14 for key in self._pending})
            for key in [key for key in self._pending if key >> 14 in gone]:
                self._pending.pop(key)[0].missing -= 1
            for waiter in self._broadcasts.values():
                waiter.give_up(self.cut_off)
        for link in changed:
            self.on_link(link)

    def _watch_clock(self, progress: bool) -> None:
        self._standstill = 0 if progress else self._standstill + 1
        if self._standstill > _STANDSTILL_LIMIT:
            self.lost = "the transport's clock does not advance"

    @part("bus")
    def _dispatch(self, frames: Sequence[Frame]) -> None:
        pending, broadcasts = self._pending, {c << 10: waiter for c, waiter in self._broadcasts.items()}
        broadcasts.pop(_COLLISION_DETECTED << 10, None)
        for frame in frames:
            number = frame[0]
            waiter = broadcasts.get(number & _COMMAND_AND_UID)  # one of a broadcast has uid 0
            if waiter is not None and 0 < number >> 18 <= MAX_POSITIONER:
                waiter.take(number >> 18, frame)
            elif (entry := pending.pop(number >> 4, None)) is not None:
                entry[0].replies[entry[1]] = frame
                entry[0].missing -= 1
            else:
                self._dispatch_other(frame)

    def _dispatch_other(self, frame: Frame) -> None:
        """A collision, or a frame that no request waits for."""
        number = frame[0]
        if 0 < number >> 18 <= MAX_POSITIONER and number >> 10 & 0xFF == _COLLISION_DETECTED:
            self.on_unsolicited(decode(number), frame)
        else:
            self.strays += 1
