"""A bus of other frames than SDSS-V's in this process: time passes while a host waits for an answer."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from typing import Protocol

from fiberloom.bus.transport import Frame
from fiberloom.twin.faults.clock import Breakable, FaultClock


class UnitFrame(Protocol):
    """A frame of a unit."""

    @property
    def identifier(self) -> int:
        """On the bus."""
        ...

    @property
    def data(self) -> bytes:
        """At most 8."""
        ...


class OnBus(Breakable, Protocol):
    """Units of a twin that take frames."""

    def send(self, frames: Iterable[tuple[int, bytes]]) -> Sequence[UnitFrame]:
        """Puts frames (identifier, data) on the bus now; the replies."""
        ...

    def run(self, duration_s: float) -> Sequence[UnitFrame]:
        """Lets time pass, s; what units say unasked."""
        ...


class DesiTransport:
    """Implements `fiberloom.bus.transport.Transport` on the twin's virtual clock."""

    def __init__(self, twin: OnBus, faults: FaultClock | None = None) -> None:
        """`faults`: what begins and ends meanwhile."""
        self._twin, self._faults = twin, faults or FaultClock(twin, (), 0)
        self._replies: list[Frame] = []

    @property
    def time_s(self) -> float:
        """Virtual time."""
        return self._twin.time_s

    async def send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        """Puts frames on the bus now."""
        told = self._faults.carried(self._twin.send((frame[0], frame[1]) for frame in frames))
        self._replies += [Frame(reply.identifier, reply.data, self._twin.time_s) for reply in told]

    async def receive(self, timeout_s: float) -> list[Frame]:
        """What was answered; else time passes."""
        await asyncio.sleep(0)
        if not self._replies:
            self._wait(max(timeout_s, 0.0))
        replies, self._replies = self._replies, []
        return replies

    def _wait(self, duration_s: float) -> None:
        """Time passes, with a stop at each fault that begins or ends."""
        end_s = self._twin.time_s + duration_s
        while (left_s := end_s - self._twin.time_s) > 0.0:
            self._twin.run(min(left_s, max(self._faults.next_s - self._twin.time_s, 1e-6)))
            self._faults.follow()

    async def close(self) -> None:
        """Nothing to let go of."""
