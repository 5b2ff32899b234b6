"""What a night is made of: the array as it is known, its queue, its folder, its clock and its shutter."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.assignment import Assignment, AssignSettings, assign_relaxed
from fiberloom.drive.port import Drive
from fiberloom.drive.sdssv import SdssvDrive
from fiberloom.drive.way_rules import way_rule
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.night.asked.control import NightControl
from fiberloom.night.asked.orders import QueueOrders
from fiberloom.night.clock import BusClock, NightClock, WorldClock
from fiberloom.night.queue import FieldEntry, Queue, read_queue
from fiberloom.night.shutter import Shutter, TimedShutter
from fiberloom.night.step import Position
from fiberloom.operation.known import Known
from fiberloom.operation.safety.stop import to_its_end
from fiberloom.operation.series.goals import targets_at
from fiberloom.operation.series.steps import followed
from fiberloom.operation.session.session import KnownArray
from fiberloom.operation.session.witness import Witness
from fiberloom.operation.source import LeftOpen, Source
from fiberloom.sky.sky_field import SkyField
from fiberloom.store.nights.book import NightBook
from fiberloom.targets import TargetList, read_targets
from fiberloom.targets.read import read_sky
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

ShutterMaker = Callable[["NightSetup", NightBook, NightClock], Shutter]


def timed_shutter(setup: NightSetup, book: NightBook, clock: NightClock) -> Shutter:
    """A timer that keeps its log in the folder of the night: of `setup`, `book` and `clock`."""
    folder = setup.folder(book.id)
    folder.mkdir(parents=True, exist_ok=True)
    return TimedShutter(folder / "exposures.jsonl", clock)


@dataclass(frozen=True, eq=False)
class Assigned:
    """A place of a field, and which positioner takes which target there."""

    step: Position
    entry: FieldEntry
    """As the queue had it."""
    targets: TargetList
    """In mm; of a field on the sky for the middle of its exposures."""
    plane: FocalPlane
    """With the collision buffer that holds."""
    assignment: Assignment


@dataclass
class NightSetup:
    """What a night is made of."""

    known: Known
    """Layout and maps."""
    array: KnownArray
    """The same, with its bus and what is on record of it."""
    queue_file: Path
    out: Path
    """Folder of store, runs and nights."""
    command_line: str
    database: str = field(default="", kw_only=True)
    """URL of the store; empty: it is a file in the folder."""
    seed: int = 0
    exclude: tuple[int, ...] = ()
    virtual: bool = False
    """The time is that of the bus."""
    reborn: bool = True
    """The time of the bus begins anew with each process."""
    shutter: ShutterMaker = timed_shutter
    witness: Witness | None = None
    """Told of moves while they are made."""
    control: NightControl = field(default_factory=NightControl)
    begun: Callable[[Any], None] = lambda _: None
    """Called with the `NightRunner` before its first step."""

    @property
    def source(self) -> Source:
        """Where bus and camera come from."""
        return self.array.source

    def folder(self, night: int) -> Path:
        """Of the files of a night, by its number."""
        return self.out / f"night-{night:04d}"

    def read_queue(self) -> Queue:
        """As it is now."""
        return read_queue(self.queue_file)

    def queue_of(self, book: NightBook) -> Queue:
        """As it is now, with what people have changed of it in the night of this `book`."""
        return QueueOrders.of(book.commands()).applied(self.read_queue())

    def clock(self, drive: Drive, queue: Queue, last: datetime | None) -> NightClock:
        """The clock of a night.

        `drive`: whose bus tells the time, where it is virtual; `queue`: says when it begins; `last`: the
        latest time on record of a night that goes on.
        """
        if not self.virtual:
            return WorldClock()
        zero = queue.begin or (last or datetime.now(UTC))
        if last is not None and self.reborn:
            zero = last
        return BusClock(zero - timedelta(seconds=drive.time_s if self.reborn else 0.0), drive)

    @asynccontextmanager
    async def opened(self) -> AsyncIterator[Hardware]:
        """Bus and camera; a bus that carries frames stays open from one visit to the next."""
        hardware = await self.source.open()
        transport = hardware.transport
        try:
            yield hardware if transport is None else replace(hardware, transport=LeftOpen(transport))
        finally:
            if transport is not None:
                await to_its_end(transport.close())

    def drive(self, hardware: Hardware) -> Drive:
        """The motors of `hardware`, to wait with before anything was moved."""
        return hardware.drive or SdssvDrive(self.known.plane, self.known.maps, hardware.bus)

    # fields

    def targets(self, entry: FieldEntry, dither: int, begin: datetime, done: int = 0) -> TargetList:
        """Targets of the field of an `entry`, moved by its `dither`; mm. InputError names the file.

        Of a field on the sky: for the middle of the exposures of one place, which `begin` then; so many of
        them are `done`.
        """
        shift_mm = np.array(entry.dithers_um[dither]) / UM_PER_MM
        found = self._listed(entry, begin, (entry.exposures - done) * entry.exposure_s)
        return found.moved(shift_mm) if shift_mm.any() else found

    def _listed(self, entry: FieldEntry, begin: datetime, shutter_s: float) -> TargetList:
        if entry.field is None:
            return read_targets(entry.targets, None, self.known.plane.instrument)
        stars, field = read_sky(entry.targets)[0], SkyField.read(entry.field)
        return targets_at(stars, field, self.known.plane, begin, shutter_s)

    def assign(self, targets: TargetList) -> tuple[FocalPlane, Assignment]:
        """Which positioner takes which of the `targets`, as an observation would."""
        how = AssignSettings(ways=way_rule(self.known.plane, self.known.scatter))
        return assign_relaxed(self.known.plane, self.known.aims(targets), seed=self.seed, settings=how)

    def assigned(
        self,
        step: Position,
        entry: FieldEntry,
        begin: datetime,
        before: Assigned | None = None,
        done: int = 0,
    ) -> Assigned:
        """What a `step` to its field, `entry`, assigns; `before`: the place that the fibres are on.

        Its exposures `begin` then; so many of them are `done`. From one dither of a field to the next every
        fibre keeps its target.
        """
        targets = self.targets(entry, step.dither, begin, done)
        if before is None or not _goes_on(before, step, entry, targets):
            return Assigned(step, entry, targets, *self.assign(targets))
        kept = before.assignment
        shift_mm = _taken_mm(targets, kept) - _taken_mm(before.targets, kept)
        goal_deg = followed(before.plane, kept, shift_mm)
        moved = replace(kept, alpha_deg=goal_deg[:, 0], beta_deg=goal_deg[:, 1])
        return Assigned(step, entry, targets, before.plane, moved)


def _goes_on(before: Assigned, step: Position, entry: FieldEntry, targets: TargetList) -> bool:
    """The same field with the same list."""
    same = (before.step.field, before.entry) == (step.field, entry)
    return same and np.array_equal(before.targets.target_id, targets.target_id)


def _taken_mm(targets: TargetList, assignment: Assignment) -> Floats:
    """(N, 2) mm the place of each positioner's target for the fibre that takes it; 0 without a target."""
    has = assignment.target >= 0
    xy_mm = np.zeros((len(has), 2))
    xy_mm[has] = targets.settled(assignment.target, assignment.fibre).xy_mm[assignment.target[has]]
    return xy_mm
