"""Every move and every fault is written into the store before the loop goes on."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from fiberloom.assignment import Assignment
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Measurement
from fiberloom.operation.move import Move
from fiberloom.operation.past.parts import packed_move
from fiberloom.planning import Plan
from fiberloom.store import Run
from fiberloom.store.run import START, STOPPED
from fiberloom.targets import TargetList
from fiberloom.typing import Flags, Floats


class StoreRecorder:
    """Implements `operation.move.Recorder` on a run of the store."""

    def __init__(self, run: Run, plane: FocalPlane, targets: TargetList, assignment: Assignment) -> None:
        """`run`: where to write; `plane`: layout of N positioners; `assignment`: which of them takes which
        of the `targets`."""
        self._run, self._plane = run, plane
        names = np.array([*targets.target_id, None], dtype=object)  # -1: no target
        x_mm, y_mm = np.append(targets.x_mm, np.nan), np.append(targets.y_mm, np.nan)
        chosen = assignment.target
        self._targets = {
            "target_id": names[chosen],
            "x_target_mm": x_mm[chosen],
            "y_target_mm": y_mm[chosen],
        }

    def move(self, move: Move) -> None:
        """Writes a row for the move and one for each positioner."""
        _record(self._run, self._plane, move, self._targets)

    def start(self, here_deg: Floats, wire_deg: Floats, image: Measurement) -> None:
        """Writes where every positioner is before the first move."""
        _record_start(self._run, self._plane, here_deg, wire_deg, image)

    def left(self, here_deg: Floats, wire_deg: Floats, answered: Flags, why: str) -> None:
        """Writes where each was left after a stop.

        `here_deg`, `wire_deg`: (N, 2) angles and wire positions as reported; `answered` (N,): which have;
        `why`: for the operator.
        """
        _record_left(self._run, self._plane, here_deg, wire_deg, answered)
        self._run.record_event(STOPPED, why)

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """Writes a fault or a remark."""
        self._run.record_event(kind, text, positioner_id=positioner_id)


class SurveyRecorder:
    """The same for moves without targets: the survey of a calibration."""

    def __init__(self, run: Run, plane: FocalPlane) -> None:
        self._run, self._plane = run, plane

    def move(self, move: Move) -> None:
        """Writes a row for the move and one for each positioner."""
        _record(self._run, self._plane, move, {})

    def start(self, here_deg: Floats, wire_deg: Floats, image: Measurement) -> None:
        """Writes where every positioner is before the first move."""
        _record_start(self._run, self._plane, here_deg, wire_deg, image)

    def left(self, here_deg: Floats, wire_deg: Floats, answered: Flags, why: str) -> None:
        """Writes where each was left after a stop.

        `here_deg`, `wire_deg`: (N, 2) angles and wire positions as reported; `answered` (N,): which have;
        `why`: for the operator.
        """
        _record_left(self._run, self._plane, here_deg, wire_deg, answered)
        self._run.record_event(STOPPED, why)

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """Writes a fault or a remark."""
        self._run.record_event(kind, text, positioner_id=positioner_id)


def _record_start(
    run: Run, plane: FocalPlane, here_deg: Floats, wire_deg: Floats, image: Measurement
) -> None:
    run.record_move(0, START, _columns(plane, image, here_deg, wire_deg), time_s=image.time_s)


def _record_left(run: Run, plane: FocalPlane, here_deg: Floats, wire_deg: Floats, answered: Flags) -> None:
    nowhere = np.full(len(plane), np.nan)
    dark = Measurement(nowhere, nowhere, np.zeros(len(plane), dtype=bool), 0.0)
    rows = np.flatnonzero(answered)
    columns = _columns(plane, dark, here_deg, wire_deg)
    run.record_move(0, STOPPED, {name: column[rows] for name, column in columns.items()})


def _columns(plane: FocalPlane, image: Measurement, at_deg: Floats, wire_deg: Floats) -> dict[str, Any]:
    return {
        "positioner_id": plane.positioner_id,
        "x_mm": image.x_mm,
        "y_mm": image.y_mm,
        "seen": image.seen,
        "alpha_deg": at_deg[:, 0],
        "beta_deg": at_deg[:, 1],
        "wire_alpha_deg": wire_deg[:, 0],
        "wire_beta_deg": wire_deg[:, 1],
    }


def _record(run: Run, plane: FocalPlane, move: Move, targets: dict[str, Any]) -> None:
    measured = _columns(plane, move.measurement, move.commanded_deg, move.wire_deg)
    measured |= {
        "error_um": move.measured_error_um,
        "status": np.array([str(s) for s in move.status], dtype=object),
    }
    run.record_move(
        move.number,
        move.label,
        measured | targets,
        time_s=move.measurement.time_s,
        plan_digest=digest_of(move.plan),
        part=packed_move(move) if targets else None,
    )


def digest_of(plan: Plan) -> str:
    """Of all trajectories of a plan."""
    digest = hashlib.sha256()
    for robot in plan.robots:
        for values in (robot.time_s, robot.alpha_deg, robot.beta_deg):
            digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
    return digest.hexdigest()[:16]
