"""Moving a field: connect, go to goals by a verified plan, look, judge. No targets, no corrections.

Positioners report over the bus and the camera measures their fibres; where they differ, the camera is
trusted. The loop of an observation and the survey of a calibration both move the field by this.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Results
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.drive.port import Drive, Programme, Wanted
from fiberloom.drive.sdssv import MotorCare, SdssvDrive
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.pointing import ExposurePointing
from fiberloom.metrology import Measurement
from fiberloom.operation.field_state import SAME_DEG, FieldState
from fiberloom.operation.move import Goals, MadeMove, Move, Recorder
from fiberloom.operation.safety.begin import Standing
from fiberloom.operation.safety.deviation import MotionRule
from fiberloom.operation.safety.looking import PatientCamera, know_fiducials
from fiberloom.operation.safety.loop_first import LoopFirst
from fiberloom.operation.safety.stop import reason, to_its_end
from fiberloom.operation.safety.writing import Writer, WriterRecorder, beside
from fiberloom.operation.series.ahead import PlannedAhead
from fiberloom.operation.session.states import Step
from fiberloom.operation.session.witness import BegunMove, Witness
from fiberloom.operation.truth import truths
from fiberloom.planning import Plan
from fiberloom.store.run import CUT_SHORT
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import UM_PER_MM

ROUND_FAULTS = "blind, round faults"
"""Label of a blind move after one that was stopped."""

RECOVERIES = 3
"""How often a blind move that was stopped is planned anew round the positioners that are in the way."""


class UnsafePlanError(RuntimeError):
    """A plan did not pass its own verification; nothing was moved."""


MotionMaker = Callable[
    [FocalPlane, TransmissionMaps, Hardware, Recorder, Callable[[str], None]], "FieldMotion"
]
"""Makes the motion of a field from layout, maps, hardware, recorder and progress: `FieldMotion`, or more."""


class FieldMotion:
    """Moves a field to goals, by verified plans."""

    def __init__(
        self,
        plane: FocalPlane,
        maps: TransmissionMaps,
        hardware: Hardware,
        recorder: Recorder,
        progress: Callable[[str], None] = lambda _: None,
    ) -> None:
        """`plane`: layout of N positioners; `maps`: their transmission maps; `hardware`: bus and camera;
        `recorder`: keeps every move; `progress`: called with the name of each step."""
        self.plane, self.maps, self.hardware = plane, maps, hardware
        self.writer, self.progress = Writer(), progress
        self.recorder: Recorder = WriterRecorder(recorder, self.writer)
        self.drive: Drive = hardware.drive or SdssvDrive(plane, maps, hardware.bus)
        self.eye = PatientCamera(
            hardware.camera, plane.instrument.operation, self._camera_event, self.drive.sleep
        )
        know_fiducials(hardware.camera, plane)
        self.state = FieldState(plane, self.recorder, self.drive.model)
        self._loop_first = LoopFirst()
        self.left_moving = False
        """The host before was lost while it moved the field."""
        self.has_moved = False
        """Arms may be elsewhere than at the begin of the command."""
        vouched = hardware.vouched
        self.datum = np.zeros(len(plane), dtype=bool) if vouched is None else vouched
        """(N,) whose datum was searched since power came on; the record of the hardware, where it has one."""
        self.image: Measurement | None = None
        """The last one."""
        self.presumed = np.zeros(len(plane), dtype=bool)
        """(N,) taken to be where they report though nothing shows it, while their datum is searched."""
        self.keeps_faults = False
        """Those that were seen not to follow stay obstacles when the begin check is done again."""
        self.collisions_verified = 0
        truth = hardware.truth
        self._contacts_before = 0 if truth is None else truth.contacts()
        self.contacts_true: int | None = None if truth is None else 0
        """Of arms, as only a twin knows."""
        self.moves: list[Move] = []
        self.images = 1
        """After a move, at most."""
        self.pointing: ExposurePointing | None = None
        """Of the telescope, where it is known."""
        self.ahead: PlannedAhead | None = None
        """A plan of the blind move that was made before; None: it is planned when it is to begin."""
        self.witness: Witness | None = None
        """Told of moves while they are made."""
        self.underway = 0
        """Number of the move under way or just made; 0 before the first one."""
        self.compares = False
        """That move is a comparison, no part of the observation."""

    async def connect(self, before: FieldState | None = None) -> None:
        """Finds the positioners, and where they and their fibres are.

        Where they are believed to be is held against an image; one that is not certain to be there does not
        move. `before`: of the check before, since which no arm should have moved; the last image serves again
        where all say so.
        InputError where none of the layout's positioners answers, most fibres are not seen, or most are
        not where they report.
        """
        self._loop_first.begin()
        state, known = self.state, self.plane.positioner_id.tolist()
        await self.drive.connect()
        await self._all_at_rest()
        found = set(self.drive.ids)
        there = np.array([p in found for p in known]) & state.mobile
        answered = np.zeros(len(self.plane), dtype=bool)
        answered[there] = await self._read_positions(self.plane.positioner_id[there])
        vouched = await self._vouched(answered) | self.presumed
        unknown = ~answered & ~self.plane.offline
        at_rest = before is not None and self._is_as(before, answered)
        again = await self.look_again(unknown) if at_rest else None
        image = again or await self.look(unknown)
        self.recorder.start(state.here_deg, state.wire_deg, image)
        await beside(state.begin, answered, image, vouched)
        state.suspect(self.drive.suspects())
        await self.writer.written()

    def _is_as(self, before: FieldState, answered: Flags) -> bool:
        """Whether all that have `answered` (N,) did so before, and say that they are where they were."""
        off_deg = np.abs(self.state.wire_deg - before.wire_deg).max(axis=1)
        there = ~before.standing(Standing.SILENT) & (off_deg <= SAME_DEG)
        return before.beginning is not None and bool(there[answered].all())

    async def _all_at_rest(self) -> None:
        """Stops what still moves, as a host that was killed leaves it: places of before are no places."""
        await self.drive.rest(self._alarm, self.left_moving)

    def _alarm(self, text: str) -> None:
        self.recorder.event("alarm", text)
        self.progress(text)

    async def _vouched(self, answered: Flags) -> Flags:
        """(N,) whose datum is on record. `answered` (N,): their positions are in the state."""
        return self.datum.copy()

    async def step(self, step: Step, text: str = "") -> None:
        """What happens to the array; `text` says why. A session keeps its states by it."""

    async def searched(self, positioner_id: list[int], *, datum: bool) -> None:
        """After a datum search: reads where all are, keeps it, and does the begin check again.

        `positioner_id`: those that have found it; `datum`: of both axes, so that they are
        believed where they are dark.
        """
        await self.step(Step.REST)
        ids = self.plane.positioner_id
        await self._read_positions(ids[np.isin(ids, self.drive.ids) & ~self.plane.offline])
        if datum and positioner_id:
            rows = self.plane.index_of(positioner_id)
            self.datum[rows], self.state.somewhere[rows] = True, False  # it is where it reports now
        self._note(None)
        await self.begin_again()

    async def begin_again(self, *, by_last_image: bool = False) -> None:
        """The begin check anew: what was said of positioners so far is forgotten.

        `by_last_image`: no arm is to have moved since; positioners have only been told where they are.
        """
        before, self.state = self.state, FieldState(self.plane, self.recorder, self.drive.model)
        self.state.looser_mm = before.looser_mm
        await self.connect(before if by_last_image else None)
        if self.keeps_faults:
            self.state.keep_faults(before)

    def _note(self, image: Measurement | None) -> None:
        """A session keeps where all are, by the `image` where there is one."""

    async def look(self, unknown: Flags | None = None) -> Measurement:
        """An image, with what the positioners say of where they are; `unknown` (N,): what they do not.

        Taken and reduced beside the event loop, which goes on listening to the bus; after a move the mean of
        up to `images`, after a comparison one, since nothing is corrected by it. Raises CameraError where
        none comes: at once before anything has moved, else after as many tries as the instrument says.
        """
        expected_mm = self._expected_mm(unknown)
        once = not self.has_moved
        most = 1 if self.compares else self.images
        look = self.eye.once(expected_mm) if once else self.eye.several(expected_mm, most)
        self.image = await look
        return self.image

    async def look_again(self, unknown: Flags) -> Measurement | None:
        """The last image, with what positioners say by now; `unknown` (N,) as of `look`. No arm has moved.

        None: there is none, or the camera cannot look at it once more.
        """
        if self.image is None:
            return None
        again = await self.eye.again(self._expected_mm(unknown), self.image)
        self.image = again or self.image
        return again

    def _expected_mm(self, unknown: Flags | None) -> Floats:
        """(N, 2) of the metrology fibres, NaN where it is `unknown` (N,)."""
        expected_mm = self.state.metrology_mm(self.state.here_deg)
        return expected_mm if unknown is None else np.where(unknown[:, None], np.nan, expected_mm)

    def _camera_event(self, kind: str, text: str) -> None:
        self.recorder.event(kind, text)
        self.progress(text)

    async def go(self, goals: Goals, seed: int = 0, recoveries: int = RECOVERIES) -> None:
        """Moves to the goals by the maps, and round positioners that turn out not to move.

        `goals`: of N positioners; `seed`: of the planner; `recoveries`: how often a move that was stopped
        is planned anew. Raises UnsafePlanError where the verifier refuses a plan.
        """
        for attempt in range(recoveries + 1):
            label = "blind" if attempt == 0 else f"{ROUND_FAULTS} {attempt}"
            self.progress(f"planning: {label}")
            wanted = self.wanted(goals, goals.angles_deg, self.state.mobile, seed + attempt)
            programme = await self._prepared(wanted, attempt)
            self.state.book_blocked(programme.plan)
            self.progress(label)
            interrupted = await self.move(1, label, programme, goals)
            if not interrupted.any():
                return
            self.recorder.event("recovery", f"{int(interrupted.sum())} positioners interrupted")

    async def _prepared(self, wanted: Wanted, attempt: int) -> Programme:
        """What was planned ahead, where it holds from the true start; else what is planned now."""
        if attempt == 0 and self.ahead is not None:
            made = await self.ahead.programme(self.drive, wanted)
            if made is not None:
                return made
        return await self.drive.prepare(wanted)

    def wanted(
        self, goals: Goals, angles_deg: Floats, who: Flags, seed: int = 0, small: bool = False
    ) -> Wanted:
        """What the drive is asked for.

        `goals`: from which the approach comes; `angles_deg` (N, 2): where those `who` (N,) move shall be, the
        others stay; `seed`: of the planner; `small`: a correction.
        """
        here_deg, state = self.state.here_deg, self.state
        goal_deg = np.where(who[:, None], angles_deg, here_deg)
        return Wanted(state.obstacles(), here_deg, goal_deg, goals.approach_deg, seed, small)

    async def move(
        self, number: int, label: str, planned: Plan | Programme, goals: Goals, comparison: bool = False
    ) -> Flags:
        """Verifies and executes a plan or a programme, looks, judges, records.

        Returns (N,) mobile positioners that are not at their goal.
        `number` and `label`: of the move, for the record; `planned`: of all N positioners;
        `goals`: by which errors are measured; `comparison`: the move is no part of the observation.
        Raises UnsafePlanError where the verifier refuses the plan: nothing has moved then.
        """
        programme = planned if isinstance(planned, Programme) else await self.drive.compile(planned)
        await asyncio.to_thread(self._verify, programme)
        self.underway, self.compares = number, comparison
        if self.witness is not None:
            self.witness.begins(BegunMove(number, label, programme.plan, goals, self._bus_s))
        before_deg = self.state.here_deg.copy()
        results = await self._execute(programme)
        made = MadeMove(number, label, programme.plan, goals, comparison, before_deg, results)
        interrupted = self._book(made, await self._look_after(made))
        if interrupted.any():
            self.recorder.event(CUT_SHORT, f"{int(interrupted.sum())} positioners are not at their goals")
        await self.writer.written()
        return interrupted

    def _book(self, made: MadeMove, image: Measurement) -> Flags:
        """Judges and records a move by its image; (N,) mobile positioners not at their goal."""
        end_deg = made.plan.end_deg
        if (truth := self.hardware.truth) is not None:
            self.contacts_true = truth.contacts() - self._contacts_before
        hidden = self.drive.excused(image)
        interrupted = self.state.judge(made.results, image, made.before_deg, end_deg, hidden)
        if (believed_deg := self.drive.seen(image, self.state.mobile)) is not None:
            self.state.here_deg = np.where(self.state.mobile[:, None], believed_deg, self.state.here_deg)
        self.state.suspect(self.drive.suspects())
        error_um = self._measured_error_um(image, made.goals)
        move = Move(
            number=made.number,
            label=made.label,
            plan=made.plan,
            commanded_deg=end_deg,
            wire_deg=self.state.wire_deg.copy(),
            measurement=image,
            measured_error_um=error_um,
            metrology_goal_mm=made.goals.metrology_mm,
            target_mm=made.goals.target_mm,
            star_mm=made.goals.star_mm,
            short_mm=made.goals.short_mm,
            pointed=made.goals.pointed,
            **truths(self.hardware.truth, made.goals, self.pointing),
            status=self.state.status(made.goals.has_target, error_um),
            interrupted=bool(interrupted.any()),
            comparison=made.comparison,
        )
        self.moves.append(move)
        self.recorder.move(move)
        return interrupted

    async def _look_after(self, made: MadeMove) -> Measurement:
        """The images after a move; where none comes all stay at rest, and where each was left is recorded.

        So is the move, by the images that came, where it ends between two of them.
        """
        try:
            return await self.look()
        except BaseException as error:
            try:
                if (image := self.eye.before_the_end()) is not None:
                    self._book(made, image)
            finally:
                await to_its_end(self.stop(reason(error)))
            raise

    async def stop(self, why: str) -> None:
        """Brings every positioner that can be reached to rest, and records `why` and where each was left.

        One that does not answer is named: it runs its trajectory to the end, or stands already.
        """
        self.progress("stopping")
        begun_s = self.drive.time_s
        stopped = await self.drive.stop()
        rest_s = self.drive.time_s - begun_s
        answered = np.zeros(len(self.plane), dtype=bool)
        # others on the bus are stopped too, but nothing is known of where they are
        ids = self.plane.positioner_id[np.isin(self.plane.positioner_id, stopped)]
        answered[self.plane.index_of(ids)] = await self._read_positions(ids)
        silent = self.plane.positioner_id[self.state.mobile & ~answered].tolist()
        text = f"{why}; {int(answered.sum())} positioners at rest after {rest_s:.2f} s"
        text += f"; no answer from {', '.join(map(str, silent))}" if silent else ""
        self.recorder.left(self.state.here_deg, self.state.wire_deg, answered, text)
        self.progress(text)
        await self.writer.written()

    async def close(self) -> None:
        """Closes the bus; one that the caller has opened stays open. All that was recorded is written."""
        self._loop_first.end()
        try:
            await self.drive.close()
        finally:
            await self.writer.close()

    def _verify(self, programme: Programme) -> None:
        found = self.drive.verify(self.state.obstacles(), programme)
        self.collisions_verified += len(found.collisions)
        if not found.ok:
            raise UnsafePlanError(f"the verifier refused the planned motion: {found}")

    async def _execute(self, programme: Programme) -> Results:
        moving = programme.moving
        await self.writer.written()
        self.has_moved = True
        try:
            rule = MotionRule(
                self.state.obstacles(), programme.plan, self.recorder.event, lambda: self.drive.time_s
            )
            if self.witness is not None:
                rule.on_start = self.witness.started
                if not isinstance(self.drive, SdssvDrive):  # others do not say when they start
                    self.witness.started(self.drive.time_s)
            results = await self.drive.run(programme, rule, self.progress)
            if not results.ok.all():
                await self._come_to_rest(moving)
            # one that has not answered may move still
            asked = np.array([*moving, *await self._back_again()], dtype=np.int64)
            self.state.hearing.hears(self.plane.index_of(asked), await self._read_positions(asked))
        except BaseException as error:
            await to_its_end(self.stop(reason(error)))
            raise
        return results

    def _bus_s(self) -> float:
        return self.drive.time_s

    async def _back_again(self) -> list[int]:
        """Those that once gave no answer, and answer now."""
        silent = self.plane.positioner_id[self.state.hearing.held_against].tolist()
        return await self.drive.heard_again(silent) if silent else []

    async def _come_to_rest(self, ids: list[int]) -> None:
        """After a move that went wrong: healthy positioners can move again."""
        await self.drive.settle(ids)

    @property
    def client(self) -> Client:
        """Of SDSS-V's commands. InputError where the positioners are of another kind."""
        return self._sdssv.client

    @property
    def care(self) -> MotorCare:
        """Limits of SDSS-V's motors. InputError where the positioners are of another kind."""
        return self._sdssv.care

    @property
    def has_client(self) -> bool:
        """Whether the positioners take SDSS-V's commands."""
        return isinstance(self.drive, SdssvDrive)

    @property
    def _sdssv(self) -> SdssvDrive:
        if not isinstance(self.drive, SdssvDrive):
            name = self.plane.instrument.name
            raise InputError(f"{name}: its positioners do not take SDSS-V's commands; observe them")
        return self.drive

    @property
    def reported_deg(self) -> Floats:
        """(N, 2) angles by the wire positions, also of those that are seen elsewhere."""
        return self.maps.to_output(self.state.wire_deg)

    async def read_positions(self, positioner_id: Ints) -> Flags:
        """Asks these where they are; (n,) which have answered."""
        return await self._read_positions(positioner_id)

    async def _read_positions(self, ids: Ints) -> Flags:
        """Asks where they are; returns which have answered."""
        found = await self.drive.believed(ids)
        rows = self.plane.index_of(ids[found.answered])
        self.state.wire_deg[rows] = found.wire_deg[found.answered]
        self.state.here_deg[rows] = found.angles_deg[found.answered]
        return found.answered

    def _measured_error_um(self, image: Measurement, goals: Goals) -> Floats:
        goal_mm = goals.metrology_mm
        if goal_mm is None:
            goal_mm = self.state.metrology_mm(goals.angles_deg)
        miss_mm = np.hypot(*(image.xy_mm - goal_mm).T)
        return np.where(goals.has_target & image.seen, UM_PER_MM * miss_mm, np.nan)


async def reported_deg(hardware: Hardware, plane: FocalPlane, maps: TransmissionMaps) -> Floats:
    """(N, 2) angles at which the positioners of the `plane` say that they are, by the `maps`; nothing moves.

    One that gives no answer is taken to be folded; one that says a place beyond its stops, at the stop.
    """
    drive = hardware.drive or SdssvDrive(plane, maps, hardware.bus)
    await drive.connect()
    there = np.isin(plane.positioner_id, drive.ids) & ~plane.offline
    here_deg = np.where(plane.offline[:, None], plane.offline_position_deg, plane.park_deg)
    found = await drive.believed(plane.positioner_id[there])
    here_deg[np.flatnonzero(there)[found.answered]] = found.angles_deg[found.answered]
    return np.clip(here_deg, *np.moveaxis(plane.stops_of(), -1, 0))
