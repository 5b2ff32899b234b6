"""The loop: blind move, image, corrections, decision (Kronig 2020, Section 4.1).

It sees positioners through a bus and their fibres through a camera, and trusts the camera.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fiberloom.assignment import Assignment
from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Outcome, Results
from fiberloom.bus.trajectory import Trajectory
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.health.status import Status
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import METROLOGY, Operation
from fiberloom.metrology import Measurement
from fiberloom.operation.correction import CorrectionLoop, whole_steps
from fiberloom.operation.judge import ASTRAY_MM, Evidence, judge
from fiberloom.operation.stopping import StopRule
from fiberloom.planning import Plan, Robot, plan, plan_corrections, verify
from fiberloom.typing import Flags, Floats
from fiberloom.units import UM_PER_MM

NOT_WHERE_IT_SAYS = frozenset({Status.LYING, Status.ASTRAY, Status.DEAD})


ROUND_FAULTS = "blind, round faults"
"""Label of a blind move after one that was stopped."""

REST_TIMEOUT_S = 5.0
"""A stopped positioner stands after a fraction of a second."""


class UnsafePlanError(RuntimeError):
    """A plan did not pass its own verification; nothing was moved."""


@dataclass(frozen=True)
class Move:
    """One move of the whole field and what was seen afterwards. Arrays over N positioners."""

    number: int
    label: str
    plan: Plan
    commanded_deg: Floats
    wire_deg: Floats
    measurement: Measurement
    measured_error_um: Floats
    """Seen minus wanted metrology fibre; NaN without target or light."""
    true_mm: Floats | None
    """The science fibre (metrology fibre where parked); a twin only."""
    status: list[Status]
    interrupted: bool = False
    """Stopped before its end, because somebody collided or would not go."""
    comparison: bool = False
    """Not part of the observation: shows what another model would give."""

    @property
    def motion_s(self) -> float:
        """Duration of the motion."""
        return self.plan.duration_s


class Recorder(Protocol):
    """Keeps what happened, as it happens."""

    def start(self, here_deg: Floats, wire_deg: Floats, image: Measurement) -> None:
        """Called before the first move: angles and wire positions reported, and the image."""
        ...

    def move(self, move: Move) -> None:
        """Called after every move, before anything else is done."""
        ...

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """Something an operator wants to know later."""
        ...


@dataclass(frozen=True)
class LoopSettings:
    """How the loop is run; `moves` counts the blind move, and is the most that a stop rule allows."""

    moves: int = 3
    stop: StopRule = field(default_factory=StopRule)
    filtered: bool = True
    compare_linear: bool = False
    seed: int = 0
    recoveries: int = 3
    """How often a blind move that was stopped is planned anew round whoever is in the way."""

    @classmethod
    def of(cls, operation: Operation, moves: int | None = None, **others: Any) -> LoopSettings:
        """The instrument's rule and its corrections; with `moves`: exactly so many moves."""
        if moves is not None:
            return cls(moves=moves, **others)
        return cls(moves=1 + operation.corrections_max, stop=StopRule.of(operation), **others)


class Loop:
    """Takes a field from where its positioners stand to their goals."""

    def __init__(
        self,
        plane: FocalPlane,
        assignment: Assignment,
        maps: TransmissionMaps,
        hardware: Hardware,
        settings: LoopSettings,
        recorder: Recorder,
        progress: Callable[[str], None] = lambda _: None,
        map_sigma_deg: Callable[[Floats], Floats] | None = None,
    ) -> None:
        """`map_sigma_deg` tells how far the maps may be off at wire positions (N, 2), where known."""
        self.map_sigma_deg = map_sigma_deg
        self.plane, self.maps, self.hardware = plane, maps, hardware
        self.assignment, self.settings = assignment, settings
        self.recorder, self.progress = recorder, progress
        self.client = Client(hardware.transport)
        self.has_target = assignment.target >= 0
        self.faults: list[Status | None] = [Status.OFFLINE if offline else None for offline in plane.offline]
        self.blocked = np.zeros(len(plane), dtype=bool)
        self.here_deg = plane.offline_position_deg.copy()
        self.wire_deg = np.zeros((len(plane), 2))
        self.collisions_verified = 0
        self.moves: list[Move] = []
        self.stopped = ""
        """Why the loop made no further correction."""
        self._arrived = np.zeros(len(plane), dtype=bool)

    # the field as it is

    @property
    def goal_deg(self) -> Floats:
        """Ideal angles (N, 2) of the assignment."""
        return self.assignment.goal_deg

    @property
    def mobile(self) -> Flags:
        """Positioners that go where they are told; a dark one does, though nobody sees it."""
        return np.array([fault in (None, Status.DARK) for fault in self.faults])

    @property
    def correctable(self) -> Flags:
        """Positioners with a target that are worth another move."""
        healthy = np.array([fault is None for fault in self.faults])
        return healthy & self.has_target & ~self.blocked

    def obstacles(self) -> FocalPlane:
        """The focal plane in which those that do not move stand where they were last seen."""
        return dataclasses.replace(
            self.plane, offline=~self.mobile, offline_position_deg=self.here_deg.copy()
        )

    async def connect(self) -> None:
        """Find the positioners of the bus, and where they and their fibres are."""
        found = set(await self.client.discover())
        known = self.plane.positioner_id.tolist()
        if not found & set(known):
            raise InputError(
                f"none of the {len(known)} positioners of this layout answers on the bus; "
                "check its power and address"
            )
        for i in np.flatnonzero(self.mobile):
            if known[i] not in found:
                self._flag(int(i), Status.DEAD, "does not answer on the bus")
        await self._read_positions(self.maps, self.plane.positioner_id[self.mobile])
        image = self._look()
        self.recorder.start(self.here_deg, self.wire_deg, image)
        self._look_for_dark_fibres(image)

    def _look(self) -> Measurement:
        """An image, with what the positioners say of where they are."""
        return self.hardware.camera.measure(self._metrology_mm(self.here_deg))

    def _look_for_dark_fibres(self, image: Measurement) -> None:
        dark = ~image.seen & self.mobile
        if dark.sum() > 0.5 * len(self.plane):
            raise InputError(
                f"the camera sees only {int(image.seen.sum())} of {len(self.plane)} fibres; "
                "check the back-illumination"
            )
        for i in np.flatnonzero(dark):
            self._flag(int(i), Status.DARK, "its fibre is not seen")

    async def _read_positions(self, maps: TransmissionMaps, ids: NDArray[np.int64]) -> None:
        wire_deg, answered = await self.client.positions_deg(ids)
        rows = self.plane.index_of(ids[answered])
        self.wire_deg[rows] = wire_deg[answered]
        self.here_deg[rows] = maps.to_output(wire_deg[answered], index=rows)

    # moves

    async def run(self) -> list[Move]:
        """Blind move with recovery, then the corrections."""
        await self.blind_move()
        corrections = CorrectionLoop(
            self.plane, self.goal_deg, filtered=self.settings.filtered, sigma_deg=self._expected_deg()
        )
        for number in range(2, self.settings.moves + 1):
            if self.settings.stop.satisfied(self._open_um()):
                break
            await self.correct(corrections, number)
        self.stopped = self._why_stopped()
        if self.settings.compare_linear:
            await self.linear_move()
        return self.moves

    def _open_um(self) -> Floats:
        """Last measured distances (n,) of the fibres with a target that are seen and healthy and
        that the stop rule has not let go."""
        error_um = self.moves[-1].measured_error_um
        self._arrived |= self.settings.stop.arrived(error_um)
        return error_um[self.correctable & np.isfinite(error_um) & ~self._arrived]

    def _why_stopped(self) -> str:
        stop, open_um = self.settings.stop, self._open_um()
        why = stop.explain(open_um)
        if stop.satisfied(open_um):
            return why
        return ", ".join(filter(None, [f"all {self.settings.moves} moves made", why]))

    def _expected_deg(self) -> Floats | None:
        """How far the blind move may miss (N, 2), where operation has taught the maps."""
        if self.map_sigma_deg is None:
            return None
        return self.map_sigma_deg(self.maps.to_wire(self.goal_deg))

    async def blind_move(self) -> None:
        """Go to the goals by the maps; go round whatever turns out not to move."""
        for attempt in range(self.settings.recoveries + 1):
            label = "blind" if attempt == 0 else f"{ROUND_FAULTS} {attempt}"
            self.progress(f"planning: {label}")
            plane = self.obstacles()
            goal_deg = np.where(self.mobile[:, None], self.goal_deg, self.here_deg)
            planned = plan(
                plane,
                self.here_deg,
                goal_deg,
                seed=self.settings.seed + attempt,
                approach_deg=self.assignment.approach_deg,
            )
            self._book_blocked(planned)
            self.progress(label)
            interrupted = await self._move(1, label, planned, self.maps)
            if not interrupted.any():
                return
            self.recorder.event("recovery", f"{int(interrupted.sum())} positioners interrupted")

    def _book_blocked(self, planned: Plan) -> None:
        self.blocked[:] = False
        for positioner, reason in planned.refused.items():
            self.blocked[self.plane.index_of(positioner)] = True
            self.recorder.event("blocked", reason, positioner)

    async def correct(self, corrections: CorrectionLoop, number: int) -> None:
        """Weigh the last image and move every healthy positioner with a target by what it says.

        A positioner that the stop rule has let go stays; a correction is made of whole steps.
        """
        image = self.moves[-1].measurement
        wanted_deg = corrections.update(
            self.here_deg, image.xy_mm, self.correctable & image.seen, image.covariance_mm2
        )
        step_deg = np.array([axis.step_deg for axis in self.plane.instrument.axes])
        goal_deg = whole_steps(self.here_deg, wanted_deg, step_deg)
        goal_deg = np.where(self._arrived[:, None], self.here_deg, goal_deg)
        await self._small_move(number, f"correction {number - 1}", goal_deg, self.maps)

    async def linear_move(self) -> None:
        """What a blind move by a linear gear ratio gives, for comparison (Fig. 26).

        The same approach to the same angles; only the motor angles are those of the linear ratio.
        """
        linear = self.maps.linear()
        # where the linear ratio has to aim, in the angles of the maps by which the field is known
        aim_deg = self.maps.to_output(linear.to_wire(self.goal_deg))
        await self._small_move(len(self.moves) + 1, "linear ratio", aim_deg, self.maps, True)

    async def _small_move(
        self,
        number: int,
        label: str,
        wanted_deg: Floats,
        maps: TransmissionMaps,
        comparison: bool = False,
    ) -> None:
        self.progress(label)
        goal_deg = np.where(self.correctable[:, None], wanted_deg, self.here_deg)
        planned = plan_corrections(
            self.obstacles(), self.here_deg, goal_deg, approach_deg=self.assignment.approach_deg
        )
        await self._move(number, label, planned, maps, comparison)

    async def _move(
        self,
        number: int,
        label: str,
        planned: Plan,
        maps: TransmissionMaps,
        comparison: bool = False,
    ) -> Flags:
        """Verify, execute, look, judge, record. Returns who is healthy but was interrupted."""
        self._verify(planned)
        before_deg = self.here_deg.copy()
        commanded_deg = planned.end_deg
        results = await self._execute(planned, maps)
        image = self._look()
        interrupted = self._judge(results, image, before_deg, commanded_deg)
        error_um = self._measured_error_um(image)
        move = Move(
            number=number,
            label=label,
            plan=planned,
            commanded_deg=commanded_deg,
            wire_deg=self.wire_deg.copy(),
            measurement=image,
            measured_error_um=error_um,
            true_mm=self._truth(),
            status=self._status(error_um),
            interrupted=bool(interrupted.any()),
            comparison=comparison,
        )
        self.moves.append(move)
        self.recorder.move(move)
        return interrupted

    def _verify(self, planned: Plan) -> None:
        found = verify(self.obstacles(), planned)
        self.collisions_verified += len(found.collisions)
        if not found.ok:
            raise UnsafePlanError(f"the verifier refused the planned motion: {found}")

    async def _execute(self, planned: Plan, maps: TransmissionMaps) -> Results:
        trajectories = {
            robot.positioner_id: self._on_the_wire(robot, maps) for robot in planned.robots if robot.moves
        }
        results = await self.client.run_trajectories(trajectories)
        if not results.ok.all():
            await self._come_to_rest(list(trajectories))
        await self._read_positions(maps, np.array(list(trajectories), dtype=np.int64))
        return results

    async def _come_to_rest(self, ids: list[int]) -> None:
        """Clear the flags of collisions, so that the healthy can go on, and let everybody stop."""
        await self.client.stop()
        await self.client.wait_until_done(ids, timeout_s=REST_TIMEOUT_S, stop_on_collision=False)

    def _on_the_wire(self, robot: Robot, maps: TransmissionMaps) -> Trajectory:
        row = int(self.plane.index_of(robot.positioner_id))
        wire_deg = maps.path_to_wire(row, robot.points_deg)
        return Trajectory.from_deg(robot.time_s, wire_deg[:, 0], wire_deg[:, 1])

    # judging

    def _judge(
        self,
        results: Results,
        image: Measurement,
        before_deg: Floats,
        commanded_deg: Floats,
    ) -> Flags:
        ended = [results.get(int(p)) for p in self.plane.positioner_id]
        asked = [Outcome.DONE if result is None else result.outcome for result in ended]
        evidence = Evidence(
            outcomes=asked,
            seen=image.seen,
            measured_mm=image.xy_mm,
            before_mm=self._metrology_mm(before_deg),
            reported_mm=self._metrology_mm(self.here_deg),
            goal_mm=self._metrology_mm(commanded_deg),
        )
        for i, fault in enumerate(judge(evidence)):
            if fault is not None and self.faults[i] is None:
                self._flag(i, fault, f"after a move: {ended[i] or 'not asked to move'}")
        self._trust_the_camera(image)
        away = np.hypot(*(evidence.reported_mm - evidence.goal_mm).T) > ASTRAY_MM
        unfinished = np.array([outcome is not Outcome.DONE for outcome in asked])
        return self.mobile & (away | unfinished)

    def _trust_the_camera(self, image: Measurement) -> None:
        """Whoever is not where it says stands where it is seen."""
        doubted = np.array([fault in NOT_WHERE_IT_SAYS for fault in self.faults])
        rows = np.flatnonzero(doubted & image.seen)
        found = self.plane.inverse(image.xy_mm[rows], METROLOGY, index=rows)
        angles_deg = np.column_stack([found.alpha_deg, found.beta_deg])
        self.here_deg[rows] = np.where(found.reachable[:, None], angles_deg, self.here_deg[rows])

    def _flag(self, row: int, fault: Status, why: str) -> None:
        self.faults[row] = fault
        self.recorder.event(fault.value, why, int(self.plane.positioner_id[row]))

    def _metrology_mm(self, angles_deg: Floats) -> Floats:
        return self.plane.forward(angles_deg[:, 0], angles_deg[:, 1], METROLOGY)

    def _measured_error_um(self, image: Measurement) -> Floats:
        miss_mm = np.hypot(*(image.xy_mm - self._metrology_mm(self.goal_deg)).T)
        return np.where(self.has_target & image.seen, UM_PER_MM * miss_mm, np.nan)

    def _truth(self) -> Floats | None:
        if self.hardware.truth is None:
            return None
        true_mm = self.hardware.truth.fibre_xy(METROLOGY)
        for fibre in np.unique(self.assignment.fibre[self.has_target]):
            rows = self.has_target & (self.assignment.fibre == fibre)
            true_mm[rows] = self.hardware.truth.fibre_xy(str(fibre))[rows]
        return true_mm

    def _status(self, error_um: Floats) -> list[Status]:
        requirement_um = self.plane.instrument.operation.requirement_um
        return [self._status_of(i, error_um[i] <= requirement_um) for i in range(len(self.plane))]

    def _status_of(self, row: int, within: bool) -> Status:
        fault = self.faults[row]
        if fault is not None:
            return fault
        if self.blocked[row]:
            return Status.BLOCKED
        if not self.has_target[row]:
            return Status.PARKED
        return Status.ON_TARGET if within else Status.OFF_TARGET
