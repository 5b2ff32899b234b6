"""The array behind an interface: commands of a session, one at a time, each in a thread of its own."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path

from fiberloom.blocking import finish
from fiberloom.bus.spec import BusSpec
from fiberloom.connect import TWIN, is_shared
from fiberloom.errors import InputError, StoppedError, one_line
from fiberloom.field import Field
from fiberloom.observatory.alarms import alarms_of, no_store
from fiberloom.observatory.port import ArrayView
from fiberloom.operation.session.array_lock import state_of
from fiberloom.operation.session.session import KnownArray, Session, SessionReport
from fiberloom.operation.session.states import Deed, SessionState, require_legal
from fiberloom.operation.session.stopping import Stopper
from fiberloom.store.arrays import ArrayBook, ArrayState
from fiberloom.targets import TargetList, read_targets

ASKED_S = 0.3
"""So long a command has to stop by itself: the store tells it who asks, ten times a second."""
REST_S = 30.0
"""So long it has to bring all to rest."""

LeftOut = dict[int, str]
"""Reason by number of the positioner."""


class _Command:
    """A command at work in a thread."""

    def __init__(self, name: str, who: str, work: Callable[[], Awaitable[LeftOut]]) -> None:
        self.name, self.who, self.over = name, who, threading.Event()
        self.failed, self.left_out = "", LeftOut()
        self._work, self._begun = work, threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"fiberloom-{name}", daemon=True)

    def start(self) -> None:
        self._thread.start()
        self._begun.wait()

    def cancel(self) -> None:
        with contextlib.suppress(RuntimeError):  # its loop has ended by itself
            self._loop.call_soon_threadsafe(self._task.cancel)

    def _run(self) -> None:
        try:
            finish(self._to_its_end())
        finally:
            self._begun.set()
            self.over.set()

    async def _to_its_end(self) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._loop, self._task = asyncio.get_running_loop(), task
        self._begun.set()
        try:
            self.left_out = await self._work()
        except (asyncio.CancelledError, StoppedError):
            pass  # as asked; the state of the array says so
        except Exception as error:  # whatever it is, the next command must be possible
            self.failed = f"{self.name}: {one_line(error)}"


class SessionArray:
    """One array over its sessions; implements `ArrayPort`."""

    def __init__(self, field: Field, book: ArrayBook, bus: str, targets: Path, out: Path) -> None:
        """`field`: with bus, camera and maps; `book`: what a store keeps of the array; `bus`: its address;
        `targets`: folder of the target lists that may be asked for; `out`: folder of the record."""
        self._field, self._book, self._bus = field, book, bus
        self._targets, self._out = targets, out
        self._lock = threading.Lock()
        self._last: _Command | None = None
        field.book = book

    def view(self) -> ArrayView:
        """How it is now."""
        last = self._last
        running = f"{last.name} of {last.who}" if last is not None and not last.over.is_set() else ""
        failed, left_out = (last.failed, last.left_out) if last is not None else ("", LeftOut())
        address, n = self._book.address, len(self._field.plane)
        try:
            row, excluded = self._book.state(), self._book.exclusions()
        except InputError as error:
            return ArrayView(address, SessionState.UNKNOWN, "", "", running, n, (), no_store(error))
        numbers = tuple(e.positioner_id for e in excluded)
        alarms = alarms_of(row, failed, left_out)
        return ArrayView(address, str(_seen(row)), row.text, row.owner, running, n, numbers, alarms)

    def stop(self, who: str) -> str:
        """Stops what moves; returns when it is at rest."""
        command = self._last
        if command is None or command.over.is_set():
            return self._stop_others(who)
        threading.Thread(target=self._ask_stop, args=(who,), daemon=True).start()
        if not command.over.wait(ASKED_S):
            command.cancel()  # again, or where the store does not answer
        if not command.over.wait(REST_S):
            return f"{command.name} does not end within {REST_S:.0f} s; cut the power of the positioners"
        return f"{command.name} has ended; the array is {self.view().state}"

    def _ask_stop(self, who: str) -> None:
        with contextlib.suppress(InputError):
            self._book.ask_stop(who)

    def _stop_others(self, who: str) -> str:
        if self._bus.startswith(TWIN):
            return "nothing moves"
        stopper = Stopper(self._book, BusSpec.parse(self._bus).open, is_shared(self._bus), who)
        return finish(stopper.stop()).text

    def park(self, who: str) -> str:
        """Begins to fold all positioners."""
        return self._begin("park", Deed.PARK, who, lambda: self._in_session(Session.park))

    def home(self, who: str) -> str:
        """Begins to search all datums."""
        return self._begin("home", Deed.HOME, who, lambda: self._in_session(Session.home))

    def recover(self, who: str) -> str:
        """Begins to take arms apart that touch, and unlocks."""
        return self._begin("recover", Deed.RECOVER, who, lambda: self._in_session(Session.recover))

    def configure(self, who: str, targets: str) -> str:
        """Begins to put fibres on the `targets` of a list in the folder."""
        wanted = read_targets(self._list(targets))
        return self._begin("configure", Deed.OBSERVE, who, lambda: self._observe(wanted))

    def close(self) -> None:
        """Stops what this process moves."""
        if self._last is not None and not self._last.over.is_set():
            self.stop("the end of the interface")

    def _list(self, name: str) -> Path:
        """A file below the folder of target lists, and nowhere else."""
        root = self._targets.resolve()
        path = (root / name).resolve()
        if not path.is_relative_to(root) or not path.is_file():
            raise InputError(f"targets '{one_line(name)}': no such list in {root}")
        return path

    def _begin(self, name: str, deed: Deed, who: str, work: Callable[[], Awaitable[LeftOut]]) -> str:
        with self._lock:
            last = self._last
            if last is not None and not last.over.is_set():
                raise InputError(f"{last.name} of {last.who} is at work: wait for its end, or stop")
            row = self._book.state()
            owner = f"in use by {row.owner}" if row.owned else row.text
            require_legal(deed, state_of(row), self._book.address, owner)
            self._field.command_line = f"fiberloom.observatory: {name} by {who}"
            self._last = _Command(name, who, work)
            self._last.start()
        return f"{name} has begun"

    async def _in_session(self, command: Callable[[Session], Awaitable[SessionReport]]) -> LeftOut:
        maps = await self._field.calibrate()
        known = KnownArray(self._field.plane, maps, self._field.source, self._book)
        return (await command(Session(known, self._field.command_line))).left_out

    async def _observe(self, targets: TargetList) -> LeftOut:
        seen = await self._field.observe(targets, out=self._out)
        faults: dict[str, list[int]] = seen.summary()["faults"]
        return {p: kind for kind, positioners in faults.items() for p in positioners}


def _seen(row: ArrayState) -> SessionState:
    """As its owner has it while there is one, else as the next command finds it."""
    return SessionState(row.state) if row.owned else state_of(row)
