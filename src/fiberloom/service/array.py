"""The array that is served: one command at a time in a thread of its own, each on record with its author."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable, Coroutine, Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.blocking import finish
from fiberloom.bus.transport import TransportLost
from fiberloom.connect import TWIN, is_shared
from fiberloom.errors import InputError, StoppedError, one_line
from fiberloom.field import Field
from fiberloom.health.status import FibreStatus
from fiberloom.metrology.sources.errors import CameraError
from fiberloom.operation.motion import UnsafePlanError
from fiberloom.operation.outside.stops import own_stop
from fiberloom.operation.results import Observation
from fiberloom.operation.safety.memory import few_heaps, give_back
from fiberloom.operation.session.array_lock import state_of
from fiberloom.operation.session.session import KnownArray, Session, SessionReport
from fiberloom.operation.session.states import Deed, SessionState, require_legal
from fiberloom.operation.session.stopping import Stopper
from fiberloom.service.alarms.board import CAMERA, AlarmBoard
from fiberloom.service.cutout import cutout_png
from fiberloom.service.health import HealthFollower
from fiberloom.service.hub import Hub
from fiberloom.service.last_image import LastImage
from fiberloom.service.live import Live
from fiberloom.store.arrays import ArrayBook, ArrayState
from fiberloom.store.place import NUMBERED, Place
from fiberloom.store.service.alarms import Alarm, AlarmTable
from fiberloom.store.service.commands import CommandBook, CommandRecord, CommandResult
from fiberloom.store.service.history import nights_of, positioner_history
from fiberloom.targets import read_targets

EXPECTED = (InputError, CameraError, UnsafePlanError, TransportLost, OSError)
"""What may go wrong with a command; anything else is a mistake of the program, and in the log."""

REST_S = 30.0
"""So long a command has to bring everything to rest when the service ends."""

_log = logging.getLogger("fiberloom.service")


class Busy(InputError):
    """The array moves already, or may not move now: nothing was begun."""


@dataclass(frozen=True)
class Author:
    """A person or program that gives commands."""

    name: str
    role: str


@dataclass
class RunningCommand:
    """The command that runs."""

    number: int
    name: str
    author: Author
    begun: datetime = field(default_factory=lambda: datetime.now(UTC))
    stopped_by: str = ""
    task: asyncio.Task[Any] | None = None
    over: threading.Event = field(default_factory=threading.Event)

    @property
    def refusal(self) -> str:
        """Why another one cannot begin."""
        since = f"{self.begun:%H:%M:%S} UTC"
        return f"{self.name} of {self.author.name} runs since {since}; wait for its end, or stop"

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "id": self.number,
            "command": self.name,
            "author": self.author.name,
            "begun": self.begun.isoformat(),
            "stopped_by": self.stopped_by,
        }


class ServedArray:
    """One array. Methods may be called from any thread; they block for the time of a look at the store."""

    def __init__(
        self, arrayed: Field, book: ArrayBook, bus: str, folder: Path, hub: Hub, database: str = ""
    ) -> None:
        """`arrayed`: the field with its bus and camera; `book`: of the array; `bus`: its address;
        `folder`: of the record of observations; `hub`: where events go; `database`: URL of that record,
        where it is no file in the folder."""
        few_heaps()
        self.field, self.book, self.bus, self.hub = arrayed, book, bus, hub
        self.place = Place(folder, NUMBERED, database)
        self.commands = CommandBook(book)
        self.alarms = AlarmBoard(AlarmTable(book), hub.publish, self._send)
        self.live = Live(arrayed.plane, hub.publish, self.alarms.event, self.alarms.judged)
        self.health = HealthFollower(arrayed.plane, self.place)
        self.sender: Callable[[Alarm], None] = lambda _: None
        self.reached = True
        """The last command has reached the positioners, or none was given yet."""
        self.last_image = LastImage(folder, arrayed.plane.config_hash())
        self.live.keep = self.last_image.later
        arrayed.book, arrayed.witness, arrayed.watcher = book, self.live, self.live
        arrayed.keep = self._keep
        self._lock = threading.Lock()
        self._running: RunningCommand | None = None
        self._seen: tuple[str, str, str, bool] | None = None
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, name="fiberloom-array", daemon=True)

    def _send(self, alarm: Alarm) -> None:
        self.sender(alarm)

    def _serve(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_forever()

    def begin(self, calibrate: bool = True) -> None:
        """Begins to serve: what the store knows is shown, and maps are made where there are none.

        `calibrate`: at once; else with the first command.
        """
        self.commands.abandon()
        self._show_exclusions()
        self._look_at_state()
        if np.isfinite(known := self.book.places(self.field.plane.positioner_id).angles_deg).any():
            self.live.place(known)
        elif self.bus.startswith(TWIN):  # a twin of this process is folded at first
            self.live.place(self.field.plane.park_deg)
        if (image := self.last_image.read()) is not None:
            self.live.restore(image)
        self._thread.start()
        if calibrate:
            self._begin("calibrate", Author("service", "engineer"), {}, self._calibrate)

    def close(self) -> None:
        """Stops what moves, waits until it is at rest, and ends the thread."""
        if (running := self._running) is not None:
            self._cancel(running, "the end of the service")
            running.over.wait(REST_S)
        if self._thread.is_alive():
            asyncio.run_coroutine_threadsafe(_others(), self._loop).result(REST_S)
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(REST_S)
        self._loop.close()
        self.last_image.close()

    # what is asked

    @property
    def running(self) -> RunningCommand | None:
        """The command that runs; None: none."""
        return self._running

    def observe(
        self, author: Author, targets: Path, corrections: int | None = None, key: str = ""
    ) -> CommandRecord:
        """Begins to observe a target list: `targets`, with so many `corrections`; `author` and `key` for the
        record. InputError where the list cannot be read, Busy where the array is not free."""
        asked = {"targets": targets.name, "corrections": corrections}
        wanted = read_targets(targets)

        async def work() -> str:
            seen = await self.field.observe(wanted, corrections, out=self.place, pages="none")
            return _told_of(seen)

        return self.ask("observe", Deed.OBSERVE, author, asked, work, key)

    def park(self, author: Author, key: str = "") -> CommandRecord:
        """Begins to fold all. Busy where the array is not free."""
        return self.ask("park", Deed.PARK, author, {}, self._in_session(lambda s: s.park()), key)

    def home(self, author: Author, positioners: Iterable[int] | None, key: str = "") -> CommandRecord:
        """Begins to search datums of these `positioners`, None: all; `author` and `key` for the record."""
        chosen = None if positioners is None else sorted(set(positioners))
        self._check_known(chosen or ())
        work = self._in_session(lambda s: s.home(chosen))
        return self.ask("home", Deed.HOME, author, {"positioners": chosen}, work, key)

    def recover(self, author: Author, look_only: bool, key: str = "") -> CommandRecord:
        """Begins to take arms apart that touch, and unlocks; `look_only`: says what would be done;
        `author` and `key` for the record."""
        work = self._in_session(lambda s: s.recover(look_only))
        return self.ask("recover", Deed.RECOVER, author, {"look": look_only}, work, key)

    def exclude(
        self, author: Author, positioners: Iterable[int], why: str, until: datetime | None = None
    ) -> None:
        """These are not moved from the next command on.

        `author`: for the record; `positioners`: their numbers; `why`: the reason; `until`: UTC, None: until
        cleared.
        """
        chosen = sorted(set(positioners))
        asked = {"positioners": chosen, "why": why, "until": until}
        with self._recorded("exclude", author, asked):
            self._check_known(chosen)
            self.book.exclude(chosen, author.name, why, until)
            for positioner in chosen:
                self.alarms.excluded(positioner)
            self._show_exclusions()

    def include(self, author: Author, positioners: Iterable[int]) -> None:
        """Ends exclusions. InputError where one is not excluded."""
        chosen = sorted(set(positioners))
        with self._recorded("include", author, {"positioners": chosen}):
            self.book.clear(chosen, author.name)
            self._show_exclusions()

    def acknowledge(self, author: Author, number: int) -> Alarm:
        """The author knows of the alarm with this number."""
        with self._recorded("acknowledge", author, {"alarm": number}):
            return self.alarms.acknowledge(number, author.name)

    def stop_own(self, author: Author) -> RunningCommand | None:
        """Stops the command of this process, if one runs; returns at once, without a look at the store."""
        running = self._running
        if running is not None:
            self._cancel(running, author.name)
        return running

    def stop_others(self, author: Author) -> str:
        """Where this process moves nothing: stops whichever process does. What was done, in words."""
        if self.bus.startswith(TWIN):
            return "nothing moves"
        halt = own_stop(self.bus, self.field.plane.instrument.drive.protocol)
        stopper = Stopper(self.book, halt, is_shared(self.bus), f"{author.name} by the service")
        return finish(stopper.stop()).text

    def record_stop(self, author: Author, text: str) -> None:
        """Writes a stop; what moves was stopped before, so a lost store is an alarm and no refusal."""
        try:
            number = self.commands.begin(author.name, author.role, "stop", {})
            self.commands.end(number, CommandResult.DONE, text)
        except InputError as error:
            self.alarms.raise_("store", "store", str(error))
        self.hub.publish("command", {"command": "stop", "author": author.name, "text": text})

    def history(self, positioner_id: int) -> dict[str, Any]:
        """What is on record of one positioner, and what health says. InputError for one that there is not."""
        self._check_known([positioner_id])
        found: dict[str, Any] = {"measurements": [], "events": [], "alarms": []}
        if self.place.begun:
            from fiberloom.store import Store

            with Store.read(self.place.record) as store:
                found = positioner_history(store, positioner_id)
        mine = [e for e in self.book.exclusions(past=True) if e.positioner_id == positioner_id]
        known, image_utc = self.book.places(np.array([positioner_id])), self.live.cutout_utc
        return {
            "positioner_id": positioner_id,
            "health": self.health.of(positioner_id),
            "place": {"how": known.how[0], "datum": bool(known.datum[0])},
            **found,
            "nights": nights_of(found["measurements"]),
            "exclusions": [_exclusion_row(e) for e in mine],
            "image": None if image_utc is None else datetime.fromtimestamp(image_utc, UTC).isoformat(),
        }

    def cutout(self, positioner_id: int) -> bytes:
        """The last image around the metrology fibre of one, a PNG; InputError where there is none."""
        self._check_known([positioner_id])
        row = int(self.field.plane.index_of([positioner_id])[0])
        if (found := self.live.cutout(row)) is None:
            raise InputError("no image yet: the next command takes one, with a camera that takes images")
        return cutout_png(found[0], row, found[1])

    def exclusions(self) -> list[dict[str, Any]]:
        """Those in force."""
        return [_exclusion_row(e) for e in self.book.exclusions()]

    def state(self) -> dict[str, Any]:
        """State and owner of the array, from the store; one that is gone owns nothing, and is an alarm."""
        now = self.book.state()
        owner = now.owner if now.owned and self._running is None else ""
        return {"address": self.book.address, "state": str(state_of(now)), "text": now.text, "owner": owner}

    def ready(self) -> dict[str, bool]:
        """Whether a command could begin: store, bus, camera, maps."""
        try:
            self.book.state()
            store = True
        except InputError:
            store = False
        dark = any(a.code == CAMERA and a.gone is None for a in self.alarms.open())
        maps = self.field.maps is not None
        return {"store": store, "bus": self.reached, "camera": not dark, "maps": maps}

    # how it is done

    def ask(
        self,
        name: str,
        deed: Deed,
        author: Author,
        asked: dict[str, Any],
        work: Callable[[], Coroutine[Any, Any, str]],
        key: str,
    ) -> CommandRecord:
        """Begins a command.

        `name`: its own; `deed`: what the state of the array must allow; `author`, `asked` and `key`: for the
        record; `work`: what it does, and tells at the end. Busy where the array is not free.
        """
        if (before := self.commands.by_key(author.name, key)) is not None:
            return before
        try:
            self._check_free(deed)
            return self._begin(name, author, asked, work, key)
        except Busy as error:
            number = self.commands.begin(author.name, author.role, name, asked, key)
            self.commands.end(number, CommandResult.REFUSED, str(error))
            raise

    def _check_free(self, deed: Deed) -> None:
        """Raises Busy where another command runs, here or elsewhere, or the state does not allow this one."""
        with self._lock:  # who has read that a command is over can give the next one at once
            running = self._running
        if running is not None:
            raise Busy(running.refusal)
        found = self.book.state()
        if found.owned:
            raise Busy(
                f"{self.book.address}: in use by {found.owner}, {found.state}; wait for its end, or stop"
            )
        try:
            require_legal(deed, state_of(found), self.book.address, found.text)
        except InputError as error:
            raise Busy(str(error)) from None

    def _check_known(self, positioners: Iterable[int]) -> None:
        if strange := sorted(set(positioners) - set(self.field.plane.positioner_id.tolist())):
            raise InputError(f"positioner {strange[0]}: no such positioner in this layout")

    def _begin(
        self,
        name: str,
        author: Author,
        asked: dict[str, Any],
        work: Callable[[], Coroutine[Any, Any, str]],
        key: str = "",
    ) -> CommandRecord:
        with self._lock:
            if (running := self._running) is not None:
                raise Busy(running.refusal)
            number = self.commands.begin(author.name, author.role, name, asked, key)
            running = self._running = RunningCommand(number, name, author)
        self.live.command, self.live.heard = name, False
        self.hub.publish("command", running.as_dict() | {"result": "running"})
        asyncio.run_coroutine_threadsafe(self._run(running, work), self._loop)
        record = self.commands.get(number)
        assert record is not None
        return record

    async def _run(self, running: RunningCommand, work: Callable[[], Coroutine[Any, Any, str]]) -> None:
        running.task = asyncio.current_task()
        self.field.command_line = f"fiberloom serve: {running.name} by {running.author.name}"
        try:
            if running.stopped_by:
                raise asyncio.CancelledError
            result, text = CommandResult.DONE, await work()
        except (asyncio.CancelledError, StoppedError) as error:
            result, text = CommandResult.STOPPED, str(error) or f"stopped by {running.stopped_by}"
        except EXPECTED as error:
            result, text = CommandResult.FAILED, one_line(error, 600)
        except Exception as error:
            _log.exception("%s", running.name)
            result, text = CommandResult.FAILED, f"a mistake of the program: {one_line(error)}"
        await asyncio.to_thread(self._ended, running, result, text)

    def _ended(self, running: RunningCommand, result: CommandResult, text: str) -> None:
        """Books the end of a command; none is begun in between."""
        with self._lock:
            self._book_end(running, result, text)
        give_back()

    def _book_end(self, running: RunningCommand, result: CommandResult, text: str) -> None:
        """What fails here is an alarm: the array is free all the same."""
        try:
            self.commands.end(running.number, result, text)
            if result is CommandResult.FAILED:
                self.reached = self.live.heard or running.name == "calibrate"
                self.alarms.raise_("command", running.name, text)
            elif result is CommandResult.DONE:
                self.reached = True
                self.alarms.clear("command", running.name)
                if self.live.heard:
                    self.alarms.looked_again(running.begun)
            self._look_at_state()
            self.propose()
            self.alarms.clear("store", "store")  # all of this was written
        except InputError as error:
            self.alarms.raise_("store", "store", str(error))
        finally:
            self.live.ended()
            self._running = None
            running.over.set()
            told = running.as_dict() | {"result": str(result), "text": text}
            self.hub.publish("command", told)

    def _cancel(self, running: RunningCommand, author: str) -> None:
        running.stopped_by = running.stopped_by or author
        if (task := running.task) is not None:
            self._loop.call_soon_threadsafe(task.cancel, f"stopped by {running.stopped_by}")

    def look(self) -> ArrayState:
        """The state of the array as the store has it; what has changed since the last look is told.

        One that is locked, or whose owner is gone, is an alarm. InputError where the store cannot be read.
        """
        row = self.book.state()
        if (seen := (row.state, row.text, row.owner, row.stale)) != self._seen:
            self._seen = seen
            self._look_at_state()
        return row

    def _look_at_state(self) -> None:
        """Publishes the state of the array; one that is locked, or whose owner is gone, is an alarm."""
        now, row = self.state(), self.book.state()
        gone = f"{row.owner} is gone; the array was {row.state}" if row.stale else ""
        locked = now["text"] if now["state"] == SessionState.LOCKED else None
        for code, text in (("collision", locked), ("owner", gone or None)):
            if text is None:
                self.alarms.clear(code, "array")
            else:
                self.alarms.raise_(code, "array", text or "arms have touched")
        self.hub.publish("array", now)

    def propose(self) -> None:
        """Health judges the runs that have ended since; what it says of those that a person has not excluded
        yet is an alarm."""
        self.health.follow()
        excluded = {e.positioner_id for e in self.book.exclusions()}
        found = self.health.proposals().items()
        self.alarms.proposals({p: said for p, said in found if p not in excluded})

    def _show_exclusions(self) -> None:
        rows = self.exclusions()
        self.live.exclude(row["positioner_id"] for row in rows)
        self.hub.publish("exclusions", {"exclusions": rows})

    async def _calibrate(self) -> str:
        await self.field.calibrate()
        return "maps are there"

    def _in_session(
        self, work: Callable[[Session], Coroutine[Any, Any, SessionReport]]
    ) -> Callable[[], Coroutine[Any, Any, str]]:
        """What runs a command of a session, and tells in words how it ended."""

        async def run() -> str:
            maps = await self.field.calibrate()
            known = KnownArray(self.field.plane, maps, self.field.source, self.book)
            made = await asyncio.to_thread(
                Session, known, self.field.command_line, self.live.say, (), self.live
            )
            return _told_of_session(await work(made))

        return run

    def _keep(self, seen: Observation) -> None:
        if self.field.folder is not None:
            seen.save(self.field.folder)

    def _recorded(self, name: str, author: Author, asked: dict[str, Any]) -> _Recorded:
        return _Recorded(self, name, author, asked)


class _Recorded:
    """A command that is done at once: on record, with how it ended."""

    def __init__(self, array: ServedArray, name: str, author: Author, asked: dict[str, Any]) -> None:
        self._array, self._name, self._author, self._asked = array, name, author, asked

    def __enter__(self) -> None:
        author = self._author
        self._number = self._array.commands.begin(author.name, author.role, self._name, self._asked)

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        result = CommandResult.DONE if error is None else CommandResult.REFUSED
        text = "" if error is None else one_line(error, 600)
        self._array.commands.end(self._number, result, text)
        told = {"id": self._number, "command": self._name, "author": self._author.name}
        self._array.hub.publish("command", told | {"result": str(result), "text": text})


async def _others() -> None:
    """Waits for all other tasks of the loop."""
    await asyncio.gather(*(asyncio.all_tasks() - {asyncio.current_task()}), return_exceptions=True)


def _told_of(seen: Observation) -> str:
    """How an observation has ended: by its images, and on a twin in truth too, where that differs."""
    summary = seen.summary()
    within, truly = seen.final.status.count(FibreStatus.ON_TARGET), summary["n_within_requirement"]
    rms_um = summary["moves"][-1]["measured_rms_um"]
    told = [f"{within} of {summary['n_assigned']} fibres within the requirement"]
    told += [] if rms_um is None else [f"{rms_um:.2f} um rms as measured"]
    told += [] if truly == within else [f"in the truth of the twin {truly}"]
    return ", ".join(told)


def _told_of_session(report: SessionReport) -> str:
    left = "; ".join(f"{p}: {why}" for p, why in list(report.left_out.items())[:20])
    folded = f"{len(report.folded)} of {report.n_positioners} folded"
    stages = "; ".join(report.touching + report.stages)
    lost = "; ".join(f"{p} {why}" for p, why in list(report.lost_steps.items())[:20])
    return "; ".join(filter(None, [folded, stages, left and f"left out: {left}", lost]))


def _exclusion_row(exclusion: Any) -> dict[str, Any]:
    names = ("positioner_id", "since", "until", "who", "why", "cleared", "cleared_by")
    values = {name: getattr(exclusion, name) for name in names}
    return {k: v.isoformat() if isinstance(v, datetime) else v for k, v in values.items()}
