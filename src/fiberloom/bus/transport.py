"""What carries frames: the contract, and the transports for real buses.

The client takes its time from the transport alone, so a transport may have a virtual clock.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple, Protocol

from fiberloom.bus.identifier import positioner_of
from fiberloom.bus.links import Link, retries_s
from fiberloom.errors import InputError

_READ_S = 0.1
"""So long a thread waits for a frame before it looks whether it is wanted still."""


class Frame(NamedTuple):
    """A classic CAN frame with an extended identifier, and when it was received."""

    id: int
    data: bytes = b""
    time_s: float = 0.0


class TransportLost(ConnectionError):
    """The transport is closed, or cannot come back by itself; it has to be opened anew."""


class Transport(Protocol):
    """Carries frames to and from the positioners. One that is closed for good raises TransportLost.

    One over several links has `links` and `link_of(positioner)` too (`fiberloom.bus.links`): frames for a
    link that is down are dropped, and it comes back by itself.
    """

    @property
    def time_s(self) -> float:
        """The transport's clock: never runs backwards, and runs while `receive` waits."""
        ...

    async def send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        """Queues frames (identifier, data, ...) in order."""
        ...

    async def receive(self, timeout_s: float) -> list[Frame]:
        """What has arrived; waits up to `timeout_s` for the first frame, then may return none."""
        ...

    async def close(self) -> None:
        """Lets go of the bus. Closing twice does no harm."""
        ...


class _Channel:
    """One CAN channel of python-can: read by a thread of its own, opened anew when it breaks."""

    def __init__(self, name: str, bus: Any, reopen: Callable[[], Any] | None) -> None:
        self.link = Link(name, since_s=time.monotonic())
        self.take: Callable[[list[Frame]], None] = lambda frames: None
        self._bus, self._reopen = bus, reopen
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=f"fiberloom-can-{name}")
        self._task: asyncio.Task[None] | None = None

    def serve(self) -> None:
        """From now on it is read, and opened anew whenever it breaks."""
        if self._task is None:
            self._task = asyncio.create_task(self._keep())

    async def _keep(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            frames, reason = await loop.run_in_executor(self._thread, self._read)
            if frames:
                self.take(frames)
            if reason:
                self.breaks(reason)
            if not self.link.up:
                await self._open_again()

    def _read(self) -> tuple[list[Frame], str]:
        """What has come, and why the channel is broken if it is."""
        import can

        frames = []
        try:
            message = self._bus.recv(_READ_S)
            while message is not None:
                if message.is_extended_id and not message.is_error_frame:
                    frames.append(Frame(message.arbitration_id, bytes(message.data), message.timestamp))
                message = self._bus.recv(0.0)
        except (can.CanError, OSError) as error:
            return frames, str(error) or type(error).__name__
        return frames, ""

    async def send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        """Hands frames to python-can in a worker thread; dropped while the link is down."""
        if self.link.up and (reason := await asyncio.to_thread(self._send, frames)):
            self.breaks(reason)

    def _send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> str:
        import can

        try:
            for frame in frames:
                message = can.Message(arbitration_id=frame[0], data=frame[1], is_extended_id=True, check=True)
                self._bus.send(message, timeout=1.0)
        except (can.CanError, OSError) as error:
            return str(error) or type(error).__name__
        return ""

    def breaks(self, reason: str) -> None:
        """Takes the link down; the task that reads it opens it anew."""
        self.link.goes_down(f"CAN channel {self.link.name}: {reason}", time.monotonic())
        self.take([])

    async def _open_again(self) -> None:
        for wait_s in retries_s():
            await asyncio.sleep(wait_s)
            if self._reopen is not None and await asyncio.to_thread(self._try_to_open, self._reopen):
                break
        self.link.comes_up(time.monotonic())
        self.take([])

    def _try_to_open(self, reopen: Callable[[], Any]) -> bool:
        import can

        try:
            self._bus.shutdown()
            self._bus = reopen()
        except (can.CanError, OSError, ValueError):
            return False
        return True

    async def close(self) -> None:
        """Ends the reader and shuts the bus down."""
        if self._task is not None:
            self._task.cancel()
        await asyncio.to_thread(self._thread.shutdown)
        self._bus.shutdown()


class PythonCanTransport:
    """One or more buses that python-can knows (socketcan, slcan, virtual, ...), each a link."""

    def __init__(
        self,
        bus: Any,
        *more: Any,
        names: Sequence[str] = (),
        reopen: Callable[[str], Any] | None = None,
        whose: Callable[[int], int] = positioner_of,
    ) -> None:
        """`names` of the buses; `reopen`: opens the bus of a name anew, else one that breaks stays down;
        `whose`: the positioner of an identifier, 0 for all.
        """
        self._whose = whose
        buses = (bus, *more)
        names = tuple(names) or tuple(f"CAN bus {k}" for k in range(len(buses)))
        self._channels = [
            _Channel(name, b, None if reopen is None else partial(reopen, name))
            for name, b in zip(names, buses, strict=True)
        ]
        self._route: dict[int, _Channel] = {}
        self._received: asyncio.Queue[Frame] = asyncio.Queue()
        self._closed = False
        for channel in self._channels:
            channel.take = partial(self._take, channel)

    @classmethod
    def open(
        cls,
        interface: str,
        *channels: str,
        bitrate: int = 1_000_000,
        whose: Callable[[int], int] = positioner_of,
    ) -> PythonCanTransport:
        """Opens buses by python-can's names for the interface and its channels; `bitrate` in bit/s, `whose`:
        the positioner of an identifier, 0 for all.
        """
        import can

        def bus_of(channel: str) -> Any:
            return can.Bus(interface=interface, channel=channel, bitrate=bitrate)

        opened: list[Any] = []
        for channel in channels:
            try:
                opened.append(bus_of(channel))
            except (can.CanError, OSError, NotImplementedError, ValueError) as error:
                for bus in opened:
                    bus.shutdown()
                raise InputError(
                    f"cannot open CAN interface '{interface}', channel '{channel}': {error}; check "
                    "the names against python-can's list of interfaces, and that the bus is up"
                ) from None
        return cls(*opened, names=channels, reopen=bus_of, whose=whose)

    @property
    def time_s(self) -> float:
        """Monotonic wall-clock time."""
        return time.monotonic()

    @property
    def links(self) -> Sequence[Link]:
        """One for each channel."""
        return [channel.link for channel in self._channels]

    def link_of(self, positioner: int) -> Link | None:
        """The channel on which a positioner has answered; None before it did."""
        known = self._route.get(positioner)
        return None if known is None else known.link

    def _take(self, channel: _Channel, frames: list[Frame]) -> None:
        """Frames of a channel; none: the link has changed, which wakes the task that waits."""
        for frame in frames:
            self._route[self._whose(frame.id)] = channel
        for frame in frames or [Frame(-1)]:
            self._received.put_nowait(frame)

    async def send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        """Frames to the channels they belong to; to all of them where that is not known yet."""
        self._serve()
        queues: dict[_Channel, list[tuple[int, bytes] | Frame]] = {}
        for frame in frames:
            number = self._whose(frame[0])
            known = self._route.get(number) if number else None
            for channel in self._channels if known is None else [known]:
                queues.setdefault(channel, []).append(frame)
        await asyncio.gather(*(channel.send(mine) for channel, mine in queues.items()))

    def _serve(self) -> None:
        if self._closed:
            raise TransportLost("CAN bus: the transport is closed")
        for channel in self._channels:
            channel.serve()

    async def receive(self, timeout_s: float) -> list[Frame]:
        """The frames of all channels in the order of their arrival."""
        self._serve()
        return await take_all(self._received, timeout_s)

    async def close(self) -> None:
        """Shuts the buses down."""
        if not self._closed:
            self._closed = True
            await asyncio.gather(*(channel.close() for channel in self._channels))


async def take_all(received: asyncio.Queue[Frame], timeout_s: float) -> list[Frame]:
    """What is in a queue, waiting up to `timeout_s` for the first; frames below zero only wake."""
    frames: list[Frame] = []
    try:
        if received.empty():
            frames.append(await asyncio.wait_for(received.get(), max(timeout_s, 0.0)))
        while not received.empty():
            frames.append(received.get_nowait())
    except TimeoutError:
        return []
    return [frame for frame in frames if frame.id >= 0]
