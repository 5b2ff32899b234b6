"""One observation of a field: assign, move, look, correct; every move recorded before the next one."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypedDict, cast

from fiberloom.assignment import Assignment, AssignSettings, SwapSettings, assign_relaxed, swap_targets
from fiberloom.drive.way_rules import way_rule
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.pointing import OVERHEAD, ExposurePointing
from fiberloom.operation.exposures import ExposureLog
from fiberloom.operation.known import Known, Learning
from fiberloom.operation.loop import Loop, LoopSettings
from fiberloom.operation.motion import FieldMotion, MotionMaker, reported_deg
from fiberloom.operation.past.parts import record_begin, record_end, record_fibermap
from fiberloom.operation.recording import StoreRecorder
from fiberloom.operation.reference.referencing import reference
from fiberloom.operation.results import Observation, metrology_goals_mm
from fiberloom.operation.safety.loop_first import LoopFirst
from fiberloom.operation.safety.writing import beside, entered
from fiberloom.operation.series.guided import Guiding
from fiberloom.operation.series.steps import check_series, series_about, steps_of
from fiberloom.report.folder import point_latest, prepare_folder, set_aside
from fiberloom.report.outputs import marks
from fiberloom.store import Run, Store
from fiberloom.store.place import STORE as STORE
from fiberloom.store.place import Place
from fiberloom.store.run import RUNNING
from fiberloom.targets import TargetList
from fiberloom.typing import Floats

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
    images: int | None = None
    """After each move, at most; as many are taken as the noise of the camera asks for."""
    compare_linear: bool = False
    """Measure a blind move by a linear gear ratio too, at the end."""
    pages: str = "none"
    """Exposures that get pages: none, last or all."""
    save_images: bool = False
    """Keep every exposure as FITS."""
    seed: int = 0
    """Of assignment and planner."""
    pointing: ExposurePointing | None = None
    """Of the telescope, at the image and while light is collected; None: unknown, a twin's in the zenith."""
    strict: bool = False
    """No number of targets outweighs one of a higher priority."""
    swap: bool = False
    """Choose targets by the ways from where the positioners are; swap them where the motion is held up."""
    exposures: int = 1
    """Of a series on one field on the sky; between them fibres follow their targets."""

    def __post_init__(self) -> None:
        if self.corrections is not None and self.corrections < 0:
            raise InputError(f"corrections = {self.corrections}: must be 0 or more")
        if self.images is not None and self.images < 1:
            raise InputError(f"images = {self.images}: must be 1 or more")
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
            images=self.images or operation.images_max,
            seed=self.seed,
        )


class ObserveOptions(TypedDict, total=False):
    """What `Field.observe` takes beside targets, corrections and a folder."""

    correction: str | None
    images: int | None
    compare_linear: bool
    strict: bool
    swap: bool
    exposures: int
    arms: Path | str | None
    fibres: Path | str | None
    gravity: Path | str | None
    pointing: ExposurePointing | None
    learnt: str | None
    adapt: bool
    pages: str
    save_images: bool


def asked(
    corrections: int | None, options: ObserveOptions, seed: int, history: Path
) -> tuple[ObserveSettings, Learning]:
    """How to observe, and on what to build.

    `corrections`: exactly so many, None: by the stop rule; `options`: as `Field.observe` takes them; `seed`:
    of whatever is drawn; `history`: store of earlier observations. TypeError for an option that there is not.
    """
    unknown = sorted(set(options) - set(ObserveOptions.__annotations__))
    if unknown:
        raise TypeError(
            f"observe() has no option '{unknown[0]}': {', '.join(ObserveOptions.__annotations__)}"
        )
    how = {name: value for name, value in options.items() if name in ObserveSettings.__annotations__}
    settings = ObserveSettings(corrections=corrections, seed=seed, **cast("dict[str, Any]", how))
    files = options.get("arms"), options.get("fibres"), options.get("gravity"), options.get("learnt")
    return settings, Learning(*files, adapt=options.get("adapt", False), seed=seed, history=history)


@dataclass
class Observer:
    """Observes target lists with what is known of a field."""

    plane: FocalPlane
    """The layout as given: its hash marks the results."""
    known: Known
    """Arms and maps with which the observation begins."""
    place: Place
    """Where the store is, and the folders of result files."""
    command_line: str
    """For the store."""
    about: dict[str, Any] = field(default_factory=dict)
    """Further entries of summary.json."""
    watcher: Watcher = field(default_factory=Silent)
    keep: Callable[[Observation], None] = lambda _: None
    """Called with the observation when it has ended well; only then its run counts as finished."""
    motion: MotionMaker = FieldMotion
    """Of the field; a session gives its own."""
    begun_s: float | None = None
    """From when on `wall_s` counts, of time.monotonic; None: from the call of `observe`."""
    assigned: tuple[FocalPlane, Assignment] | None = None
    """Plane and assignment that were made before; None: they are made when it observes."""
    begun: Callable[[int], None] = lambda _: None
    """Called with the number of the run as it begins, before anything moves."""
    last: Observation | None = None
    """The last observation, also one that was interrupted."""
    folder: Path | None = None
    """Of its files; None before the first."""

    async def observe(
        self, targets: TargetList, settings: ObserveSettings, connect: Callable[[], Any]
    ) -> Observation:
        """Assigns targets, then moves the field to them by blind move and corrections.

        `targets`: positions in mm of the focal plane; `settings`: corrections, pages, seed; `connect`: a
        coroutine function that opens the hardware, called after the assignment; before it where targets are
        swapped, for which positioners are asked where they are. Raises InputError where
        no positioner answers or most fibres are not seen, UnsafePlanError where the verifier refuses a
        plan.
        """
        with LoopFirst():
            return await self._observe(targets, settings, connect)

    async def _observe(
        self, targets: TargetList, settings: ObserveSettings, connect: Callable[[], Any]
    ) -> Observation:
        check_series(targets, settings.exposures)
        begun_s = time.monotonic() if self.begun_s is None else self.begun_s
        self.watcher.say("assigning targets")
        if settings.swap:
            hardware = await connect()
            here_deg = await reported_deg(hardware, self.known.plane, self.known.maps)
            kept, assignment = await asyncio.to_thread(self._assigned, targets, settings, here_deg)
        else:
            kept, assignment = await asyncio.to_thread(self._assigned, targets, settings)
            hardware = await connect()
        targets = targets.settled(assignment.target, assignment.fibre)
        assignment = self.known.led(kept, assignment, settings.pointing)
        if hardware.telescope is not None:
            hardware.telescope.point((settings.pointing or OVERHEAD).image)
        async with (
            entered(Store.open, self.place.record) as store,
            entered(self._run, store, kept, settings.seed) as run,
        ):
            self.folder = await beside(_folder_of, run, self.place, store)
            await beside(self.begun, run.id)
            about = self._about(run, settings) | _sky_about(targets, assignment)
            await beside(record_begin, run, kept, targets, assignment, about)
            log = ExposureLog(self.plane, self.folder, settings.pages, settings.save_images)
            loop: Loop | None = None
            try:
                log.watch(hardware.camera)
                motion = self._motion(kept, targets, assignment, hardware, run)
                motion.pointing = settings.pointing
                log.follow(
                    lambda: motion.underway, metrology_goals_mm(kept, assignment), lambda: motion.compares
                )
                steps = steps_of(kept, assignment, targets, settings.exposures)
                guiding = Guiding.of(hardware.guider, targets.on_sky, kept, assignment)
                how = settings.loop(kept)
                loop = Loop(motion, assignment, how, self.known.map_sigma_deg, steps, guiding)
                await beside(self.known.record_used, run)
                await _whole(loop, about)
                about |= _series(targets, assignment, loop)
                await beside(self.known.record_learnt, run)
                await beside(log.close)
            finally:
                log.stop()
                figures = _moved(loop) | {
                    "about": about | self.known.summary() | _guided(loop, targets),
                    "wall_s": time.monotonic() - begun_s,
                }
                self.last = Observation(kept, targets, assignment, **figures)
                await beside(_record_end, run, figures, log)
            await beside(record_fibermap, run, self.last)
            await beside(self.keep, self.last)
        return self.last

    def _assigned(
        self, targets: TargetList, settings: ObserveSettings, here_deg: Floats | None = None
    ) -> tuple[FocalPlane, Assignment]:
        """The plane with the buffer that holds, and who takes what; `here_deg` (N, 2): where they are."""
        if self.assigned is not None:
            return self.assigned
        aims = self.known.aims(targets)
        how = AssignSettings(strict=settings.strict, ways=way_rule(self.known.plane, self.known.scatter))
        kept, found = assign_relaxed(
            self.known.plane, aims, seed=settings.seed, start_deg=here_deg, settings=how
        )
        if here_deg is None:
            return kept, found
        say = SwapSettings(progress=self.watcher.say)
        return kept, swap_targets(kept, aims, found, here_deg, seed=settings.seed, settings=say).assignment

    def _about(self, run: Run, settings: ObserveSettings) -> dict[str, Any]:
        known = {} if settings.pointing is None else {"pointing": settings.pointing.about()}
        return marks(self.plane, settings.seed) | {"run": run.id} | self.about | known

    def _run(self, store: Store, kept: FocalPlane, seed: int) -> Run:
        return store.start_run(
            command_line=self.command_line,
            instrument=kept.instrument.name,
            config_hash=kept.config_hash(),
            seed=seed,
            folder=self.place.pattern,
        )

    def _motion(
        self, kept: FocalPlane, targets: TargetList, assignment: Assignment, hardware: Hardware, run: Run
    ) -> FieldMotion:
        recorder = self.known.learning(StoreRecorder(run, kept, targets, assignment))
        return self.motion(kept, self.known.maps, hardware, recorder, self.watcher.say)


def _sky_about(targets: TargetList, assignment: Assignment) -> dict[str, Any]:
    """The field on the sky, and what an exposure does to the targets; nothing for a list in mm."""
    if targets.on_sky is None:
        return {}
    drift = targets.on_sky.drift_about(assignment.target, assignment.fibre)
    return {"sky": targets.on_sky.about() | drift}


def _series(targets: TargetList, assignment: Assignment, loop: Loop) -> dict[str, Any]:
    """How near the fibres were in each exposure of a series; nothing of a single one."""
    if targets.on_sky is None or len(loop.placed) < 2:
        return {}
    first_mm = targets.on_sky.places_mm(assignment.target, assignment.fibre)
    return {"series": series_about(targets.on_sky, assignment, loop.placed, first_mm, loop.correctable)}


def _guided(loop: Loop | None, targets: TargetList) -> dict[str, Any]:
    """What guide stars have told before each exposure; a note where there is nothing that looks at them."""
    if loop is not None and loop.guiding is not None:
        return {"guiding": loop.guiding.about()}
    if targets.on_sky is None or targets.on_sky.guides is None:
        return {}
    return {"guiding": []}


def _moved(loop: Loop | None) -> dict[str, Any]:
    """What an observation says of its moves."""
    if loop is None:
        return {"moves": [], "collisions_verified": 0, "stopped": ""}
    motion = loop.motion
    return {
        "moves": loop.moves,
        "collisions_verified": motion.collisions_verified,
        "contacts_true": motion.contacts_true,
        "stopped": loop.stopped,
    }


def _record_end(run: Run, figures: dict[str, Any], log: ExposureLog) -> None:
    """All but the moves, which are on record; where the store fails, that is told by what failed first."""
    own = {name: value for name, value in figures.items() if name != "moves"}
    with contextlib.suppress(InputError):
        record_end(run, **own, exposures=log.folder.exists())


def _folder_of(run: Run, place: Place, store: Store) -> Path:
    """The folder of a run, free of the results of others."""
    if not place.numbered:
        _alone(store, run, place.base)
    folder = prepare_folder(place.folder(run.id))
    set_aside(folder, run.id - 1)
    if place.numbered:
        point_latest(folder)
    return folder


def _alone(store: Store, run: Run, out: Path) -> None:
    """Raises InputError where an earlier run of this folder goes on: its results and these would mix."""
    for other in store.runs(RUNNING):
        if other.status == RUNNING and other.id < run.id:
            raise InputError(
                f"--out {out}: run {other.id}, begun on {other.host} at {other.utc_start:%H:%M:%S} UTC, "
                "still writes there; wait for its end, or choose another folder"
            )


async def _whole(loop: Loop, about: dict[str, Any]) -> None:
    try:
        await loop.motion.connect()
        if referenced := await reference(loop.motion):
            about["referenced"] = referenced.as_dict()
        await loop.run()
    finally:
        await loop.motion.close()
