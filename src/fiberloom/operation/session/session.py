"""A session with an array: commands of an operator, each under the lock and with the begin check first."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.errors import InputError, StoppedError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.operation.move import Goals, Recorder
from fiberloom.operation.recording import SurveyRecorder
from fiberloom.operation.reference.declare import declare_seen_right
from fiberloom.operation.safety.stop import reason
from fiberloom.operation.safety.writing import beside, entered
from fiberloom.operation.session.array_lock import ArrayLock
from fiberloom.operation.session.exploring import Exploration
from fiberloom.operation.session.home import Homing
from fiberloom.operation.session.motion import SessionMotion, last_status
from fiberloom.operation.session.recover import Recovery
from fiberloom.operation.session.states import Deed, SessionState, Step
from fiberloom.operation.session.stop_search import StopSearch
from fiberloom.operation.session.witness import Witness, WitnessedRecorder
from fiberloom.operation.source import Source
from fiberloom.store import Run, Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.typing import Ints


@dataclass
class SessionReport:
    """What a command has done."""

    command: str
    state: str
    text: str
    n_positioners: int
    folded: list[int] = field(default_factory=list)
    """Positioners that are folded now."""
    datum_found: list[int] = field(default_factory=list)
    """Positioners whose datum was searched and found."""
    touching: list[str] = field(default_factory=list)
    """Bodies that touched, of a recovery."""
    stages: list[str] = field(default_factory=list)
    """Of a recovery: what was done."""
    found: list[int] = field(default_factory=list)
    """Positioners that were not certain to be anywhere and were found by a small move, of a recovery."""
    left_out: dict[int, str] = field(default_factory=dict)
    """Reason for each positioner that did not do what was asked."""
    lost_steps: dict[int, str] = field(default_factory=dict)
    """Positioners that have lost steps between two searches of their datum; they are well again."""

    @property
    def ok(self) -> bool:
        """Every positioner did what was asked, and has lost no steps before."""
        return not self.left_out and not self.lost_steps


@dataclass(frozen=True)
class KnownArray:
    """What a session knows of an array: layout, maps, how to reach it, what is on record."""

    plane: FocalPlane
    """The layout as given."""
    maps: TransmissionMaps
    source: Source
    book: ArrayBook

    def excluded_plane(self, further: Iterable[int] = ()) -> FocalPlane:
        """The layout with excluded positioners offline, where they were last known to be.

        `further`: excluded for this command alone. InputError where one is not in the layout.
        """
        excluded = sorted({e.positioner_id for e in self.book.exclusions()} | set(further))
        known = [p for p in excluded if p in set(self.plane.positioner_id.tolist())]
        if strange := sorted(set(further) - set(known)):
            raise InputError(f"--exclude {strange[0]}: no such positioner in this layout")
        if not known:
            return self.plane
        rows = self.plane.index_of(known)
        offline, place_deg = self.plane.offline.copy(), self.plane.offline_position_deg.copy()
        recorded = self.book.places(np.array(known)).angles_deg
        offline[rows] = True
        place_deg[rows] = np.where(np.isfinite(recorded), recorded, self.plane.park_deg[rows])
        return replace(self.plane, offline=offline, offline_position_deg=place_deg)


class Session:
    """Commands to one array; each opens and closes the bus.

    What goes wrong is in the events of the array's store, and in the report.
    """

    def __init__(
        self,
        known: KnownArray,
        command_line: str,
        progress: Callable[[str], None] = lambda _: None,
        exclude: Iterable[int] = (),
        witness: Witness | None = None,
    ) -> None:
        """`known`: the array; `command_line`: for the record, and for others who ask which process owns
        the array; `progress`: called with the name of each step; `exclude`: for this session alone;
        `witness`: told of moves while they are made."""
        self.known, self.command_line, self.progress = known, command_line, progress
        self.plane = known.excluded_plane(exclude)
        self.witness = witness

    @property
    def _store(self) -> Store:
        return self.known.book.store

    @asynccontextmanager
    async def owning(self, deed: Deed) -> AsyncIterator[HeldArray]:
        """Owns the array for one command: the lock is taken, and at the end the state says how it ended.

        InputError where another process owns it, or the command is not legal in its state.
        """
        task, loop = asyncio.current_task(), asyncio.get_running_loop()
        why: list[str] = []

        def stop(text: str) -> None:
            why.append(text)
            if task is not None:
                loop.call_soon_threadsafe(task.cancel)

        lock = ArrayLock(self.known.book, self.command_line)
        try:
            said = await beside(lock.take, deed, stop)
            if said:
                self.progress(said)
            async with self._ended(HeldArray(self, lock, said), why) as held:
                yield held
        finally:
            await beside(lock.release)

    @asynccontextmanager
    async def _ended(self, held: HeldArray, why: list[str]) -> AsyncIterator[HeldArray]:
        """Says in the state of the array how the command has ended; `why`: it was stopped by another one."""
        try:
            yield held
            await beside(held.settle)
        except asyncio.CancelledError as error:
            asked = why[0] if why else str(error) or "stopped by the operator"
            await beside(held.leave, Step.STOP, asked)
            if why:
                raise StoppedError(f"{why[0]}; what was measured is kept") from None
            raise
        except BaseException as error:
            await beside(held.leave, Step.LOSE, reason(error))
            raise

    def start_run(self) -> Run:
        """A run in the store of the array."""
        return self._store.start_run(
            command_line=self.command_line,
            instrument=self.plane.instrument.name,
            config_hash=self.known.plane.config_hash(),
        )

    @asynccontextmanager
    async def _moving(self, deed: Deed) -> AsyncIterator[SessionMotion]:
        """Owns the array, opens bus and camera, and does the begin check."""
        async with self.owning(deed) as held, entered(self.start_run) as run:
            if held.said:
                await beside(run.record_event, "taken over", held.said)
            hardware = await self.known.source.open()
            recorder = SurveyRecorder(run, self.plane)
            motion = held.motion(self.plane, self.known.maps, hardware, recorder, self.progress)
            try:
                self.progress("begin check")
                await motion.connect()
                yield motion
            finally:
                await motion.close()

    async def park(self) -> SessionReport:
        """Folds every positioner that follows commands, by a verified plan."""
        async with self._moving(Deed.PARK) as motion:
            await declare_seen_right(motion)
            await fold(motion)
        return await beside(self._report, "park", motion)

    async def home(self, positioner_id: Iterable[int] | None = None) -> SessionReport:
        """Searches the datum of positioners, in an order in which no arms can meet; then folds.

        `positioner_id`: their numbers, None: all. In the report: which were found, and why others were
        not searched. ArrayPlaces say from then on that the datum is known.
        """
        async with self._moving(Deed.HOME) as motion:
            homing = await _searching(motion, self._rows(positioner_id))
            await homing.run()
            await fold(motion)
        report = await beside(self._report, "home", motion)
        report.datum_found, report.left_out = homing.found, homing.left_out
        if isinstance(homing, StopSearch):
            report.lost_steps = homing.lost_steps
        return report

    async def recover(self, look_only: bool = False) -> SessionReport:
        """After a collision: says which arms touch, moves them apart by a verified way, folds, unlocks.

        Then those of which it is not certain where they are: a small move of each that is proven clear,
        an image, and it is told where it is. `look_only`: says what touches and what would be done, and
        moves nothing; the array stays locked where something touches. In the report: why a positioner still
        touches something, or is not found.
        """
        async with self._moving(Deed.RECOVER) as motion:
            recovery, exploration = Recovery(motion, look_only), Exploration(motion, look_only)
            if await recovery.run() or look_only:
                await exploration.run()
            if exploration.found and motion.lock.state is not SessionState.LOCKED:
                await fold(motion)
        report = await beside(self._report, "recover", motion)
        report.touching, report.found = recovery.touching, exploration.found
        report.stages = recovery.stages + exploration.stages
        report.left_out |= exploration.left_out | recovery.stuck
        return report

    def _rows(self, positioner_id: Iterable[int] | None) -> Ints:
        if positioner_id is None:
            return np.flatnonzero(~self.plane.offline)
        wanted = sorted(set(positioner_id))
        if strange := sorted(set(wanted) - set(self.plane.positioner_id.tolist())):
            raise InputError(f"positioner {strange[0]}: no such positioner in this layout")
        return np.asarray(self.plane.index_of(wanted))

    def _report(self, command: str, motion: SessionMotion) -> SessionReport:
        status, folded = last_status(motion), motion.are_folded
        ids = self.plane.positioner_id
        left = {
            int(p): str(status[i]) for i, p in enumerate(ids) if not folded[i] and not self.plane.offline[i]
        }
        now = self.known.book.state()
        at = [int(p) for p in ids[folded & ~self.plane.offline]]
        return SessionReport(command, now.state, now.text, len(ids), folded=at, left_out=left)


SETTLED = frozenset({SessionState.UNKNOWN, SessionState.STOPPED, SessionState.LOCKED, SessionState.PARKED})
"""States in which a part of a command has left the array."""


class HeldArray:
    """An array while one command owns it."""

    def __init__(self, session: Session, lock: ArrayLock, said: str) -> None:
        """`session`: its own; `lock`: taken; `said`: what the operator should know of the owner before."""
        self.session, self.lock, self.said = session, lock, said
        self._motion: SessionMotion | None = None

    def motion(
        self,
        plane: FocalPlane,
        maps: TransmissionMaps,
        hardware: Hardware,
        recorder: Recorder,
        progress: Callable[[str], None],
    ) -> SessionMotion:
        """Of this command: `plane`, `maps`, `hardware`, `recorder`, `progress` as in `FieldMotion`."""
        witness = self.session.witness
        if witness is not None:
            recorder = WitnessedRecorder(recorder, witness)
        self._motion = SessionMotion(plane, maps, hardware, recorder, progress, self.lock)
        self._motion.witness = witness
        return self._motion

    @property
    def collided(self) -> list[int]:
        """Positioners of the last motion that have collided."""
        return [] if self._motion is None else self._motion.collided

    def settle(self) -> None:
        """The command has ended by itself; a state that says already how stays."""
        motion = self._motion
        if motion is None or self.lock.state in SETTLED:
            return
        if collided := motion.collided:
            self.leave(Step.COLLIDE, f"collision of positioners {', '.join(map(str, collided))}")
        else:
            self.lock.step(Step.FOLD if motion.folded else Step.REST)

    def leave(self, step: Step, text: str) -> None:
        """The command has ended otherwise; a state that says more stays."""
        if self._motion is not None and self._motion.collided:
            step, text = Step.COLLIDE, f"collision; {text}"
        elif step is Step.LOSE and self.lock.state is SessionState.STOPPED:
            return  # all are at rest, and where each was left is on record
        if not self.lock.lost:
            self.lock.step(step, text)


async def _searching(motion: SessionMotion, rows: Ints) -> Homing | StopSearch:
    """The search of the positioners in `rows`, as their motors need it."""
    if motion.has_client:
        return Homing(motion, rows)
    await fold(motion)
    return StopSearch(motion, rows)


async def fold(motion: SessionMotion) -> None:
    """Folds every positioner that follows commands."""
    await motion.go(Goals.without_targets(motion.plane, motion.plane.park_deg))


def as_table(report: SessionReport) -> dict[str, Any]:
    """A report for the terminal or as JSON."""
    return {
        "command": report.command,
        "state": report.state,
        "text": report.text,
        "positioners": report.n_positioners,
        "folded": len(report.folded),
        "datum_found": report.datum_found,
        **(
            {"touching": report.touching, "stages": report.stages, "found": report.found}
            if report.command == "recover"
            else {}
        ),
        "left_out": report.left_out,
        **({"lost_steps": report.lost_steps} if report.lost_steps else {}),
    }
