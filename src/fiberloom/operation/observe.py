"""One observation of a field: assign, move, look, correct; every move recorded before the next one."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from fiberloom.assignment import Assignment, assign_relaxed
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.operation.exposures import ExposureLog
from fiberloom.operation.known import Known
from fiberloom.operation.loop import Loop, LoopSettings
from fiberloom.operation.motion import FieldMotion, MotionMaker
from fiberloom.operation.recording import StoreRecorder
from fiberloom.operation.results import Observation, metrology_goals_mm
from fiberloom.operation.safety.writing import beside, entered
from fiberloom.report.folder import set_aside
from fiberloom.report.outputs import marks
from fiberloom.store import Run, Store
from fiberloom.store.run import RUNNING
from fiberloom.targets import TargetList

STORE = "store.sqlite"
"""Name of the store in the folder of an observation."""

CORRECTIONS = ("filtered", "plain")
PAGES = ("none", "last", "all")


class Watcher(Protocol):
    """Shows the progress of an observation."""

    def say(self, text: str) -> None:
        """Called when a step begins, with its name."""
        ...

    def count(self, done: int, total: int) -> None:
        """Called when a part of the step is done: `done` of `total`."""
        ...


class Silent:
    """A watcher without output."""

    def say(self, text: str) -> None:
        """Nothing."""

    def count(self, done: int, total: int) -> None:
        """Nothing."""


@dataclass(frozen=True)
class ObserveSettings:
    """How to observe; None: as the instrument says."""

    corrections: int | None = None
    """Moves after the blind one, exactly so many; None: the instrument's stop rule."""
    correction: str | None = None
    """filtered (a Kalman filter) or plain (Eq. 25)."""
    compare_linear: bool = False
    """Measure a blind move by a linear gear ratio too, at the end."""
    pages: str = "none"
    """Exposures that get pages: none, last or all."""
    save_images: bool = False
    """Keep every exposure as FITS."""
    seed: int = 0
    """Of assignment and planner."""

    def __post_init__(self) -> None:
        if self.corrections is not None and self.corrections < 0:
            raise InputError(f"corrections = {self.corrections}: must be 0 or more")
        for name, value, known in (
            ("correction", self.correction, (None, *CORRECTIONS)),
            ("pages", self.pages, PAGES),
        ):
            if value not in known:
                raise InputError(f"{name} {value!r}: known are {', '.join(filter(None, known))}")

    def loop(self, plane: FocalPlane) -> LoopSettings:
        """Settings of the loop, with the instrument's values for what is None."""
        operation = plane.instrument.operation
        return LoopSettings.of(
            operation,
            None if self.corrections is None else 1 + self.corrections,
            filtered=(self.correction or operation.correction) == "filtered",
            compare_linear=self.compare_linear,
            seed=self.seed,
        )


@dataclass
class Observer:
    """Observes target lists with what is known of a field."""

    plane: FocalPlane
    """The layout as given: its hash marks the results."""
    known: Known
    """Arms and maps with which the observation begins."""
    out: Path
    """Folder that exists, for the store and the pages of exposures."""
    command_line: str
    """For the store."""
    about: dict[str, Any] = field(default_factory=dict)
    """Further entries of summary.json."""
    watcher: Watcher = field(default_factory=Silent)
    keep: Callable[[Observation], None] = lambda _: None
    """Called with the observation when it has ended well; only then its run counts as finished."""
    motion: MotionMaker = FieldMotion
    """Of the field; a session gives its own."""
    last: Observation | None = None
    """The last observation, also one that was interrupted."""

    async def observe(
        self, targets: TargetList, settings: ObserveSettings, connect: Callable[[], Any]
    ) -> Observation:
        """Assigns targets, then moves the field to them by blind move and corrections.

        `targets`: positions in mm of the focal plane; `settings`: corrections, pages, seed; `connect`: a
        coroutine function that opens the hardware, called after the assignment. Raises InputError where
        no positioner answers or most fibres are not seen, UnsafePlanError where the verifier refuses a
        plan.
        """
        begun_s = time.monotonic()
        self.watcher.say("assigning targets")
        kept, assignment = await asyncio.to_thread(
            assign_relaxed, self.known.plane, targets, seed=settings.seed
        )
        hardware = await connect()
        async with (
            entered(Store.open, self.out / STORE) as store,
            entered(self._run, store, kept, settings.seed) as run,
        ):
            await beside(self._alone, store, run)
            log = ExposureLog(self.plane, self.out, settings.pages, settings.save_images)
            loop: Loop | None = None
            try:
                log.watch(hardware.camera)
                motion = self._motion(kept, targets, assignment, hardware, run)
                log.follow(lambda: motion.underway, metrology_goals_mm(kept, assignment))
                loop = Loop(motion, assignment, settings.loop(kept), self.known.map_sigma_deg)
                await beside(self.known.record_used, run)
                await _whole(loop)
                await beside(self.known.record_learnt, run)
                await beside(log.close)
            finally:
                log.stop()
                about = marks(self.plane, settings.seed) | {"run": run.id} | self.about | self.known.summary()
                wall_s = time.monotonic() - begun_s
                self.last = Observation(kept, targets, assignment, about=about, wall_s=wall_s, **_moved(loop))
            await beside(self.keep, self.last)
        return self.last

    def _run(self, store: Store, kept: FocalPlane, seed: int) -> Run:
        return store.start_run(
            command_line=self.command_line,
            instrument=kept.instrument.name,
            config_hash=kept.config_hash(),
            seed=seed,
        )

    def _alone(self, store: Store, run: Run) -> None:
        """Moves results of earlier runs aside. InputError where one goes on: its results and these would
        mix."""
        for other in store.runs(RUNNING):
            if other.status == RUNNING and other.id < run.id:
                raise InputError(
                    f"--out {self.out}: run {other.id}, begun on {other.host} at "
                    f"{other.utc_start:%H:%M:%S} UTC, still writes there; wait for its end, or choose "
                    "another folder"
                )
        set_aside(self.out, run.id - 1)

    def _motion(
        self, kept: FocalPlane, targets: TargetList, assignment: Assignment, hardware: Hardware, run: Run
    ) -> FieldMotion:
        recorder = self.known.learning(StoreRecorder(run, kept, targets, assignment))
        return self.motion(kept, self.known.maps, hardware, recorder, self.watcher.say)


def _moved(loop: Loop | None) -> dict[str, Any]:
    """What an observation says of its moves."""
    if loop is None:
        return {"moves": [], "collisions_verified": 0, "stopped": ""}
    verified = loop.motion.collisions_verified
    return {"moves": loop.moves, "collisions_verified": verified, "stopped": loop.stopped}


async def _whole(loop: Loop) -> None:
    try:
        await loop.motion.connect()
        await loop.run()
    finally:
        await loop.motion.close()
