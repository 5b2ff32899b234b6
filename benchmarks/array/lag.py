"""By how much an event loop is late: a task asks for it every two milliseconds."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

EVERY_S = 0.002


class LoopLag:
    """Lags in s of the running loop, noted within `watched`."""

    def __init__(self) -> None:
        self.lags_s: list[float] = []

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
            before_s = time.monotonic()
            await asyncio.sleep(EVERY_S)
            self.lags_s.append(time.monotonic() - before_s - EVERY_S)

    def figures(self) -> dict[str, float]:
        """Percentiles in ms, by time and not by number: a lag of a second is a thousand moments."""
        lag = np.sort(self.lags_s)
        shares = np.cumsum(lag + EVERY_S) / (lag + EVERY_S).sum()
        figures = {
            f"lag_p{100 * q:g}_ms": 1e3 * float(lag[np.searchsorted(shares, q)]) for q in (0.5, 0.99, 0.999)
        }
        return figures | {"lag_worst_ms": 1e3 * float(lag[-1])}
