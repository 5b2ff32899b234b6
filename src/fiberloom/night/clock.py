"""The clock of a night: that of the world, or that of a twin, which runs as fast as it can."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from datetime import UTC, datetime, timedelta
from typing import Protocol


class Bus(Protocol):
    """Time as a bus has it."""

    @property
    def time_s(self) -> float:
        """Since it began, s."""
        ...

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, s."""
        ...


class NightClock(Protocol):
    """UTC, and waiting."""

    def now(self) -> datetime:
        """UTC."""
        ...

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, s."""
        ...


class WorldClock:
    """That of this machine. Implements `NightClock`."""

    def now(self) -> datetime:
        """UTC."""
        return datetime.now(UTC)

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, s."""
        await asyncio.sleep(max(duration_s, 0.0))


class BusClock:
    """That of a bus whose time is virtual. Implements `NightClock`."""

    def __init__(self, zero: datetime, bus: Bus) -> None:
        """`zero`: UTC at which the time of the `bus` is 0."""
        self.zero, self.bus = zero, bus

    def now(self) -> datetime:
        """UTC."""
        return self.zero + timedelta(seconds=self.bus.time_s)

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, s; the bus is listened to meanwhile."""
        if duration_s > 0.0:
            await self.bus.sleep(duration_s)


async def within(work: Awaitable[None], clock: NightClock, timeout_s: float, poll_s: float = 0.05) -> None:
    """Waits for `work`; where it takes longer than `timeout_s` by the `clock`: TimeoutError, and it is
    cancelled, unless it has ended by itself before that was seen.

    `poll_s`: how often that is looked at, s of this machine.
    """
    task, end = asyncio.ensure_future(work), clock.now() + timedelta(seconds=timeout_s)

    def in_time() -> None:
        if clock.now() > end:
            raise TimeoutError(f"not done within {timeout_s:g} s")

    try:
        while not (await asyncio.wait({task}, timeout=poll_s))[0]:
            in_time()
        task.result()
        in_time()  # a twin lives through minutes between two looks
    finally:
        if not task.done():
            task.cancel()
            await asyncio.wait({task})
