"""Moving a field: connect, go to goals by a verified plan, look, judge. No targets, no corrections.

Positioners are seen through a bus and their fibres through a camera, and the camera is trusted. The loop
of an observation and the survey of a calibration both move the field by this.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Outcome, Results
from fiberloom.bus.trajectory import WireTrajectory
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.health.status import FibreStatus
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import METROLOGY
from fiberloom.metrology import Measurement
from fiberloom.operation.judge import ASTRAY_MM, Evidence, judge
from fiberloom.operation.move import Goals, Move, Recorder
from fiberloom.planning import Plan, Trajectory, plan, verify
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import UM_PER_MM

NOT_WHERE_IT_SAYS = frozenset({FibreStatus.LYING, FibreStatus.ASTRAY, FibreStatus.DEAD})

ROUND_FAULTS = "blind, round faults"
"""Label of a blind move after one that was stopped."""

REST_TIMEOUT_S = 5.0
"""A stopped positioner is at rest after a fraction of a second."""

RECOVERIES = 3
"""How often a blind move that was stopped is planned anew round the positioners that are in the way."""


class UnsafePlanError(RuntimeError):
    """A plan did not pass its own verification; nothing was moved."""


class FieldState:
    """Where every positioner is, and which of them do as they are told. Arrays over N positioners."""

    def __init__(self, plane: FocalPlane, recorder: Recorder) -> None:
        self.plane, self.recorder = plane, recorder
        self.faults: list[FibreStatus | None] = [
            FibreStatus.OFFLINE if offline else None for offline in plane.offline
        ]
        self.blocked = np.zeros(len(plane), dtype=bool)
        self.here_deg = plane.offline_position_deg.copy()
        """(N, 2) angles as reported, through the maps; as seen where the report is not trusted."""
        self.wire_deg = np.zeros((len(plane), 2))

    @property
    def mobile(self) -> Flags:
        """Positioners that go where they are told; a dark one does, though its fibre is not seen."""
        return np.array([fault in (None, FibreStatus.DARK) for fault in self.faults])

    @property
    def healthy(self) -> Flags:
        """Positioners without a fault whose way is not blocked."""
        return np.array([fault is None for fault in self.faults]) & ~self.blocked

    def obstacles(self) -> FocalPlane:
        """The focal plane in which those that do not move are where they were last seen."""
        return dataclasses.replace(
            self.plane, offline=~self.mobile, offline_position_deg=self.here_deg.copy()
        )

    def metrology_mm(self, angles_deg: Floats) -> Floats:
        """(N, 2) metrology fibres of the layout at these angles."""
        return self.plane.forward(angles_deg[:, 0], angles_deg[:, 1], METROLOGY)

    def flag(self, row: int, fault: FibreStatus, why: str) -> None:
        """Books a fault."""
        self.faults[row] = fault
        self.recorder.event(fault.value, why, int(self.plane.positioner_id[row]))

    def book_blocked(self, planned: Plan) -> None:
        """Positioners that the plan refuses."""
        self.blocked[:] = False
        for positioner, reason in planned.refused.items():
            self.blocked[self.plane.index_of(positioner)] = True
            self.recorder.event("blocked", reason, positioner)

    def judge(self, results: Results, image: Measurement, before_deg: Floats, commanded_deg: Floats) -> Flags:
        """Flags what the image shows to be at fault; which healthy ones did not come to their goal."""
        ended = [results.get(int(p)) for p in self.plane.positioner_id]
        asked = [Outcome.DONE if result is None else result.outcome for result in ended]
        evidence = Evidence(
            outcomes=asked,
            seen=image.seen,
            measured_mm=image.xy_mm,
            before_mm=self.metrology_mm(before_deg),
            reported_mm=self.metrology_mm(self.here_deg),
            goal_mm=self.metrology_mm(commanded_deg),
        )
        for i, fault in enumerate(judge(evidence)):
            if fault is not None and self.faults[i] is None:
                self.flag(i, fault, f"after a move: {ended[i] or 'not asked to move'}")
        self._trust_the_camera(image)
        away = np.hypot(*(evidence.reported_mm - evidence.goal_mm).T) > ASTRAY_MM
        unfinished = np.array([outcome is not Outcome.DONE for outcome in asked])
        again: Flags = self.mobile & (away | unfinished)
        return again

    def _trust_the_camera(self, image: Measurement) -> None:
        """A positioner that is not where it says is where it is seen."""
        doubted = np.array([fault in NOT_WHERE_IT_SAYS for fault in self.faults])
        rows = np.flatnonzero(doubted & image.seen)
        found = self.plane.inverse(image.xy_mm[rows], METROLOGY, index=rows)
        angles_deg = np.column_stack([found.alpha_deg, found.beta_deg])
        self.here_deg[rows] = np.where(found.reachable[:, None], angles_deg, self.here_deg[rows])

    def look_for_dark_fibres(self, image: Measurement) -> None:
        """Books the fibres that the first image does not show; refuses where most are missing."""
        dark = ~image.seen & self.mobile
        if dark.sum() > 0.5 * len(self.plane):
            raise InputError(
                f"the camera sees only {int(image.seen.sum())} of {len(self.plane)} fibres; "
                "check the back-illumination"
            )
        for i in np.flatnonzero(dark):
            self.flag(int(i), FibreStatus.DARK, "its fibre is not seen")

    def status(self, has_target: Flags, error_um: Floats) -> list[FibreStatus]:
        """What can be said of every positioner, its fibre being this far from its target."""
        requirement_um = self.plane.instrument.operation.requirement_um
        return [
            self._status_of(i, bool(has_target[i]), bool(error_um[i] <= requirement_um))
            for i in range(len(self.plane))
        ]

    def _status_of(self, row: int, has_target: bool, within: bool) -> FibreStatus:
        fault = self.faults[row]
        if fault is not None:
            return fault
        if self.blocked[row]:
            return FibreStatus.BLOCKED
        if not has_target:
            return FibreStatus.PARKED
        return FibreStatus.ON_TARGET if within else FibreStatus.OFF_TARGET


class FieldMotion:
    """Takes a field from where its positioners are to goals, by verified plans."""

    def __init__(
        self,
        plane: FocalPlane,
        maps: TransmissionMaps,
        hardware: Hardware,
        recorder: Recorder,
        progress: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.plane, self.maps, self.hardware = plane, maps, hardware
        self.recorder, self.progress = recorder, progress
        self.client = Client(hardware.transport)
        self.state = FieldState(plane, recorder)
        self.collisions_verified = 0
        self.moves: list[Move] = []

    async def connect(self) -> None:
        """Find the positioners of the bus, and where they and their fibres are."""
        state, known = self.state, self.plane.positioner_id.tolist()
        found = set(await self.client.discover())
        if not found & set(known):
            raise InputError(
                f"none of the {len(known)} positioners of this layout answers on the bus; "
                "check its power and address"
            )
        for i in np.flatnonzero(state.mobile):
            if known[i] not in found:
                state.flag(int(i), FibreStatus.DEAD, "does not answer on the bus")
        await self._read_positions(self.plane.positioner_id[state.mobile])
        image = self.look()
        self.recorder.start(state.here_deg, state.wire_deg, image)
        state.look_for_dark_fibres(image)

    def look(self) -> Measurement:
        """An image, with what the positioners say of where they are."""
        return self.hardware.camera.measure(self.state.metrology_mm(self.state.here_deg))

    async def go(self, goals: Goals, seed: int = 0, recoveries: int = RECOVERIES) -> None:
        """Go to the goals by the maps; go round positioners that turn out not to move."""
        for attempt in range(recoveries + 1):
            label = "blind" if attempt == 0 else f"{ROUND_FAULTS} {attempt}"
            self.progress(f"planning: {label}")
            planned = plan(
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
        """Verify, execute, look, judge, record. Returns which healthy ones were interrupted."""
        self._verify(planned)
        before_deg = self.state.here_deg.copy()
        results = await self._execute(planned)
        image = self.look()
        interrupted = self.state.judge(results, image, before_deg, planned.end_deg)
        error_um = self._measured_error_um(image, goals)
        move = Move(
            number=number,
            label=label,
            plan=planned,
            commanded_deg=planned.end_deg,
            wire_deg=self.state.wire_deg.copy(),
            measurement=image,
            measured_error_um=error_um,
            true_mm=self._truth(goals),
            status=self.state.status(goals.has_target, error_um),
            interrupted=bool(interrupted.any()),
            comparison=comparison,
        )
        self.moves.append(move)
        self.recorder.move(move)
        return interrupted

    async def close(self) -> None:
        """Lets go of the bus."""
        await self.client.close()

    def _verify(self, planned: Plan) -> None:
        found = verify(self.state.obstacles(), planned)
        self.collisions_verified += len(found.collisions)
        if not found.ok:
            raise UnsafePlanError(f"the verifier refused the planned motion: {found}")

    async def _execute(self, planned: Plan) -> Results:
        trajectories = {
            robot.positioner_id: self._on_the_wire(robot) for robot in planned.robots if robot.moves
        }
        results = await self.client.run_trajectories(trajectories)
        if not results.ok.all():
            await self._come_to_rest(list(trajectories))
        await self._read_positions(np.array(list(trajectories), dtype=np.int64))
        return results

    async def _come_to_rest(self, ids: list[int]) -> None:
        """Clear the flags of collisions, so that the healthy can go on, and let all of them stop."""
        await self.client.stop()
        await self.client.wait_until_done(ids, timeout_s=REST_TIMEOUT_S, stop_on_collision=False)

    async def _read_positions(self, ids: Ints) -> None:
        wire_deg, answered = await self.client.positions_deg(ids)
        rows = self.plane.index_of(ids[answered])
        self.state.wire_deg[rows] = wire_deg[answered]
        self.state.here_deg[rows] = self.maps.to_output(wire_deg[answered], index=rows)

    def _on_the_wire(self, robot: Trajectory) -> WireTrajectory:
        row = int(self.plane.index_of(robot.positioner_id))
        wire_deg = self.maps.path_to_wire(row, robot.points_deg)
        return WireTrajectory.from_deg(robot.time_s, wire_deg[:, 0], wire_deg[:, 1])

    def _measured_error_um(self, image: Measurement, goals: Goals) -> Floats:
        miss_mm = np.hypot(*(image.xy_mm - self.state.metrology_mm(goals.angles_deg)).T)
        return np.where(goals.has_target & image.seen, UM_PER_MM * miss_mm, np.nan)

    def _truth(self, goals: Goals) -> Floats | None:
        if self.hardware.truth is None:
            return None
        true_mm = self.hardware.truth.fibre_xy(METROLOGY)
        for fibre in np.unique(goals.fibre[goals.has_target]):
            rows = goals.has_target & (goals.fibre == fibre)
            true_mm[rows] = self.hardware.truth.fibre_xy(str(fibre))[rows]
        return true_mm
