"""Stages of a night: each with a time-out, a precondition and a cleanup; how long each took is on record."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from datetime import datetime

from fiberloom.night.clock import NightClock, within
from fiberloom.operation.safety.stop import reason
from fiberloom.operation.safety.writing import Writer, beside
from fiberloom.store.nights.book import NightBook

DONE = "done"


class RefusedError(RuntimeError):
    """A stage may not begin."""


async def _nothing() -> None:
    """No cleanup."""


@dataclass(frozen=True)
class NightStage:
    """What is done in one go."""

    name: str
    action: Callable[[], Awaitable[None]]
    timeout_s: float
    """By the clock of the night."""
    precondition: Callable[[], str] = lambda: ""
    """Why it may not begin; empty: it may."""
    cleanup: Callable[[], Awaitable[None]] = _nothing
    """Done at the end, however the stage ends."""


class StageRunner:
    """Runs stages and keeps how long they took."""

    def __init__(self, book: NightBook, clock: NightClock, progress: Callable[[str], None]) -> None:
        """`book`: of the night; `clock`: of it; `progress`: called with the name of each stage."""
        self.book, self.clock, self.progress = book, clock, progress
        self.under_way: Lap | None = None

    async def run(self, stage: NightStage, visit: int | None = None) -> None:
        """Runs a `stage` of a `visit`, None: of the night.

        RefusedError where its precondition is not met, TimeoutError where it takes too long; else what the
        action raises. Its cleanup is done, and its end is on record, in every case.
        """
        if why := stage.precondition():
            raise RefusedError(f"{stage.name}: {why}")
        lap = self.under_way = Lap.begin(stage.name, visit, self.clock)
        self.progress(stage.name)
        outcome = DONE
        try:
            await within(stage.action(), self.clock, stage.timeout_s)
        except BaseException as error:
            outcome = reason(error)
            raise
        finally:
            try:
                await stage.cleanup()
            finally:
                await beside(lap.note, self.book, self.clock.now(), time.monotonic(), outcome)
                self.under_way = None


@dataclass(frozen=True)
class Lap:
    """A stage that is under way."""

    name: str
    visit: int | None
    utc: datetime
    begun_s: float
    """Of this machine."""

    @classmethod
    def begin(cls, name: str, visit: int | None, clock: NightClock) -> Lap:
        """A stage with this `name` begins now, by the `clock`; `visit`: that it belongs to."""
        return cls(name, visit, clock.now(), time.monotonic())

    def note(self, book: NightBook, now: datetime, now_s: float, outcome: str = DONE) -> None:
        """Writes into the `book` that it has ended `now`, `now_s` by this machine, and its `outcome`."""
        took = {"duration_s": (now - self.utc).total_seconds(), "wall_s": now_s - self.begun_s}
        book.note_stage(self.utc, {"visit_id": self.visit, "name": self.name, "outcome": outcome, **took})


class StepWatcher:
    """Keeps how long the steps within a stage took. Implements `operation.observe.Watcher`."""

    def __init__(self, record: StageRunner, visit: int, within: str) -> None:
        """`record`: keeps them; `visit`: they belong to; `within`: the stage."""
        self.record, self.visit, self.within = record, visit, within
        self._lap: Lap | None = None
        self._writer = Writer()

    def say(self, text: str) -> None:
        """The step before has ended, and this one begins; the same text again is the same step."""
        name = f"{self.within}: {text}"
        if self._lap is not None and self._lap.name == name:
            return
        self._end()
        self.record.progress(text)
        self._lap = Lap.begin(name, self.visit, self.record.clock)

    def count(self, done: int, total: int) -> None:
        """Nothing."""

    async def close(self) -> None:
        """The last step has ended; all are on record."""
        self._end()
        await self._writer.close()

    def _end(self) -> None:
        if self._lap is not None:
            self._writer.later(self._lap.note, self.record.book, self.record.clock.now(), time.monotonic())
            self._lap = None
