"""By how much an event loop is late: a task asks for it every two milliseconds.

Where other programs have the cores, a loop is late that nothing in its own process holds up. Linux counts for
how long a thread was ready and not run; the `own` figures are the lag without that.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

EVERY_S = 0.002


class LoopLag:
    """Lags in s of the running loop, noted within `watched`."""

    def __init__(self) -> None:
        self.lags_s: list[float] = []
        self.own_s: list[float] = []

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Notes them until it is left."""
        listener = asyncio.ensure_future(self._listen())
        try:
            yield
        finally:
            listener.cancel()

    async def _listen(self) -> None:
        while True:
            before_s, waited_s = time.monotonic(), _not_run_s()
            await asyncio.sleep(EVERY_S)
            lag_s = time.monotonic() - before_s - EVERY_S
            self.lags_s.append(lag_s)
            self.own_s.append(max(lag_s - (_not_run_s() - waited_s), 0.0))

    def figures(self) -> dict[str, float]:
        """Percentiles in ms, of all lag and of the process's own."""
        return percentiles_ms("lag", self.lags_s) | percentiles_ms("lag_own", self.own_s)


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
