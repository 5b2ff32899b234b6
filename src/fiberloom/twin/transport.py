"""The twin as a bus, in this process: time passes while a client waits for an answer."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Sequence
from functools import partial

from fiberloom.bus.transport import Frame
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.twin import Reply, Twin
from fiberloom.units import TICK_S

_TURNS, _AT_ONCE = 4, 12
"""Others may send after each of the first slices of a wait; later, when several have passed."""

_FRAME = partial(tuple.__new__, Frame)
"""Of a reply: `Frame(*reply)` in a third of the time."""


class TwinTransport:
    """Implements `fiberloom.bus.transport.Transport` on the twin's virtual clock.

    `slice_s`: how long the twin runs before it is asked again whether something came; an answer is
    delivered at most so late, and carries the time at which it was sent. `faults`: what begins and ends
    meanwhile.
    """

    def __init__(self, twin: Twin, slice_s: float = 0.005, faults: FaultClock | None = None) -> None:
        self._twin = twin
        self._slice_s = slice_s
        self._faults = faults or FaultClock(twin, (), 0)

    @property
    def time_s(self) -> float:
        """Virtual time."""
        return self._twin.time_s

    async def send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        """Puts frames on the bus now."""
        self._twin.send(frames)

    async def receive(self, timeout_s: float) -> list[Frame]:
        """Runs the twin until a frame comes or the time has passed."""
        end_s = self._twin.time_s + timeout_s
        for turn in itertools.count():
            left_s = end_s - self._twin.time_s
            await asyncio.sleep(0)  # others may have something to send
            replies = self._faults.carried(self._run(left_s, _AT_ONCE if turn >= _TURNS else 1))
            self._faults.follow()
            if replies or left_s <= self._slice_s:
                break
        return list(map(_FRAME, replies))

    def _run(self, left_s: float, most: int) -> list[Reply]:
        """Slices, to the next reply, fault or end of the time that is left, and no more than `most`."""
        event_s = min(left_s, self._faults.next_s - self._twin.time_s)
        slices = min(int(event_s / self._slice_s), most)
        if slices > 1:
            return self._twin.run_until_reply(self._slice_s, slices - 1)
        # a whole tick at least: a clock that does not advance would never reach the end
        return self._twin.run(min(max(left_s, TICK_S), self._slice_s))

    async def close(self) -> None:
        """Nothing to let go of."""
