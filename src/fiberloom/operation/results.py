"""What an observation leaves behind: summary.json, fibres.ecsv, trajectories.json, figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import Table, vstack

from fiberloom.assignment import Assignment
from fiberloom.health.status import FAULTS, Status
from fiberloom.instruments import FocalPlane
from fiberloom.operation.loop import Move
from fiberloom.report.focal_plane import plot_errors, plot_focal_plane
from fiberloom.targets import TargetList
from fiberloom.typing import Flags, Floats
from fiberloom.units import UM_PER_MM

NOT_COUNTED = FAULTS | {Status.PARKED, Status.OFFLINE, Status.BLOCKED}


@dataclass(frozen=True)
class Observed:
    """A finished loop with all that is needed to judge it."""

    plane: FocalPlane
    targets: TargetList
    assignment: Assignment
    moves: list[Move]
    collisions_verified: int
    stopped: str = ""
    """Why the loop made no further correction."""

    @property
    def requirement_um(self) -> float:
        """Largest error that the instrument accepts."""
        return self.plane.instrument.operation.requirement_um

    def target_mm(self) -> Floats:
        """Where the science fibre of each positioner should be (N, 2); NaN without a target."""
        xy = np.full((len(self.plane), 2), np.nan)
        has = self.assignment.target >= 0
        chosen = self.assignment.target[has]
        xy[has] = np.stack([self.targets.x_mm[chosen], self.targets.y_mm[chosen]], axis=1)
        return xy

    def true_error_um(self, move: Move) -> Floats | None:
        """True distance of the science fibre from its target (N,); a twin only."""
        if move.true_mm is None:
            return None
        return UM_PER_MM * np.hypot(*(move.true_mm - self.target_mm()).T)

    def error_um(self, move: Move) -> Floats:
        """True error where it is known, else the measured one."""
        true = self.true_error_um(move)
        return move.measured_error_um if true is None else true

    def counted(self, move: Move) -> Flags:
        """Positioners with a target that are healthy."""
        return np.array([status not in NOT_COUNTED for status in move.status])


def summarise(observed: Observed) -> dict[str, Any]:
    """Return the figures of summary.json that come from the moves."""
    final = next(m for m in reversed(observed.moves) if not m.comparison)
    counted = observed.counted(final)
    within = observed.error_um(final)[counted] <= observed.requirement_um
    return {
        "n_positioners": len(observed.plane),
        "n_targets": len(observed.targets),
        "n_assigned": int((observed.assignment.target >= 0).sum()),
        "n_valid": int(counted.sum()),
        "n_within_requirement": int(within.sum()),
        "requirement_um": observed.requirement_um,
        "collisions_verified": observed.collisions_verified,
        "plan_cpu_s": sum(m.plan.cpu_s for m in observed.moves),
        "motion_s": sum(m.motion_s for m in observed.moves if not m.comparison),
        "stopped": observed.stopped,
        "moves": [_summarise_move(observed, move) for move in observed.moves],
        "faults": _faults(observed, final),
    }


def _summarise_move(observed: Observed, move: Move) -> dict[str, Any]:
    counted = observed.counted(move)
    measured = move.measured_error_um[counted]
    true = observed.true_error_um(move)
    error = observed.error_um(move)[counted]
    return {
        "move": move.number,
        "label": move.label,
        "interrupted": move.interrupted,
        "comparison": move.comparison,
        "motion_s": move.motion_s,
        "n_fibres": int(counted.sum()),
        "n_within_requirement": int((error <= observed.requirement_um).sum()),
        "measured_rms_um": _rms(measured),
        "true_rms_um": None if true is None else _rms(true[counted]),
        "p95_um": _percentile(error, 95),
        "max_um": _percentile(error, 100),
    }


def _rms(values: Floats) -> float | None:
    good = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(good**2))) if len(good) else None


def _percentile(values: Floats, share: float) -> float | None:
    good = values[np.isfinite(values)]
    return float(np.percentile(good, share)) if len(good) else None


def _faults(observed: Observed, move: Move) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for positioner, status in zip(observed.plane.positioner_id, move.status, strict=True):
        if status in FAULTS or status is Status.BLOCKED:
            found.setdefault(status.value, []).append(int(positioner))
    return found


def fibres_table(observed: Observed) -> Table:
    """Return one row per positioner and move, as docs/files.md tells."""
    return vstack([_fibres_of(observed, move) for move in observed.moves])


def _fibres_of(observed: Observed, move: Move) -> Table:
    plane, assignment = observed.plane, observed.assignment
    target = observed.target_mm()
    names = np.append(observed.targets.target_id, "")  # index -1: no target
    nothing = np.full((len(plane), 2), np.nan)
    true = nothing if move.true_mm is None else move.true_mm
    seen = move.measurement.seen
    return Table(
        {
            "positioner_id": plane.positioner_id,
            "fibre": assignment.fibre,
            "target_id": names[assignment.target],
            "move": np.full(len(plane), move.number),
            "x_target_mm": target[:, 0],
            "y_target_mm": target[:, 1],
            "alpha_deg": assignment.alpha_deg,
            "beta_deg": assignment.beta_deg,
            "x_measured_mm": np.where(seen, move.measurement.x_mm, np.nan),
            "y_measured_mm": np.where(seen, move.measurement.y_mm, np.nan),
            "x_true_mm": true[:, 0],
            "y_true_mm": true[:, 1],
            "error_um": observed.error_um(move),
            "status": np.array([status.value for status in move.status]),
        }
    )


def write_results(observed: Observed, summary: Mapping[str, Any], out: Path) -> None:
    """Write every result file into `out`, which exists."""
    (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    table = fibres_table(observed)
    table.meta = {k: summary[k] for k in ("version", "seed", "instrument", "config_hash", "utc")}
    table.write(out / "fibres.ecsv", overwrite=True)
    plans = {"plans": [move.plan.to_dict() for move in observed.moves]}
    plans |= {k: summary[k] for k in ("version", "seed", "instrument", "config_hash", "utc")}
    (out / "trajectories.json").write_text(json.dumps(plans) + "\n")
    _plot(observed, out)


def _plot(observed: Observed, out: Path) -> None:
    final = next(m for m in reversed(observed.moves) if not m.comparison)
    error = observed.error_um(final)
    counted = observed.counted(final)
    flagged = np.array([s in FAULTS or s is Status.BLOCKED for s in final.status])
    within = int((error[counted] <= observed.requirement_um).sum())
    title = (
        f"{within} of {int(counted.sum())} fibres within {observed.requirement_um:g} µm "
        f"after move {final.number}"
        + (f"; {int(flagged.sum())} positioners flagged" if flagged.any() else "")
    )
    plot_focal_plane(
        out / "focal_plane.png",
        observed.plane,
        final.commanded_deg,
        np.where(counted, error, np.nan),
        flagged,
        observed.requirement_um,
        title,
    )
    ended = [move for move in observed.moves if not move.interrupted]
    plot_errors(
        out / "errors.png",
        [observed.error_um(m)[observed.counted(m)] for m in ended],
        [f"move {m.number} ({m.label})" for m in ended],
        observed.requirement_um,
    )
