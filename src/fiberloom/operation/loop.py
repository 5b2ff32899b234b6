"""The loop: blind move, image, corrections, decision (Kronig 2020, Section 4.1).

It sees positioners through a bus and their fibres through a camera, and trusts the camera.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fiberloom.assignment import Assignment
from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Outcome
from fiberloom.bus.trajectory import Trajectory
from fiberloom.calibration.transmission import TransmissionMaps
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Measurement
from fiberloom.operation.correction import CorrectionLoop
from fiberloom.operation.hardware import Hardware
from fiberloom.operation.status import ASTRAY_MM, FAULTS, Evidence, Status, judge
from fiberloom.planning import Plan, plan, plan_corrections, verify

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

METROLOGY = "metrology"


class UnsafePlanError(RuntimeError):
    """A plan did not pass its own verification; nothing was moved."""


@dataclass(frozen=True)
class Move:
    """One move of the whole field and what was seen afterwards. Arrays over N positioners."""

    number: int
    label: str
    plan: Plan
    commanded_deg: Floats
    measurement: Measurement
    true_mm: Floats | None  # the science fibre (metrology fibre where parked); a twin only
    status: list[Status]
    motion_s: float
    comparison: bool = False  # not part of the observation: shows what another model would give


class Recorder(Protocol):
    """Keeps what happened, as it happens."""

    def move(self, move: Move) -> None:
        """Called after every move, before anything else is done."""
        ...

    def event(self, kind: str, text: str) -> None:
        """Something an operator wants to know later."""
        ...


@dataclass(frozen=True)
class LoopSettings:
    """How the loop is run; `moves` counts the blind move."""

    moves: int = 3
    filtered: bool = True
    compare_linear: bool = False
    seed: int = 0
    recoveries: int = 3


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
    ) -> None:
        self.plane, self.maps, self.hardware = plane, maps, hardware
        self.assignment, self.settings = assignment, settings
        self.recorder, self.progress = recorder, progress
        self.client = Client(hardware.transport)
        self.goal_deg = np.stack([assignment.alpha_deg, assignment.beta_deg], axis=1)
        self.has_target = assignment.target >= 0
        self.faults: list[Status | None] = [
            Status.OFFLINE if offline else None for offline in plane.offline
        ]
        self.blocked = np.zeros(len(plane.positioner_id), dtype=bool)
        self.here_deg = plane.offline_position_deg.copy()
        self.verified_collisions = 0
        self.moves: list[Move] = []

    # the field as it is

    @property
    def healthy(self) -> Flags:
        """Positioners that move and are seen."""
        return np.array([fault is None for fault in self.faults])

    def obstacles(self) -> FocalPlane:
        """The focal plane in which those that cannot be trusted stand where they were last seen."""
        stuck = np.array([f not in (None, Status.DARK) for f in self.faults])
        return dataclasses.replace(
            self.plane,
            offline=self.plane.offline | stuck,
            offline_position_deg=self.here_deg.copy(),
        )

    async def connect(self) -> None:
        """Find the positioners of the bus and where they stand."""
        found = set(await self.client.discover())
        for i, positioner in enumerate(self.plane.positioner_id):
            if self.faults[i] is None and int(positioner) not in found:
                self._fault(i, Status.DEAD, "does not answer on the bus")
        if not found & set(self.plane.positioner_id.tolist()):
            raise InputError(
                "no positioner of this layout answers on the bus; check power and address"
            )
        await self._read_positions()

    async def _read_positions(self) -> None:
        ids = [
            int(p) for p, f in zip(self.plane.positioner_id, self.faults, strict=True) if f is None
        ]
        wire_deg, ok = await self.client.positions_deg(ids)
        index = self.plane.index_of(ids)[ok]
        self.here_deg[index] = self.maps.to_output(wire_deg[ok], index=index)

    # moves

    async def run(self) -> list[Move]:
        """Blind move with recovery, then the corrections."""
        await self.blind_move()
        filter_ = CorrectionLoop(self.plane, self.goal_deg, filtered=self.settings.filtered)
        for number in range(2, self.settings.moves + 1):
            await self.correct(filter_, number)
        if self.settings.compare_linear:
            await self.linear_move()
        return self.moves

    async def blind_move(self) -> None:
        """Go to the goals by the maps; go round whatever turns out not to move."""
        for attempt in range(self.settings.recoveries + 1):
            plane = self.obstacles()
            goal_deg = np.where(plane.offline[:, None], self.here_deg, self.goal_deg)
            self.progress("planning")
            planned = plan(plane, self.here_deg, goal_deg, seed=self.settings.seed + attempt)
            self.blocked = self._indices(planned.unreached)
            self.progress(
                "blind move" if attempt == 0 else f"going round faults, attempt {attempt}"
            )
            label = "blind" if attempt == 0 else f"blind, recovery {attempt}"
            behind = await self._move(1, label, planned, goal_deg, self.maps)
            if not behind.any():
                return

    async def correct(self, loop: CorrectionLoop, number: int) -> None:
        """Weigh the last image and move everyone who is healthy and has a target by what it says."""
        last = self.moves[-1].measurement
        active = self.healthy & self.has_target & ~self.blocked & last.seen
        measured_mm = np.stack([last.x_mm, last.y_mm], axis=1)
        wanted_deg = loop.update(self.here_deg, measured_mm, active)
        self.progress(f"correction {number - 1}")
        goal_deg = np.where(active[:, None], wanted_deg, self.here_deg)
        planned = plan_corrections(self.obstacles(), self.here_deg, goal_deg)
        await self._move(number, f"correction {number - 1}", planned, goal_deg, self.maps)

    async def linear_move(self) -> None:
        """What a blind move by a linear gear ratio would give, for comparison (Fig. 26)."""
        linear = self.maps.linear()
        active = self.healthy & self.has_target & ~self.blocked
        goal_deg = np.where(active[:, None], self.goal_deg, self.here_deg)
        here = self.here_deg
        # the same approach leg to the same angles, only the motor angles are those of the linear ratio
        planned = plan_corrections(self.obstacles(), here, goal_deg, force=active)
        await self._move(len(self.moves) + 1, "linear ratio", planned, goal_deg, linear)

    async def _move(
        self, number: int, label: str, planned: Plan, goal_deg: Floats, maps: TransmissionMaps
    ) -> Flags:
        """Verify, execute, look, judge, record. Returns who is healthy but not at its goal."""
        self._verify(planned)
        before_deg = self.here_deg.copy()
        outcomes = await self._execute(planned, maps)
        await self._read_positions_after(maps, planned, goal_deg)
        measurement = self.hardware.camera.measure()
        behind = self._judge(outcomes, measurement, before_deg, goal_deg)
        move = Move(
            number, label, planned, goal_deg, measurement, self._truth(),
            self._status(measurement), planned.duration_s,
        )  # fmt: skip
        self.moves.append(move)
        self.recorder.move(move)
        return behind

    def _verify(self, planned: Plan) -> None:
        found = verify(self.obstacles(), planned)
        self.verified_collisions += len(found.collisions)
        if not found.ok:
            raise UnsafePlanError(f"the planned motion was refused by the verifier: {found}")

    async def _execute(self, planned: Plan, maps: TransmissionMaps) -> dict[int, Outcome]:
        trajectories = {
            robot.positioner_id: self._on_the_wire(robot, maps)
            for robot in planned.robots
            if len(robot.time_s) > 1
        }
        results = await self.client.run_trajectories(trajectories)
        outcomes = {i: result.outcome for i, result in results.items()}
        if any(outcome is not Outcome.DONE for outcome in outcomes.values()):
            await self.client.stop()  # clears collision flags, so that the healthy can go on
        return outcomes

    def _on_the_wire(self, robot: object, maps: TransmissionMaps) -> Trajectory:
        index = self.plane.index_of([robot.positioner_id])
        theta_deg = np.stack([robot.alpha_deg, robot.beta_deg], axis=1)
        wire_deg = maps.to_wire(theta_deg, index=np.repeat(index, len(theta_deg)))
        return Trajectory.from_deg(robot.time_s, wire_deg[:, 0], wire_deg[:, 1])

    # judging

    def _judge(
        self, outcomes: dict[int, Outcome], seen: Measurement, before_deg: Floats, goal_deg: Floats
    ) -> Flags:
        measured_mm = np.stack([seen.x_mm, seen.y_mm], axis=1)
        goal_mm = self._metrology_mm(goal_deg)
        asked = [outcomes.get(int(p), Outcome.DONE) for p in self.plane.positioner_id]
        evidence = Evidence(
            asked, seen.seen, measured_mm, self._metrology_mm(before_deg),
            self._metrology_mm(self.here_deg), goal_mm,
        )  # fmt: skip
        for i, fault in enumerate(judge(evidence)):
            if fault is not None and self.faults[i] is None:
                self._fault(i, fault, f"after a move that ended as '{asked[i].value}'")
        self._trust_the_camera(measured_mm, seen.seen)
        away = np.hypot(*(measured_mm - goal_mm).T) > ASTRAY_MM
        interrupted = np.array([outcome is not Outcome.DONE for outcome in asked])
        return self.healthy & ~self.blocked & (away | interrupted)

    def _trust_the_camera(self, measured_mm: Floats, seen: Flags) -> None:
        """Whoever is not where it says stands where it is seen."""
        doubted = (
            np.array([f in (Status.LYING, Status.ASTRAY, Status.DEAD) for f in self.faults]) & seen
        )
        index = np.flatnonzero(doubted)
        if len(index):
            found = self.plane.inverse(measured_mm[index], METROLOGY, index=index)
            angles = np.stack([found.alpha_deg, found.beta_deg], axis=1)
            self.here_deg[index] = np.where(found.reachable[:, None], angles, self.here_deg[index])
