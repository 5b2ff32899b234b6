"""A night on the array that is served: begun and resumed as a command, changed by people while it goes on."""

from __future__ import annotations

import logging
import threading
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fiberloom.connect import TWIN
from fiberloom.errors import InputError, one_line
from fiberloom.night.asked.control import NightControl
from fiberloom.night.asked.orders import ADD, PRIORITY, SKIP, new_field, require_field
from fiberloom.night.carry import NightEnd, carry_out
from fiberloom.night.queue import Queue, read_queue
from fiberloom.night.report import write_report
from fiberloom.night.runner import NightRunner
from fiberloom.night.setup import NightSetup
from fiberloom.operation.known import Learning, known_so_far
from fiberloom.operation.session.session import KnownArray
from fiberloom.operation.session.states import Deed
from fiberloom.service.array import Author, Busy, RunningCommand, ServedArray
from fiberloom.service.night.view import night_view, open_alarms
from fiberloom.service.pace import PacedSource
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.nights.book import NightBook, nights
from fiberloom.store.run import FAILED, FINISHED
from fiberloom.store.service.alarms import Alarm
from fiberloom.store.service.commands import CommandBook, CommandRecord, CommandResult

LOOK_S = 2.0
"""Between two looks at the record, where nothing is told meanwhile."""
UNHURRIED = ("expose", "wait", "pause", "waiting")
"""Stages, by their first word, in which nothing moves: a twin may run faster."""

_log = logging.getLogger("fiberloom.service")


@dataclass(frozen=True)
class NightPace:
    """How fast a twin inside of this process runs: virtual seconds a second."""

    source: PacedSource
    moving: float
    exposing: float

    def follow(self, stage: str) -> None:
        """As fast as the stage that begins allows."""
        self.source.speed = self.exposing if stage.startswith(UNHURRIED) else self.moving


class ServedNight:
    """The night of one queue. Methods may be called from any thread."""

    def __init__(self, array: ServedArray, queue_file: Path, pace: NightPace | None = None) -> None:
        """`array`: on which; `queue_file`: TOML; `pace`: of a twin inside of this process."""
        self.array, self.queue_file, self.pace = array, queue_file.resolve(), pace
        self._runner: NightRunner | None = None
        self._carried: RunningCommand | None = None
        """The command that the runner carries out, or did."""
        self._store: Store | None = None
        self._news, self._over = threading.Event(), threading.Event()
        self._sent: set[int] = set()
        self._judged: tuple[int, ...] = ()
        """Runs of visits that health has looked at."""
        self._thread = threading.Thread(target=self._show, name="fiberloom-night", daemon=True)

    def start(self) -> None:
        """Begins to show the night."""
        self._store = Store.open(self.array.place.record)
        self._thread.start()

    def close(self) -> None:
        """Shows nothing more."""
        self._over.set()
        self._news.set()
        if self._thread.is_alive():
            self._thread.join()
        if self._store is not None:
            self._store.close()

    # what is asked

    @property
    def begins(self) -> bool:
        """A night was asked for and has no record yet: what is known is that of the one before."""
        running = self.array.running
        return running is not None and running.name == "night" and running is not self._carried

    @property
    def goes_on(self) -> bool:
        """The night is carried out now, and on record."""
        running = self.array.running
        return running is not None and running is self._carried

    def begin(self, author: Author, resume: bool, key: str = "") -> CommandRecord:
        """Begins the night, or goes on with the last one of this queue where `resume` says so.

        `author` and `key`: for the record. InputError where the queue cannot be read, or there is none to go
        on with; Busy where the array is not free.
        """
        read_queue(self.queue_file)
        asked = {"queue": self.queue_file.name, "resume": resume}
        return self.array.ask("night", Deed.OBSERVE, author, asked, lambda: self._carry(resume), key)

    def can_resume(self) -> bool:
        """The last night of this queue did not come to its end."""
        mine = [n for n in nights(self._opened()) if n.queue == str(self.queue_file)]
        return bool(mine) and mine[-1].status != FINISHED

    def pause(self, author: Author) -> None:
        """Nothing begins after what is under way."""
        with self._recorded("pause", author, {}) as runner:
            runner.control.pause(author.name)

    def go_on(self, author: Author) -> None:
        """A night that is paused goes on."""
        with self._recorded("go on", author, {}) as runner:
            runner.control.go_on()

    def park(self, author: Author) -> None:
        """Ends what moves or waits, folds all, ends the night; an exposure is not cut short."""
        with self._recorded("park at once", author, {}) as runner:
            runner.control.park(author.name)

    def skip(self, author: Author, field: str) -> None:
        """Leaves a field of the queue out from now on. InputError where there is none."""
        with self._recorded(SKIP, author, {"field": field}) as runner:
            require_field(self._queue(runner), field)

    def set_priority(self, author: Author, field: str, priority: float) -> None:
        """Moves a `field` in the queue. InputError where there is none.

        `author`: who asks; `priority`: a ratio, higher first.
        """
        with self._recorded(PRIORITY, author, {"field": field, "priority": priority}) as runner:
            require_field(self._queue(runner), field)

    def add(self, author: Author, asked: dict[str, Any], targets: Path) -> None:
        """Adds a field as it is `asked` for, with a list of `targets`. InputError for one that cannot be."""
        with self._recorded(ADD, author, asked | {"targets": str(targets)}) as runner:
            new_field(self._queue(runner), asked, targets)

    def acknowledge(self, author: Author, alarm: int) -> None:
        """The author knows of an alarm of the night. InputError where none is open with this number."""
        book = self._book()
        if book is None or alarm not in {a.id for a in self.alarms()}:
            raise InputError(f"alarm {alarm}: the night has none that is open")
        book.acknowledge(alarm, datetime.now(UTC), author.name)
        self._news.set()

    def alarms(self) -> list[Alarm]:
        """Of the night, those that are not acknowledged, the worst first."""
        book = self._book()
        return [] if book is None else open_alarms(book)

    def view(self) -> dict[str, Any]:
        """The night as it is shown, and whether another one begins; before the first one the queue alone."""
        runner = self._runner
        if runner is None:
            return {"goes_on": False} | self._about()
        rate = 1.0 if self.pace is None else self.pace.source.speed
        told = night_view(runner, self._shown_queue(runner), rate, self.goes_on)
        return told | self._about()

    def _about(self) -> dict[str, Any]:
        return {"queue": self.queue_file.name, "begins": self.begins, "resume": self.can_resume()}

    # how it is done

    def _opened(self) -> Store:
        assert self._store is not None, "start() was not called"
        return self._store

    def _book(self) -> NightBook | None:
        return None if self._runner is None else self._runner.book

    def _queue(self, runner: NightRunner) -> Queue:
        """As the night will have it with its next step."""
        return runner.setup.queue_of(runner.book)

    def _shown_queue(self, runner: NightRunner) -> Queue:
        """The same; where its file cannot be read, the last good one."""
        try:
            return self._queue(runner)
        except InputError:
            return runner.queue

    async def _carry(self, resume: bool) -> str:
        array, field = self.array, self.array.field
        maps = await field.calibrate()
        maps_file = field.maps_file or array.place.base / "maps.npz"
        known = known_so_far(field.plane, maps, maps_file, Learning(seed=field.seed))
        setup = NightSetup(
            known,
            KnownArray(field.plane, maps, field.source, array.book),
            self.queue_file,
            array.place.base,
            field.command_line,
            field.seed,
            virtual=array.bus.startswith(TWIN),
            database=array.place.database,
            witness=array.live,
            control=NightControl(),
            begun=self._begun,
        )
        try:
            return _told(await carry_out(setup, self._opened(), resume, self._progress))
        finally:
            self._report(setup)

    def _begun(self, runner: NightRunner) -> None:
        self._runner, self._carried = runner, self.array.running
        self._news.set()

    def _progress(self, text: str) -> None:
        """A stage begins, in the loop of the array."""
        if self.pace is not None:
            self.pace.follow(text)
        self.array.live.say(text)
        self._news.set()

    def _report(self, setup: NightSetup) -> None:
        if (book := self._book()) is not None:
            folder = setup.folder(book.id)
            folder.mkdir(parents=True, exist_ok=True)
            write_report(book, folder)

    def _show(self) -> None:
        """Publishes the night after each change, in a thread: the record is read for it."""
        while not self._over.is_set():
            self._news.wait(LOOK_S)
            self._news.clear()
            try:
                self.array.hub.publish("night", self.view())
                self._send()  # before what may take long, or fail
                self._judge()
            except InputError as error:
                _log.error("the night cannot be shown: %s", one_line(error))
            except Exception:  # it is shown again with the next change
                _log.exception("the night cannot be shown")

    def _judge(self) -> None:
        """Health looks at each visit as soon as its fibres were measured: a night is long."""
        book = self._book()
        visits = [] if book is None else book.visits()
        measured = tuple(v.run_id for v in visits if v.run_id is not None and v.rms_um is not None)
        if measured != self._judged:
            self.array.propose()
            self._judged = measured

    def _send(self) -> None:
        """Tells people outside of alarms that are new."""
        for alarm in self.alarms():
            if alarm.id not in self._sent:
                self._sent.add(alarm.id)
                self.array.sender(alarm)

    @contextmanager
    def _recorded(self, name: str, author: Author, asked: dict[str, Any]) -> Any:
        """A command to the night that goes on: on record with its author before it acts, and how it ended."""
        runner = self._runner
        if self.begins:
            raise Busy(f"{name}: the night only begins; ask again when its first step is shown")
        if runner is None or not self.goes_on:
            raise Busy(f"{name}: no night goes on; begin one, or resume the last one")
        commands = CommandBook(ArrayBook(self._opened(), self.array.book.address))
        number = commands.begin(author.name, author.role, name, asked, night=runner.book.id)
        result, text = CommandResult.DONE, ""
        try:
            yield runner
        except InputError as error:
            result, text = CommandResult.REFUSED, one_line(error, 600)
            raise
        finally:
            commands.end(number, result, text)
            told = {"id": number, "command": name, "author": author.name, "result": result, "text": text}
            self.array.hub.publish("command", told)
            self._news.set()


def _told(end: NightEnd) -> str:
    if end.status == FAILED:
        raise InputError(f"night {end.night}: {end.why}")
    return f"night {end.night} {end.status}: {end.why}"
