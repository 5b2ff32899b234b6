"""By how much an event loop is late: a task asks for it every two milliseconds.

Where other programs have the cores, a loop is late that nothing in its own process holds up. Linux counts for
how long a thread was ready and not run; the `own` figures are the lag without that.

A thread looks where the loop is while it is late: the slowest steps are named by the lines that were seen in
them.
"""

from __future__ import annotations

import asyncio
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

import numpy as np

EVERY_S = 0.002
LONG_S = 0.005
"""A step that lasts longer is looked at."""


@dataclass
class Step:
    """One step of the loop that was long."""

    late_s: float = 0.0
    seen: Counter[str] = field(default_factory=Counter)
    """How often the loop was seen at a place."""

    def __str__(self) -> str:
        where = self.seen.most_common(1)[0][0] if self.seen else "not seen"
        return f"{1e3 * self.late_s:.0f} ms: {where}"


class LoopLag:
    """Lags in s of the running loop, noted within `watched`."""

    def __init__(self) -> None:
        self.lags_s: list[float] = []
        self.own_s: list[float] = []
        self.steps: list[Step] = []
        """Longer than LONG_S."""
        self._tick_s, self._now, self._over = 0.0, Step(), threading.Event()

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Notes them until it is left."""
        self._tick_s = time.monotonic()
        listener = asyncio.ensure_future(self._listen())
        sampler = threading.Thread(target=self._sample, args=(threading.get_ident(),), daemon=True)
        sampler.start()
        try:
            yield
        finally:
            listener.cancel()
            self._over.set()
            sampler.join()

    async def _listen(self) -> None:
        while True:
            before_s, waited_s = time.monotonic(), _not_run_s()
            await asyncio.sleep(EVERY_S)
            self._tick_s = time.monotonic()
            lag_s = self._tick_s - before_s - EVERY_S
            own_s = max(lag_s - (_not_run_s() - waited_s), 0.0)
            self.lags_s.append(lag_s)
            self.own_s.append(own_s)
            if own_s > LONG_S:
                self._now.late_s = own_s
                self.steps.append(self._now)
            self._now = Step()

    def _sample(self, thread: int) -> None:
        """Looks where the loop's thread is while it is late."""
        while not self._over.wait(EVERY_S):
            if time.monotonic() - self._tick_s > LONG_S:
                self._now.seen[_places(thread)] += 1

    def slowest(self, n: int = 10) -> list[str]:
        """The longest steps, the longest first: how long without the waiting for a core, and where."""
        return [str(step) for step in sorted(self.steps, key=lambda step: -step.late_s)[:n]]

    def figures(self) -> dict[str, float]:
        """Percentiles in ms, of all lag and of the process's own."""
        return percentiles_ms("lag", self.lags_s) | percentiles_ms("lag_own", self.own_s)


def _places(thread: int) -> str:
    """Where the loop's thread is; where it waits to go on, where the others are that do not let it."""
    frames = dict(sys._current_frames())
    frames.pop(threading.get_ident(), None)
    here = _place(frames.pop(thread, None))
    return here or "beside " + "; ".join(filter(None, map(_place, frames.values())))


def _place(frame: FrameType | None) -> str:
    """The three innermost lines of ours, the outermost first; empty: none."""
    ours: list[str] = []
    while frame is not None and len(ours) < 3:
        path = Path(frame.f_code.co_filename)
        if "fiberloom" in path.parts:
            ours.insert(0, f"{path.parent.name}/{path.name}:{frame.f_lineno} {frame.f_code.co_name}")
        frame = frame.f_back
    return " > ".join(ours)


def percentiles_ms(name: str, lags_s: list[float]) -> dict[str, float]:
    """By time and not by number: a lag of a second is a thousand moments."""
    lag = np.sort(lags_s)
    shares = np.cumsum(lag + EVERY_S) / (lag + EVERY_S).sum()
    figures = {
        f"{name}_p{100 * q:g}_ms": 1e3 * float(lag[np.searchsorted(shares, q)]) for q in (0.5, 0.99, 0.999)
    }
    return figures | {f"{name}_worst_ms": 1e3 * float(lag[-1])}


def _not_run_s() -> float:
    """For how long this thread was ready and not run, since it began."""
    return 1e-9 * int(Path("/proc/thread-self/schedstat").read_text().split()[1])
