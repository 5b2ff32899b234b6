"""The wire of one CAN port: 1 Mbit/s for both directions, and a gateway's queue of 100 frames.

Frames go one after the other, in the order in which they were ready (arbitration would let small
identifiers go first). What does not fit the queue is discarded without a word, as a CAN@net does.
"""

from __future__ import annotations

from collections import deque

from fiberloom.bus.protocol import frame_s

QUEUE_FRAMES = 100
DEAD_FRAME_S = 0.01
"""On a wire without acknowledgement, a queued frame is given up after this time."""


class Wire:
    """Times in virtual seconds; `now_s` must not go backwards."""

    def __init__(self, queue_frames: int = QUEUE_FRAMES) -> None:
        self.queue_frames = queue_frames
        self.cut = False
        """No receiver at the other end: frames leave the queue one by one and are lost."""
        self.overflows = 0
        self._starts_s: deque[float] = deque()  # of frames that wait in the queue
        self._free_s = 0.0

    def offer(self, data_bytes: int, now_s: float) -> float | None:
        """A frame from the host: the time in s at which it arrives; None when it does not."""
        if self.queued(now_s) >= self.queue_frames:
            self.overflows += 1
            return None
        start_s = max(now_s, self._free_s)
        self._starts_s.append(start_s)
        self._free_s = start_s + (DEAD_FRAME_S if self.cut else frame_s(data_bytes))
        return None if self.cut else self._free_s

    def carry(self, data_bytes: int, now_s: float) -> float | None:
        """A frame from a positioner: the time in s at which the gateway has it; None when never."""
        if self.cut:
            return None
        self._free_s = max(now_s, self._free_s) + frame_s(data_bytes)
        return self._free_s

    def queued(self, now_s: float) -> int:
        """Frames of the host that wait."""
        while self._starts_s and self._starts_s[0] <= now_s:
            self._starts_s.popleft()
        return len(self._starts_s)

    def clear(self) -> None:
        """Forgets what waits."""
        self._starts_s.clear()
        self._free_s = 0.0
