"""Moving a field: connect, go to goals by a verified plan, look, judge. No targets, no corrections.

Positioners report over the bus and the camera measures their fibres; where they differ, the camera is
trusted. The loop of an observation and the survey of a calibration both move the field by this.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Result, Results
from fiberloom.bus.protocol import Status
from fiberloom.bus.trajectory import WireTrajectory
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.pointing import ExposurePointing
from fiberloom.metrology import Measurement
from fiberloom.operation.care.motors import MotorCare
from fiberloom.operation.field_state import FieldState
from fiberloom.operation.move import Goals, MadeMove, Move, Recorder
from fiberloom.operation.safety.deviation import MotionRule, when_linked
from fiberloom.operation.safety.looking import PatientCamera, know_fiducials
from fiberloom.operation.safety.loop_first import LoopFirst
from fiberloom.operation.safety.stop import reason, to_its_end
from fiberloom.operation.safety.writing import Writer, WriterRecorder, beside
from fiberloom.operation.session.states import Step
from fiberloom.operation.truth import truths
from fiberloom.planning import Plan, Trajectory, plan, verify
from fiberloom.store.run import CUT_SHORT
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import UM_PER_MM

ROUND_FAULTS = "blind, round faults"
"""Label of a blind move after one that was stopped."""

REST_TIMEOUT_S = 5.0
"""A stopped positioner is at rest after a fraction of a second."""

LONGEST_MOTION_S = 60.0
"""So long after a host has gone, one that does not answer may still follow its trajectory: plans of 500
positioners last 35 s."""

HEAR_S = 0.2
"""Between attempts to hear who does not answer, and who has collided."""

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
        self.client = Client(hardware.transport)
        self.care = MotorCare(plane, self.client)
        self.eye = PatientCamera(
            hardware.camera, plane.instrument.operation, self._camera_event, self.client.sleep
        )
        know_fiducials(hardware.camera, plane)
        self.state = FieldState(plane, self.recorder)
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
        self.moves: list[Move] = []
        self.images = 1
        self.pointing: ExposurePointing | None = None
        """Of the telescope, where it is known."""
        """After a move, at most."""
        self.underway = 0
        """Number of the move under way or just made; 0 before the first one."""

    async def connect(self) -> None:
        """Finds the positioners of the bus, and where they and their fibres are.

        What they report is held against an image; one that is not certain to be there does not move.
        InputError where none of the layout's positioners answers, most fibres are not seen, or most are
        not where they report.
        """
        self._loop_first.begin()
        state, known = self.state, self.plane.positioner_id.tolist()
        if not set(await self.client.discover()) & set(known):
            raise InputError(
                f"none of the {len(known)} positioners of this layout answers on the bus; "
                "check its power and address"
            )
        await self._all_at_rest()
        found = set(self.client.ids)
        there = np.array([p in found for p in known]) & state.mobile
        answered = np.zeros(len(self.plane), dtype=bool)
        answered[there] = await self._read_positions(self.plane.positioner_id[there])
        vouched = await self._vouched(answered) | self.presumed
        image = await self.look(~answered & ~self.plane.offline)
        self.recorder.start(state.here_deg, state.wire_deg, image)
        await beside(state.begin, answered, image, vouched)
        await self.writer.written()

    async def _all_at_rest(self) -> None:
        """Stops what still moves, as a host that was killed leaves it: places of before are no places.

        Not while one does not answer: it may move, too, and those that are stopped would be in its way. But
        where one has collided, and the others go on by plans that are not known any more, all are stopped
        that can be reached; then none moves again before the others have answered, or have had their time.
        """
        moving, collided = await self._on_the_way()
        until_s = self.client.time_s + LONGEST_MOTION_S
        if not (moving or self.left_moving):
            return
        if self._unheard and not collided:
            self._waits(
                f"{len(moving)} positioners are still moving at the begin; ", "none is stopped", until_s
            )
            while not collided and await self._not_all_heard(until_s):
                collided = (await self._on_the_way())[1]
        await self._stop_the_moving()
        if self._unheard and self.client.time_s < until_s:
            self._waits("", "none may come", until_s)
            while await self._not_all_heard(until_s):
                await self._stop_the_moving()
            await self._stop_the_moving()

    def _waits(self, before: str, so: str, until_s: float) -> None:
        silent = ", ".join(map(str, self._unheard))
        left_s = until_s - self.client.time_s
        self._alarm(f"{before}no answer from {silent}, in whose way {so}: waiting up to {left_s:.0f} s")

    async def _not_all_heard(self, until_s: float) -> bool:
        """After another try: whether one has not answered yet that may still be on its way."""
        if not self._unheard or self.client.time_s >= until_s:
            return False
        await self.client.sleep(HEAR_S)
        await self.client.discover()
        return bool(self._unheard)

    async def _stop_the_moving(self) -> None:
        moving, _ = await self._on_the_way()
        if moving:
            self._alarm(f"{len(moving)} positioners were still moving at the begin; all are stopped")
            # one that gives no answer may hear nevertheless
            await self.client.stop_all(ids=sorted({*self.client.ids, *self._unheard}))
            await self.client.wait_until_done(moving, REST_TIMEOUT_S, stop_on_collision=False)

    async def _on_the_way(self) -> tuple[list[int], bool]:
        """Those that move, and whether one has collided."""
        answers = await self.client.poll(self.client.ids)
        collided = any(answer.ok and answer.values[0] & Status.COLLISION for answer in answers.values())
        return [i for i, answer in answers.items() if _moves(answer)], collided

    @property
    def _unheard(self) -> list[int]:
        """Positioners of the layout that the bus does not have now."""
        return sorted(set(self.plane.positioner_id[~self.plane.offline].tolist()) - set(self.client.ids))

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
        await self._read_positions(ids[np.isin(ids, self.client.ids) & ~self.plane.offline])
        if datum and positioner_id:
            rows = self.plane.index_of(positioner_id)
            self.datum[rows], self.state.somewhere[rows] = True, False  # it is where it reports now
        self._note(None)
        await self.begin_again()

    async def begin_again(self) -> None:
        """The begin check anew: what was said of positioners so far is forgotten."""
        before, self.state = self.state, FieldState(self.plane, self.recorder)
        self.state.looser_mm = before.looser_mm
        await self.connect()
        if self.keeps_faults:
            self.state.keep_faults(before)

    def _note(self, image: Measurement | None) -> None:
        """A session keeps where all are, by the `image` where there is one."""

    async def look(self, unknown: Flags | None = None) -> Measurement:
        """An image, with what the positioners say of where they are; `unknown` (N,): what they do not.

        Taken and reduced beside the event loop, which goes on listening to the bus; after a move the mean of
        up to `images`. Raises CameraError where none comes: at once before anything has moved, else after as
        many tries as the instrument says.
        """
        expected_mm = self.state.metrology_mm(self.state.here_deg)
        if unknown is not None:
            expected_mm = np.where(unknown[:, None], np.nan, expected_mm)
        once = not self.has_moved
        look = self.eye.once(expected_mm) if once else self.eye.several(expected_mm, self.images)
        self.image = await look
        return self.image

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
            planned = await self.care.planned(
                plan,
                self.state.obstacles(),
                self.state.here_deg,
                np.where(self.state.mobile[:, None], goals.angles_deg, self.state.here_deg),
                seed=seed + attempt,
                approach_deg=goals.approach_deg,
            )
            self.state.book_blocked(planned)
            self.progress(label)
            interrupted = await self.move(1, label, planned, goals)
            if not interrupted.any():
                return
            self.recorder.event("recovery", f"{int(interrupted.sum())} positioners interrupted")

    async def move(
        self, number: int, label: str, planned: Plan, goals: Goals, comparison: bool = False
    ) -> Flags:
        """Verifies and executes a plan, looks, judges, records; (N,) mobile positioners not at their goal.

        `number` and `label`: of the move, for the record; `planned`: trajectories of all N positioners;
        `goals`: by which errors are measured; `comparison`: the move is no part of the observation.
        Raises UnsafePlanError where the verifier refuses the plan: nothing has moved then.
        """
        await asyncio.to_thread(self._verify, planned)
        self.underway = number
        before_deg = self.state.here_deg.copy()
        results = await self._execute(planned)
        made = MadeMove(number, label, planned, goals, comparison, before_deg, results)
        interrupted = self._book(made, await self._look_after(made))
        if interrupted.any():
            self.recorder.event(CUT_SHORT, f"{int(interrupted.sum())} positioners are not at their goals")
        await self.writer.written()
        return interrupted

    def _book(self, made: MadeMove, image: Measurement) -> Flags:
        """Judges and records a move by its image; (N,) mobile positioners not at their goal."""
        end_deg = made.plan.end_deg
        interrupted = self.state.judge(made.results, image, made.before_deg, end_deg)
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
        begun_s = self.client.time_s
        stopped = await self.client.stop_all()
        await self.client.wait_until_done(stopped.ok_ids, REST_TIMEOUT_S, stop_on_collision=False)
        rest_s = self.client.time_s - begun_s
        answered = np.zeros(len(self.plane), dtype=bool)
        # others on the bus are stopped too, but nothing is known of where they are
        ids = self.plane.positioner_id[np.isin(self.plane.positioner_id, stopped.ok_ids)]
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
            await self.client.close()
        finally:
            await self.writer.close()

    def _verify(self, planned: Plan) -> None:
        found = verify(self.state.obstacles(), planned)
        self.collisions_verified += len(found.collisions)
        if not found.ok:
            raise UnsafePlanError(f"the verifier refused the planned motion: {found}")

    async def _execute(self, planned: Plan) -> Results:
        trajectories = await asyncio.to_thread(self._all_on_the_wire, planned)
        await self.care.begin(list(trajectories), self.progress)
        await self.writer.written()
        self.has_moved = True
        try:
            await when_linked(self.client, trajectories)
            rule = MotionRule(
                self.state.obstacles(), planned, self.recorder.event, lambda: self.client.time_s
            )
            results = await self.client.run_trajectories(trajectories, watch=rule)
            if not results.ok.all():
                await self._come_to_rest(list(trajectories))
            # one that has not answered may move still
            asked = np.array([*trajectories, *await self._back_again()], dtype=np.int64)
            self.state.hearing.hears(self.plane.index_of(asked), await self._read_positions(asked))
        except BaseException as error:
            await to_its_end(self.stop(reason(error)))
            raise
        return results

    async def _back_again(self) -> list[int]:
        """Those that once gave no answer, and answer now."""
        silent = self.plane.positioner_id[self.state.hearing.held_against].tolist()
        if not silent:
            return []
        back = (await self.client.poll(silent)).ok_ids
        # one that was not found at the begin: a stop has to reach it from now on
        self.client.ids = sorted({*self.client.ids, *back})
        return back

    async def _come_to_rest(self, ids: list[int]) -> None:
        """Stops all and clears the flags of collisions, so that healthy positioners can move again."""
        await self.client.stop()
        await self.client.wait_until_done(ids, timeout_s=REST_TIMEOUT_S, stop_on_collision=False)

    @property
    def reported_deg(self) -> Floats:
        """(N, 2) angles by the wire positions, also of those that are seen elsewhere."""
        return self.maps.to_output(self.state.wire_deg)

    async def read_positions(self, positioner_id: Ints) -> Flags:
        """Asks these where they are; (n,) which have answered."""
        return await self._read_positions(positioner_id)

    async def _read_positions(self, ids: Ints) -> Flags:
        """Asks where they are; returns which have answered."""
        wire_deg, answered = await self.client.positions_deg(ids)
        rows = self.plane.index_of(ids[answered])
        self.state.wire_deg[rows] = wire_deg[answered]
        self.state.here_deg[rows] = self.maps.to_output(wire_deg[answered], index=rows)
        return answered

    def _all_on_the_wire(self, planned: Plan) -> dict[int, WireTrajectory]:
        moving = [robot for robot in planned.robots if robot.moves]
        rows = self.plane.index_of([robot.positioner_id for robot in moving]).tolist()
        return {r.positioner_id: on_the_wire(self.maps, row, r) for row, r in zip(rows, moving, strict=True)}

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
    client = Client(hardware.transport)
    await client.discover()
    there = np.isin(plane.positioner_id, client.ids) & ~plane.offline
    here_deg = np.where(plane.offline[:, None], plane.offline_position_deg, plane.park_deg)
    wire_deg, answered = await client.positions_deg(plane.positioner_id[there])
    rows = np.flatnonzero(there)[answered]
    here_deg[rows] = maps.to_output(wire_deg[answered], index=rows)
    return np.clip(here_deg, *np.moveaxis(plane.stops_of(), -1, 0))


def _moves(answer: Result) -> bool:
    """Whether a positioner says that it is on its way."""
    return answer.ok and not answer.values[0] & Status.DISPLACEMENT_COMPLETED


def on_the_wire(maps: TransmissionMaps, row: int, robot: Trajectory) -> WireTrajectory:
    """What is sent of the way of the positioner in `row`: motor angles by `maps`, at the corners."""
    wire_deg = maps.path_to_wire(row, robot.points_deg)
    corners = robot.corners(0), robot.corners(1)
    return WireTrajectory.from_deg(robot.time_s, wire_deg[:, 0], wire_deg[:, 1], corners)
