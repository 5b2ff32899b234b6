"""A night as it is carried out: one step after the other, each on record before it is taken.

What was done is read from the store before each step, so that a process that goes on after a crash does the
same as one that was never away.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Any

from fiberloom.drive.sdssv import SdssvDrive
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.health.status import FibreStatus
from fiberloom.instruments import FocalPlane
from fiberloom.metrology.sources.errors import CameraError
from fiberloom.night.clock import BusClock, NightClock
from fiberloom.night.on_record import last_time, shortfall, state_of
from fiberloom.night.overhead import learned_s
from fiberloom.night.queue import FieldEntry
from fiberloom.night.setup import Assigned, NightSetup
from fiberloom.night.shutter import Shutter
from fiberloom.night.stages import NightStage, RefusedError, StageRunner, StepWatcher
from fiberloom.night.step import (
    OVER,
    Close,
    End,
    Expose,
    NightState,
    Park,
    Pause,
    Position,
    Step,
    VisitState,
    Wait,
    as_asked,
    field_states,
    next_step,
)
from fiberloom.operation.motion import FieldMotion, UnsafePlanError
from fiberloom.operation.move import Goals, Recorder
from fiberloom.operation.observe import Observer, ObserveSettings
from fiberloom.operation.recording import SurveyRecorder, digest_of
from fiberloom.operation.reference.declare import declare_seen_right
from fiberloom.operation.results import Observation
from fiberloom.operation.safety.memory import give_back
from fiberloom.operation.safety.stop import reason
from fiberloom.operation.safety.writing import beside, entered
from fiberloom.operation.series.ahead import PlannedAhead
from fiberloom.operation.session.motion import SessionMotion
from fiberloom.operation.session.recover import Recovery
from fiberloom.operation.session.session import HeldArray, fold
from fiberloom.operation.session.states import SessionState
from fiberloom.operation.session.states import Step as ArrayStep
from fiberloom.store.nights.book import NightBook
from fiberloom.store.nights.records import ExposureRecord, VisitRecord
from fiberloom.store.place import NUMBERED, Place
from fiberloom.store.run import Run
from fiberloom.store.service.alarms import Severity
from fiberloom.typing import Flags

FAILURES = (InputError, CameraError, UnsafePlanError, TimeoutError, RefusedError)
"""With these a visit has failed, and the night goes on."""

MOST_WAIT_S = 60.0
"""At once, so that the queue is read again."""

SHUTTER_SLACK_S = 60.0
"""By which an exposure may last longer than it should."""

RECOVERIES = 3
"""Of an array, one after the other, before a person has to come."""


PAUSE_LOOK_S = 1.0
LONGEST_PAUSE_S = 86400.0
DAWN_IN_PAUSE = "it is dawn, and the night is paused by {}: the array is not parked; go on, or park"


POSITIONER, LEFT_OUT = "positioner ", "left out"
APART = "a collision: the arms were moved apart, and folded"
MOST_COLLISIONS = 2
"""Of one positioner, in one night, before it is left where it is."""
STAYS = "has collided or was dead twice: it stays where it is for this night; exclude it or home it"


class NightStoppedError(RuntimeError):
    """The night cannot go on without a person."""


@dataclass
class Ahead:
    """The next place of a field, assigned and planned while the shutter was open."""

    assigned: Assigned
    plan: PlannedAhead | None = None


class NightRunner:
    """Carries out one night on an array that it holds."""

    def __init__(
        self,
        setup: NightSetup,
        book: NightBook,
        held: HeldArray,
        hardware: Hardware,
        progress: Callable[[str], None],
    ) -> None:
        """`setup`: what it is made of; `book`: its record; `held`: the array; `hardware`: its bus and camera;
        `progress`: called with the name of each step."""
        self.setup, self.book, self.held, self.hardware = setup, book, held, hardware
        self.queue = setup.queue_of(book)
        self.control = setup.control
        drive = setup.drive(hardware)
        self.clock: NightClock = setup.clock(drive, self.queue, last_time(book))
        self.shutter: Shutter = setup.shutter(setup, book, self.clock)
        self.stages = StageRunner(book, self.clock, progress)
        self.progress = progress
        self.motion: FieldMotion | None = None
        self.ahead: Ahead | None = None
        self.assigned: Assigned | None = None
        """Of the last place whose fibres were on target."""
        self.parked = False
        self.recoveries = 0
        self.left_out: set[int] = set()
        """Positioners that stay where they are for the rest of the night."""
        self._leave_out()

    async def run(self) -> str:
        """Carries out the queue; returns why the night is over."""
        await self.settle()
        while True:
            await beside(self._reread)
            state = await beside(self._state)
            step = next_step(state, self.queue, self.clock.now())
            await beside(self._note_fields, state)
            step = as_asked(step, state, self.control.paused_by, self.control.parked_by)
            if isinstance(step, End):
                return step.why
            if isinstance(step, (Position, Wait, Pause)):  # no exposure: the shutter is another's
                await self.control.run(self._take(step))
            else:
                await self._take(step)

    async def _take(self, step: Step) -> None:
        if isinstance(step, Position):
            await self._position(step)
        elif isinstance(step, Expose):
            await self._expose(step)
        elif isinstance(step, Close):
            await beside(self._close, step)
        elif isinstance(step, Park):
            await self._park()
        elif isinstance(step, Wait):
            await self._wait(step)
        elif isinstance(step, Pause):
            await self._pause(step)

    # what is known

    def _reread(self) -> None:
        """The queue as it is now; one that cannot be read is told, and the last good one is kept."""
        try:
            self.queue = self.setup.queue_of(self.book)
        except InputError as error:
            self._alarm(
                "queue", Severity.MINOR, str(self.setup.queue_file), f"{error}; the last good one is used"
            )
            return
        self.book.clear_alarm(self.clock.now(), "queue", str(self.setup.queue_file))

    def _state(self) -> NightState:
        return state_of(self.book, self.queue.require, self.parked)

    def _note_fields(self, state: NightState) -> None:
        known = {field.name: (field.entry, field.state, field.reason) for field in self.book.fields()}
        for name, (what, why) in field_states(state, self.queue, self.clock.now()).items():
            entry = self.queue.entry(name)
            said = (entry.as_json if entry is not None else "", what.value, why)
            if known.get(name) != said:
                self.book.note_field(name, *said)

    def _alarm(self, code: str, severity: Severity, subject: str, text: str) -> None:
        self.progress(f"{severity.value}: {text}")
        self.book.raise_alarm(self.clock.now(), code, severity, subject, text)

    # after a crash

    async def settle(self) -> None:
        """Books how exposures have ended that a process before has left, and what became of their visits.

        Nothing moves and no lamp is lit before every shutter is closed.
        """
        for exposure in await beside(self.book.exposures):
            if exposure.utc_end is None:  # also of a visit that is over: its shutter has not closed in time
                await self._settle_exposure(exposure)
        for visit in await beside(self.book.visits):
            if VisitState(visit.state) not in OVER:
                await beside(self._settle_visit, visit)

    async def _settle_exposure(self, exposure: ExposureRecord) -> None:
        if (await self.shutter.seen(exposure.key)).start is None:
            return  # it was asked for at most: it is asked for anew
        self.progress("waiting for an exposure that was begun before")
        await self._until_closed(exposure.key, exposure.id, exposure.asked_s)

    def _settle_visit(self, visit: VisitRecord) -> None:
        entry, state = self.queue.entry(visit.field), self._state()
        (known,) = (
            v for v, record in zip(state.visits, self.book.visits(), strict=True) if record.id == visit.id
        )
        whole = entry is not None and state.made(known) >= entry.exposures
        over = (VisitState.FAILED if known.short else VisitState.DONE) if whole else VisitState.INTERRUPTED
        self.book.change_visit(visit.id, state=over.value, utc_end=self.clock.now(), note="interrupted")

    # positioning

    async def _position(self, step: Position) -> None:
        entry = self.queue.entry(step.field)
        assert entry is not None
        visit = await beside(self._begin_visit, step)
        seen: list[Observation] = []
        ahead = self._taken_ahead(step, entry)
        watcher = StepWatcher(self.stages, visit, "position")
        stage = NightStage(
            "position",
            lambda: self._observe(step, entry, visit, watcher, ahead, seen),
            self.queue.stage_timeout_s,
            lambda: self.held.lock.forbidden,
            watcher.close,
        )
        self.progress(f"field {step.field}, repeat {step.repeat + 1}, dither {step.dither + 1}")
        try:
            await self.stages.run(stage, visit)
        except FAILURES as error:
            await self._failed(visit, step, reason(error))
            return
        except BaseException:
            await beside(self._over, visit, VisitState.INTERRUPTED, "stopped")
            raise
        await beside(self._ready, visit, step, seen[-1], ahead)
        if await self._settled():  # the fibres are off target by now
            await beside(self._over, visit, VisitState.INTERRUPTED, APART)
        else:
            self.recoveries = 0

    def _begin_visit(self, step: Position) -> int:
        attempt = 1 + sum(v.part == step.part for v in self._state().visits)
        which = {"field": step.field, "repeat": step.repeat, "dither": step.dither, "attempt": attempt}
        self.parked = False
        return self.book.begin_visit(self.clock.now(), VisitState.POSITIONING.value, which)

    def _taken_ahead(self, step: Position, entry: FieldEntry) -> Ahead | None:
        """What was made ahead, if it was for this place as it is now; it is used once."""
        ahead, self.ahead = self.ahead, None
        if ahead is None or (ahead.assigned.step, ahead.assigned.entry) != (step, entry):
            return None
        return ahead

    async def _observe(
        self,
        step: Position,
        entry: FieldEntry,
        visit: int,
        watcher: StepWatcher,
        ahead: Ahead | None,
        seen: list[Observation],
    ) -> None:
        setup = self.setup
        if ahead is None:
            watcher.say("assigning targets")
            made = await self._assign(step, entry, self.clock.now())
        else:
            made = ahead.assigned
        observer = Observer(
            setup.known.plane,
            setup.known,
            Place(setup.out, NUMBERED, setup.database),
            setup.command_line,
            setup.source.about() | {"night": self.book.id, "visit": visit},
            watcher,
            motion=self._maker(watcher, ahead),
            assigned=(made.plane, made.assignment),
            begun=lambda run: self.book.change_visit(visit, run_id=run),
        )
        settings = ObserveSettings(corrections=entry.corrections, seed=setup.seed)
        seen.append(await observer.observe(made.targets, settings, self._connect))
        self.assigned = made

    async def _assign(self, step: Position, entry: FieldEntry, begin: datetime) -> Assigned:
        """What a `step` assigns that is to `begin` then: for the exposures that are left."""
        ready = begin + await beside(self._until_ready, step)
        done = (await beside(self._state)).exposed(step.part)
        return await asyncio.to_thread(self.setup.assigned, step, entry, ready, self.assigned, done)

    async def _connect(self) -> Hardware:
        """The bus that is open; motors of another kind are opened anew."""
        if self.hardware.transport is None:
            self.hardware = await self.setup.source.open()
        return self.hardware

    def _maker(self, watcher: StepWatcher, ahead: Ahead | None) -> Callable[..., FieldMotion]:
        def make(
            plane: FocalPlane, maps: Any, hardware: Hardware, recorder: Recorder, say: Callable[[str], None]
        ) -> FieldMotion:
            self.motion = self.held.motion(plane, maps, hardware, recorder, say)
            self.motion.ahead = None if ahead is None else ahead.plan
            self._follow(self.motion)
            watcher.say("begin check")
            return self.motion

        return make

    def _follow(self, motion: FieldMotion) -> None:
        """The clock waits on the bus of the motion, which has to be heard while it lasts."""
        if isinstance(self.clock, BusClock):
            self.clock.bus = motion.drive

    def _ready(self, visit: int, step: Position, seen: Observation, ahead: Ahead | None) -> None:
        summary, last = seen.summary(), seen.final
        planned = "" if ahead is None or ahead.plan is None else ahead.plan.told
        figures = {
            "run_id": seen.about["run"],
            "plan_digest": digest_of(seen.moves[0].plan),
            "plan_from": planned or "planned now",
            # as the images say: of a real array nothing else is known, and the page's picture has the same
            "on_target": last.status.count(FibreStatus.ON_TARGET),
            "assigned": summary["n_assigned"],
            "rms_um": summary["moves"][-1]["measured_rms_um"],
        }
        self.book.change_visit(visit, state=VisitState.READY.value, **figures)
        if last.interrupted:
            self._alarm(
                "cut short", Severity.MINOR, f"visit {visit}", "not all positioners are at their goals"
            )
        if short := shortfall(figures["on_target"], figures["assigned"], self.queue.require):
            self._alarm("on target", Severity.MINOR, f"field {step.field}", short)
        self._alarms_of(seen.about["run"])

    def _alarms_of(self, run: int) -> None:
        """What a run has told an operator becomes an alarm of the night."""
        events = self.book.store.events(run)
        for kind, text, positioner in zip(
            events["kind"].tolist(), events["text"].tolist(), events["positioner_id"].tolist(), strict=True
        ):
            if kind in ALARMING:
                known = positioner == positioner
                self._alarm(kind, ALARMING[kind], f"positioner {int(positioner)}" if known else "array", text)

    async def _failed(self, visit: int, step: Position, why: str) -> None:
        await beside(self._over, visit, VisitState.FAILED, why)
        await beside(self._alarm, "visit", Severity.MAJOR, f"field {step.field}", why)
        await beside(self._alarms_of_visit, visit)
        await beside(self.held.leave, ArrayStep.LOSE, why)
        await self._settled()

    def _alarms_of_visit(self, visit: int) -> None:
        """What a visit that has failed has told until then."""
        run = next(v.run_id for v in self.book.visits() if v.id == visit)
        if run is not None:
            self._alarms_of(run)

    def _over(self, visit: int, state: VisitState, note: str) -> None:
        self.book.change_visit(visit, state=state.value, utc_end=self.clock.now(), note=note)

    async def _settled(self) -> bool:
        """The array is at rest; where arms touch they are moved apart, three times in a row at most.

        Whether they were.
        """
        await beside(self.held.settle)
        before = self.recoveries
        while self.held.lock.state is SessionState.LOCKED:
            self.recoveries += 1
            why = self.held.lock.text
            await beside(self._note_collision, why)
            if self.recoveries > RECOVERIES:
                raise NightStoppedError(f"{why}; `fiberloom recover`, then `fiberloom night --resume`")
            stage = NightStage("recover", self._recover, self.queue.stage_timeout_s)
            try:
                await self.stages.run(stage)
            except FAILURES as error:
                await beside(self.held.leave, ArrayStep.LOSE, reason(error))
            await beside(self.held.settle)
        await beside(self._leave_out)
        return self.recoveries > before

    def _note_collision(self, why: str) -> None:
        subjects = [f"{POSITIONER}{number}" for number in self.held.collided] or ["array"]
        for subject in subjects:
            self._alarm("collision", Severity.CRITICAL, subject, why)

    def _leave_out(self) -> None:
        """Who has collided or was dead twice stays where it is for the rest of the night, also if resumed."""
        alarms = [a for a in self.book.alarms() if a.subject.startswith(POSITIONER)]
        told = {a.subject for a in alarms if a.code == LEFT_OUT}
        now = {a.subject for a in alarms if a.code in ("collision", "dead") and a.count >= MOST_COLLISIONS}
        for subject in sorted(now - told):
            self._alarm(LEFT_OUT, Severity.MAJOR, subject, STAYS)
        numbers = {int(subject.removeprefix(POSITIONER)) for subject in now | told}
        if numbers - self.left_out:
            self.left_out, self.ahead, self.assigned = numbers, None, None
            self.setup.known.plane = self.setup.array.excluded_plane({*self.setup.exclude, *numbers})

    async def _recover(self) -> None:
        async with self._plain_motion() as motion:
            if await Recovery(motion).run():
                await fold(motion)

    def _start_run(self) -> Run:
        plane = self.setup.known.plane
        return self.book.store.start_run(
            command_line=self.setup.command_line,
            instrument=plane.instrument.name,
            config_hash=plane.config_hash(),
            seed=self.setup.seed,
        )

    @asynccontextmanager
    async def _plain_motion(self) -> AsyncIterator[SessionMotion]:
        """A motion without targets, after its begin check, in a run of its own."""
        known, hardware = self.setup.known, await self._connect()
        async with entered(self._start_run) as run:
            recorder = SurveyRecorder(run, known.plane)
            motion = self.held.motion(known.plane, known.maps, hardware, recorder, self.progress)
            self._follow(motion)
            try:
                await motion.connect()
                yield motion
            finally:
                await motion.close()

    # exposing

    async def _expose(self, step: Expose) -> None:
        visit = (await beside(self.book.visits))[-1]
        entry = self.queue.entry(visit.field)
        assert entry is not None
        stage = NightStage(
            f"expose {step.number}",
            lambda: self._exposed(visit, entry, step.number),
            entry.exposure_s + SHUTTER_SLACK_S,
        )
        try:
            await self.stages.run(stage, visit.id)
        except TimeoutError as error:
            why = f"the shutter: {error}"
            await beside(self._over, visit.id, VisitState.FAILED, why)
            await beside(self._alarm, "shutter", Severity.MAJOR, f"field {visit.field}", why)
            raise NightStoppedError(
                f"{why}; see that it is closed, then `fiberloom night --resume`"
            ) from None

    async def _exposed(self, visit: VisitRecord, entry: FieldEntry, number: int) -> None:
        tries = sum(e.visit_id == visit.id for e in await beside(self.book.exposures))
        key = f"night {self.book.id} visit {visit.id} exposure {number}.{tries + 1}"
        await beside(self._begin_exposing, visit.id)
        exposure = await beside(self.book.ask_exposure, visit.id, number, key, entry.exposure_s)
        self.held.lock.forbidden = "the shutter is open"
        end = self.clock.now() + timedelta(seconds=entry.exposure_s)
        await self.shutter.start(key, entry.exposure_s)
        planning = asyncio.create_task(self._while_open(end))
        try:
            await self._until_closed(key, exposure, entry.exposure_s)
            self.held.lock.forbidden = ""
        finally:
            # what is not ready by now is of use still: it would be made now
            await asyncio.wait({planning})
        with contextlib.suppress(*FAILURES):
            self.ahead = planning.result()

    def _begin_exposing(self, visit: int) -> None:
        self.book.change_visit(visit, state=VisitState.EXPOSING.value)

    async def _until_closed(self, key: str, exposure: int, asked_s: float) -> None:
        """Waits until the shutter is closed; both its times are on record as soon as they are known."""
        noted = False
        while True:
            seen = await self.shutter.seen(key)
            if seen.start is not None and not noted:
                await beside(self._note_exposure, exposure, "utc_start", seen.start)
                noted = True
            if seen.end is not None:
                await beside(self._note_exposure, exposure, "utc_end", seen.end)
                return
            await self.clock.sleep(_left_s(seen.start, asked_s, self.clock.now()))

    def _note_exposure(self, exposure: int, what: str, when: datetime) -> None:
        self.book.change_exposure(exposure, **{what: when})

    async def _while_open(self, end: datetime) -> Ahead | None:
        """What is made ahead; then the memory that positioning and planning have left is given back."""
        try:
            return await self._plan_ahead(end)
        finally:
            await beside(give_back)

    async def _plan_ahead(self, end: datetime) -> Ahead | None:
        """Assigns and plans what comes after this exposure, which will `end` then; nothing moves."""
        state = await beside(self._state)
        exposed = replace(state.visits[-1], exposed=state.visits[-1].exposed + 1)
        step = next_step(state.with_last(exposed), self.queue, end)
        if isinstance(step, Close):
            step = next_step(state.with_last(replace(exposed, state=step.state)), self.queue, end)
        if not isinstance(step, Position):
            return None
        wanted = self.queue.entry(step.field)
        assert wanted is not None
        made = await self._assign(step, wanted, end)
        return Ahead(made, await self._planned(made))

    def _until_ready(self, step: Position) -> timedelta:
        """From the begin of a `step` to its first exposure, as it took before; else as the queue says."""
        dithered = self.assigned is not None and self.assigned.step.field == step.field
        known_s = learned_s(self.book, dithered)
        return timedelta(seconds=self.queue.overhead_s if known_s is None else known_s)

    async def _planned(self, made: Assigned) -> PlannedAhead | None:
        motion = self.motion
        if motion is None or made.plane.collision_buffer_mm != motion.plane.collision_buffer_mm:
            return None
        if not isinstance(motion.drive, SdssvDrive):  # others make a way of their own to where a plan ends
            return None
        goals = Goals.of(self.setup.known.led(made.plane, made.assignment, None))
        mobile: Flags = motion.state.mobile
        wanted = motion.wanted(goals, goals.angles_deg, mobile, self.setup.seed)
        programme = await motion.drive.prepare(wanted)
        return PlannedAhead(programme.plan, wanted.here_deg.copy(), wanted.goal_deg.copy())

    # the rest

    def _close(self, step: Close) -> None:
        visit, short = self.book.visits()[-1], self._state().visits[-1].short
        self._over(visit.id, step.state, step.why)
        if (
            step.why and step.state is not VisitState.INTERRUPTED and not short
        ):  # that was told as it was seen
            self._alarm("visit", Severity.MINOR, f"field {visit.field}", step.why)

    async def _wait(self, step: Wait) -> None:
        left_s = (step.until - self.clock.now()).total_seconds()
        stage = NightStage("wait", lambda: self.clock.sleep(min(left_s, MOST_WAIT_S)), 2.0 * MOST_WAIT_S)
        await self.stages.run(stage)

    async def _pause(self, step: Pause) -> None:
        """Until an operator lets it go on, also at dawn: a person may be at the instrument."""

        async def waiting() -> None:
            told, text = False, DAWN_IN_PAUSE.format(step.who)
            while self.control.paused_by:
                await self.clock.sleep(PAUSE_LOOK_S)
                if not told and self.clock.now() >= self.queue.dawn:
                    told = True
                    await beside(self._alarm, "paused", Severity.MAJOR, "night", text)

        await self.stages.run(NightStage("pause", waiting, LONGEST_PAUSE_S))

    async def _park(self) -> None:
        try:
            stage = NightStage(
                "park", self._fold, self.queue.stage_timeout_s, lambda: self.held.lock.forbidden
            )
            await self.stages.run(stage)
        except FAILURES as error:
            await beside(self._alarm, "park", Severity.MAJOR, "array", reason(error))
            await beside(self.held.leave, ArrayStep.LOSE, reason(error))
            raise NightStoppedError(f"the array is not parked: {reason(error)}; `fiberloom park`") from None
        await self._settled()
        self.parked = True

    async def _fold(self) -> None:
        async with self._plain_motion() as motion:
            await declare_seen_right(motion)
            await fold(motion)


ALARMING = {
    "alarm": Severity.MAJOR,
    "collision": Severity.CRITICAL,
    "camera": Severity.ADVICE,
    "dead": Severity.MINOR,
}
"""Kinds of events of a run that are alarms, by their severity."""


def _left_s(start: datetime | None, asked_s: float, now: datetime) -> float:
    """How long to sleep until a shutter is to be closed; a moment where it does not say."""
    if start is None:
        return 0.5
    return max((start - now).total_seconds() + asked_s, 0.05)
