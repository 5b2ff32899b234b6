"""The motion of a field under the lock of its array: states, exclusions, places that are kept."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fiberloom.bus.outcome import Result, Results
from fiberloom.bus.protocol import Command, Status
from fiberloom.bus.trajectory import WireTrajectory
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.drive.port import CountsSteps, Programme
from fiberloom.hardware import Hardware
from fiberloom.health.status import FibreStatus
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Measurement
from fiberloom.metrology.pipeline import ImageCamera
from fiberloom.operation.field_state import NOT_WHERE_IT_SAYS, SAME_DEG, FieldState
from fiberloom.operation.motion import FieldMotion, UnsafePlanError
from fiberloom.operation.move import Goals, Move, Recorder
from fiberloom.operation.reference.declare import declare, unreferenced
from fiberloom.operation.safety.begin import Standing, allowed_miss_mm
from fiberloom.operation.safety.seen import SCATTER_MM, where_seen
from fiberloom.operation.safety.stop import reason, to_its_end
from fiberloom.operation.session.array_lock import ArrayLock
from fiberloom.operation.session.clearing import FOLDED_DEG
from fiberloom.operation.session.states import SessionState, Step
from fiberloom.planning import MotionLimits, Plan, verify
from fiberloom.store.arrays import REPORTED, RIGHT, SEEN, UNKNOWN, ArrayPlaces
from fiberloom.typing import Flags, Floats

_PRECISE = (
    (Status.PRECISE_POSITIONING_ALPHA, Command.SWITCH_ON_PRECISE_MOVE_ALPHA),
    (Status.PRECISE_POSITIONING_BETA, Command.SWITCH_ON_PRECISE_MOVE_BETA),
)
"""Precise moves of each axis: the status bit, and the command that switches them on."""

# Plain integers: with flags as such, 500 answers hold up the event loop.
_POWER_WENT = int(Status.ESTIMATED_POSITION | Status.POSITION_RESTORED)
_DATUM_SET = int(Status.DATUMS_INITIALIZED)


class SessionMotion(FieldMotion):
    """As `FieldMotion`; every step is in the store before it is taken, every place after it."""

    def __init__(
        self,
        plane: FocalPlane,
        maps: TransmissionMaps,
        hardware: Hardware,
        recorder: Recorder,
        progress: Callable[[str], None],
        lock: ArrayLock,
    ) -> None:
        """`plane`: N positioners, the excluded ones offline; `maps`: of these; `hardware`: bus and camera;
        `recorder`: keeps every move; `progress`: called with the name of each step; `lock`: of the array,
        taken."""
        super().__init__(plane, maps, hardware, recorder, progress)
        self.lock, self.left_moving = lock, lock.left_moving
        self._right = np.zeros(len(plane), dtype=bool)
        """(N,) that have not moved since they were seen where they report, with power on."""
        self._known: ArrayPlaces | None = None
        """What was on record when the command began."""
        self._separating = False
        self._reported = np.zeros(len(plane), dtype=bool)

    async def connect(self, before: FieldState | None = None) -> None:
        """As `FieldMotion.connect`, `before` too; a position that is as recorded is believed where the datum
        is."""
        if self.lock.state is not SessionState.CONNECTING:
            await self.step(Step.CONNECT)
        await super().connect(before)
        await self._settle_offline()
        # dark, and believed where it was seen to be right: from now on it is its count that is believed
        self.datum |= self._right & self.state.standing(Standing.VOUCHED)
        self._note(self.image)
        await self.step(Step.BEGIN)

    async def step(self, step: Step, text: str = "") -> None:
        """Goes on in the table of states, in the store before it returns; `text` says why.

        NotOwner where the array was lost meanwhile.
        """
        await self.writer.now(self.lock.step, step, text)

    async def _vouched(self, answered: Flags) -> Flags:
        """(N,) which are where the record has them, and whose count is right; as `FieldMotion`.

        It is since its datum was searched, or where it was seen to be right, as long as it has not moved
        from there. In both cases power must not have gone since.
        """
        ids, known = self.plane.positioner_id, await self._places()
        self._known = known
        if not self.has_client:  # what was added up is believed, where the hardware says so
            self._reported = answered.copy()
            await self.step(Step.ANSWER)
            return await super()._vouched(answered)
        self._reported, wire_deg = answered.copy(), self.state.wire_deg.copy()
        # excluded ones are not read for a motion; their datum is kept where they have not moved
        further = np.isin(ids, self.client.ids) & self.plane.offline
        if further.any():
            wire_deg[further], self._reported[further] = await self.client.positions_deg(ids[further])
        off_deg = np.abs(wire_deg - known.wire_deg).max(axis=1)
        same = self._reported & (off_deg <= SAME_DEG)
        if self._reported.any():
            same &= await self._powered(self._reported)
        self.datum = known.datum & same
        await self.step(Step.ANSWER)
        self._right = same & (np.array(known.how) == RIGHT)
        given = self.hardware.vouched
        return np.asarray(self.datum | self._right | (False if given is None else given))

    async def _places(self) -> ArrayPlaces:
        """What is on record of all."""
        return await self.writer.now(self.lock.book.places, self.plane.positioner_id)

    async def _powered(self, there: Flags) -> Flags:
        """(N,) which say that their datum is set and that power has not gone since."""
        powered = np.zeros(len(self.plane), dtype=bool)
        answers = await self.client.status(self.plane.positioner_id[there])
        powered[there] = [answer.ok and _has_power(answer.values[0]) for answer in answers.values()]
        return powered

    async def _settle_offline(self) -> None:
        """Excluded positioners are obstacles where the image has them, not where the record does."""
        image, state = self.image, self.state
        rows = np.flatnonzero(self.plane.offline)
        if image is None or not len(rows):
            return
        off_mm = np.hypot(*(image.xy_mm - state.metrology_mm(state.here_deg)).T)
        moved = rows[image.seen[rows] & (off_mm[rows] > self.drive.model.allowed_mm)]
        for row in moved:
            text = f"excluded, and seen {off_mm[row]:.2f} mm from where it was"
            state.recorder.event("alarm", text, int(self.plane.positioner_id[row]))
        state.here_deg[moved], known = where_seen(
            self.plane, moved, image.xy_mm[moved], state.here_deg[moved]
        )
        state.somewhere[moved] |= ~known
        unplaced = np.array((await self._places()).how) == UNKNOWN
        state.somewhere[rows[unplaced[rows] & ~image.seen[rows]]] = True

    async def look(self, unknown: Flags | None = None) -> Measurement:
        """As `FieldMotion.look`, `unknown` too; the state says that an image is taken."""
        await self.step(Step.LOOK)
        seen = await super().look(unknown)
        camera = self.hardware.camera
        if self.witness is not None and isinstance(camera, ImageCamera) and camera.last is not None:
            self.witness.image(camera.last)
        return seen

    async def look_again(self, unknown: Flags) -> Measurement | None:
        """As `FieldMotion.look_again`, `unknown` too; the state says that it looks."""
        await self.step(Step.LOOK)
        return await super().look_again(unknown)

    async def move(
        self, number: int, label: str, planned: Plan | Programme, goals: Goals, comparison: bool = False
    ) -> Flags:
        """As `FieldMotion.move`: `number`, `label`, `planned`, `goals`, `comparison`; places are kept."""
        interrupted = await super().move(number, label, planned, goals, comparison)
        self._reported |= self.state.hearing.heard & ~self.plane.offline
        self._note(self.image)
        await self.step(Step.REST)
        return interrupted

    async def _execute(self, programme: Programme) -> Results:
        await self.step(Step.MOVE)
        return await super()._execute(programme)

    async def stop(self, why: str) -> None:
        """As `FieldMotion.stop`; the state says `why`, and where each was left is kept."""
        await super().stop(why)
        self._note(None)
        await self.step(Step.STOP, why)

    def shows_alpha(self, row: int, spot_mm: Floats) -> bool:
        """Whether a spot (2,) of the positioner in `row` is far enough from its alpha axis to show alpha."""
        places_mm = self.plane.centres_mm.copy()
        places_mm[row] = spot_mm
        return bool(allowed_miss_mm(self.plane, places_mm)[row] >= 3.0 * SCATTER_MM)

    async def nudge(self, row: int, way_deg: tuple[float, float], duration_s: float) -> Result:
        """Moves one positioner from where it reports to be by a little, all others at rest.

        `row`: of the positioner; `way_deg`: of alpha and beta; `duration_s`: of the motion. The caller has
        proven that the way is clear. Stops it where anything goes wrong.
        """
        number = int(self.plane.positioner_id[row])
        await self.care.begin([number], self.progress)
        await self.step(Step.MOVE)
        self.has_moved = True
        try:
            rows = np.array([row])
            await declare(self, rows[(await unreferenced(self, rows))[rows]])
            path = self.state.wire_deg[row] + np.array([(0.0, 0.0), way_deg])
            trajectory = WireTrajectory.from_deg([0.0, duration_s], *path.T)
            results = await self.client.run_trajectories({number: trajectory})
            if not results.ok.all():
                await self._come_to_rest([number])
            await self._read_positions(np.array([number]))
        except BaseException as error:
            await to_its_end(self.stop(reason(error)))
            raise
        await self.step(Step.REST)
        return results[number]

    async def begin_again(self, *, by_last_image: bool = False) -> None:
        """As `FieldMotion.begin_again`, `by_last_image` too."""
        if self.lock.state is SessionState.LOOKING:
            await self.step(Step.REST)
        await super().begin_again(by_last_image=by_last_image)

    async def stage(self, label: str, planned: Plan, goals: Goals, separating: bool) -> Flags:
        """One motion of a recovery; (N,) positioners not at their goal.

        `label`: for the record; `planned`: of all N positioners; `goals`: its ends; `separating`: bodies
        that touch at its begin move apart, which the verifier has to prove.
        """
        number = len(self.moves) + 1
        if not separating:
            return await self.move(number, label, planned, goals)
        ids = [robot.positioner_id for robot in planned.robots if robot.moves]
        precise = await self._precise(ids)
        self._separating = True
        try:
            # the firmware's own approach would press them together again
            await self.client.set_precise_moves(ids, on=False)
            return await self.move(number, label, planned, goals)
        finally:
            self._separating = False
            for command, those in precise.items():
                await self.client.command(command, those)

    async def _precise(self, ids: list[int]) -> dict[Command, list[int]]:
        """Which of these say that they make precise moves, by the command that switches them on again."""
        answers = await self.client.status(ids)
        return {on: [i for i, a in answers.items() if a.ok and a.values[0] & bit] for bit, on in _PRECISE}

    def _verify(self, programme: Programme) -> None:
        if not self._separating:
            super()._verify(programme)
            return
        found = verify(self.state.obstacles(), programme.plan, limits=MotionLimits(separating=True))
        self.collisions_verified += len(found.collisions)
        if not found.ok:
            raise UnsafePlanError(f"the verifier refused the way apart: {found}")

    @property
    def folded(self) -> bool:
        """Every positioner that follows commands is where it is parked."""
        return bool(self.are_folded[self.state.mobile].all() and self.state.mobile.any())

    @property
    def are_folded(self) -> Flags:
        """(N,) which are where they are parked: steppers at their switches, wherever the layout has these.

        One that may be anywhere is not.
        """
        off_deg = np.abs(self.state.here_deg - self.plane.park_deg).max(axis=1)
        near = np.asarray(off_deg < FOLDED_DEG)
        if isinstance(self.drive, CountsSteps):
            near |= self.drive.near_datum()
        return near & ~(self.state.somewhere & ~self.state.mobile)

    @property
    def collided(self) -> list[int]:
        """Positioners that said in this command that they had collided, and are not where they should be."""
        if not self.has_client:  # what MOONS' units have met is freed and told by their drive
            return []
        if not self.client.collisions or not self.moves or not self.moves[-1].interrupted:
            return []
        return sorted({collision.positioner for collision in self.client.collisions})

    def _seen_right(self, image: Measurement | None) -> Flags:
        """(N,) that the image shows where they report, far enough from the alpha axis to show alpha.

        None while the linear ratio allows larger misses.
        """
        state = self.state
        if image is None or state.looser_mm > 0.0:
            return np.zeros(len(self.plane), dtype=bool)
        reported_mm = state.metrology_mm(state.here_deg)
        most_mm = allowed_miss_mm(self.plane, reported_mm)
        miss_mm = np.hypot(*(image.xy_mm - reported_mm).T)
        right = image.seen & (miss_mm <= most_mm) & (most_mm >= 3.0 * SCATTER_MM)
        return np.asarray(right & state.mobile & self._reported)

    def _note(self, image: Measurement | None) -> None:
        """ArrayPlaces of all, as they are now; of an excluded one only where it is seen or was known."""
        state = self.state
        doubted = np.array([fault in NOT_WHERE_IT_SAYS for fault in state.faults])
        self.datum &= ~doubted
        seen = np.zeros(len(self.plane), dtype=bool) if image is None else image.seen
        how = np.where(seen, SEEN, np.where(doubted | ~self._reported, UNKNOWN, REPORTED))
        how[self._seen_right(image)] = RIGHT
        angles_deg = np.where(((how == UNKNOWN) | state.somewhere)[:, None], np.nan, state.here_deg)
        trusted = self._reported & ~self.plane.offline
        wire_deg = np.where(trusted[:, None], state.wire_deg, np.nan)
        if (known := self._known) is not None:  # its row would be kept, and say that it is right
            kept = np.isnan(angles_deg).any(axis=1) & (np.array(known.how) == RIGHT)
            angles_deg[kept], how[kept] = known.angles_deg[kept], REPORTED
        ids = self.plane.positioner_id
        places = ArrayPlaces(angles_deg, wire_deg, how.tolist(), self.datum.copy(), [None] * len(ids))
        self.writer.later(self.lock.book.note_places, ids, places)
        self.writer.later(self.lock.book.forget_datum, ids[~self.datum])
        if self.witness is not None:
            self.writer.later(self.witness.rests, angles_deg)


def _has_power(bits: int) -> bool:
    """Whether the datum is set, and power has not gone since."""
    return bits & _DATUM_SET == _DATUM_SET and not bits & _POWER_WENT


def last_status(motion: FieldMotion) -> list[FibreStatus]:
    """Of every positioner, after the last move or the begin check."""
    moves: list[Move] = motion.moves
    nothing = np.zeros(len(motion.plane), dtype=bool)
    unknown_um = np.full(len(motion.plane), np.nan)
    return moves[-1].status if moves else motion.state.status(nothing, unknown_um)
