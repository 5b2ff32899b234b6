"""A twin paced to the wall clock, for clients that live in real time."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from fiberloom._core import twin as _core
from fiberloom.errors import InputError
from fiberloom.twin.twin import Reply, Twin

SPEEDS = 0.01, 100.0


@dataclass(frozen=True)
class LateTick:
    """A tick that was not kept and did not have to wait for another."""

    due_s: float
    """When it was due, by `time.monotonic()`."""
    late_ms: float
    """From there to the end of its computation."""
    computing_ms: float
    cause: str
    core: int
    """On which it ended; if it was woken late, on which it slept. -1 where the system does not tell."""
    frames: int
    """Frames that came with it."""
    single: int
    """Positioners whose own firmware did the tick, since they did not cruise: they set out, turn or land."""


@dataclass(frozen=True)
class Lateness:
    """How well the clock was kept.

    A control tick is due every 0.5 ms; its lateness runs from there to the end of its computation. It
    is *kept* when it has ended before the next one is due. Ticks in which every positioner rested need no
    computation and are counted apart.
    """

    ticks: int
    kept: int
    resting: int
    p50_ms: float
    p99_ms: float
    worst_ms: float
    late_by_cause: dict[str, int]
    """Ticks that were not kept, by what took most of the time from when they were due to their end.

    *woken*: the thread slept, and was woken too late; *held*: others touched the twin; *frames*: frames were
    taken in and handed out; *taken*: the system gave the core to others; *blocked*: the thread waited for a
    lock; *computed*: the computation was long; *paged*: so it was, and it touched new memory. One that had
    to wait for another has the cause of that."""
    first_by_cause: dict[str, int]
    """Of them, those that did not have to wait for another."""
    woken_ms: tuple[float, float, float]
    """By how much the thread was late when it had slept until a tick was due: half, 99 %, the worst."""
    computing_ms: tuple[float, float, float]
    """How long the computation of a tick took: half, 99 %, the longest."""
    late_ticks: tuple[LateTick, ...]
    """Of `first_by_cause`, one by one; the first 200."""
    given_up_s: float
    """Wall time by which the clock was set back because the twin had fallen behind by over a second."""

    @property
    def share_kept(self) -> float:
        """Of the ticks that were computed; 1 when there were none."""
        return self.kept / self.ticks if self.ticks else 1.0


class RealTimeTwin:
    """Runs a `Twin` in a thread of its own, `speed` virtual seconds a second, until `close`.

    `fileno()` becomes readable when frames wait in `take()`. Touch the twin itself only inside
    `held()`. `buses` says which bus each positioner (row of the plane) hangs on; all on 0 by default.
    `first`: before all ordinary programs of this machine (SCHED_FIFO), where the system allows it.
    """

    def __init__(
        self,
        twin: Twin,
        speed: float = 1.0,
        buses: Iterable[int] | None = None,
        first: bool = False,
    ) -> None:
        if not SPEEDS[0] <= speed <= SPEEDS[1]:
            raise InputError(f"speed {speed}: give {SPEEDS[0]} to {SPEEDS[1]:g} virtual seconds a second")
        self._twin = twin
        self.speed = speed
        for row, bus in enumerate(buses or ()):
            twin._core.connect(row, int(bus))
        self._read_fd, self._write_fd = os.pipe()
        for fd in (self._read_fd, self._write_fd):
            os.set_blocking(fd, False)
        self._real = _core.RealTime(twin._core, speed, self._write_fd, first)
        if first and not self._real.first:
            self.close()
            raise InputError("--first: the system does not allow it; run as root, or give CAP_SYS_NICE")

    def fileno(self) -> int:
        """Readable when frames can be taken."""
        return self._read_fd

    @property
    def time_s(self) -> float:
        """Virtual time that the wall clock shows now."""
        return self._real.tick_now * _core.TICK_S

    def post(self, frames: Iterable[tuple[int, bytes, int, float]]) -> None:
        """Frames (identifier, data, bus, virtual time in s at which they arrive)."""
        self._real.post([(i, data, bus, _tick_of(time_s)) for i, data, bus, time_s in frames])

    def take(self) -> list[Reply]:
        """What positioners sent since the last call."""
        with suppress(BlockingIOError):  # nothing new was announced: there may still be something
            os.read(self._read_fd, 4096)
        return [Reply(*r) for r in self._real.take()]

    @contextmanager
    def held(self) -> Iterator[Twin]:
        """The twin between two ticks; the clock goes on, so be quick: the ticks that wait are late."""
        self._real.hold()
        try:
            yield self._twin
        finally:
            self._real.release()

    def lateness(self) -> Lateness:
        """Since the start."""
        p = self._real.pace()
        return Lateness(
            ticks=p["ticks_busy"],
            kept=p["ticks_kept"],
            resting=p["ticks_resting"],
            p50_ms=1e3 * p["late_p50_s"],
            p99_ms=1e3 * p["late_p99_s"],
            worst_ms=1e3 * p["late_worst_s"],
            late_by_cause=p["late_by_cause"],
            first_by_cause=p["first_by_cause"],
            woken_ms=_ms(p["woken_s"]),
            computing_ms=_ms(p["computing_s"]),
            late_ticks=tuple(LateTick(*t) for t in p["late_ticks"]),
            given_up_s=p["given_up_s"],
        )

    def close(self) -> None:
        """Ends the thread; the twin's time does not advance from here on."""
        self._real.stop()
        for fd in (self._read_fd, self._write_fd):
            if fd >= 0:
                os.close(fd)
        self._read_fd = self._write_fd = -1


def _ms(spread_s: Iterable[float]) -> tuple[float, float, float]:
    half, most, worst = (1e3 * value for value in spread_s)
    return half, most, worst


def _tick_of(time_s: float) -> int:
    return max(int(time_s / _core.TICK_S), 0)
