"""The single steps of an observation as commands: assign, plan, verify; and what there is to see."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fiberloom.assignment import assign_relaxed
from fiberloom.cli.health import stores_below
from fiberloom.instruments import FocalPlane, instrument_names, load_instrument
from fiberloom.planning import (
    Plan,
    plan,
    read_configuration,
    read_plans,
    verify,
    write_configuration,
)
from fiberloom.report.outputs import marks, prepare_folder
from fiberloom.store import Store
from fiberloom.targets import read_targets
from fiberloom.twin.hardware import missing_in_twin


def assign_step(plane: FocalPlane, targets: Path, seed: int, out: Path) -> dict[str, Any]:
    """Assign and write the goal configuration."""
    wanted = read_targets(targets)
    prepare_folder(out.parent)
    _, found = assign_relaxed(plane, wanted, seed=seed)
    write_configuration(out, plane.positioner_id, found.goal_deg)
    left_out = [f"{wanted.target_id[k]}: {why}" for k, why in sorted(found.unassigned.items())]
    return {
        "targets": len(wanted),
        "assigned": found.n_assigned,
        "positioners": len(plane),
        "notes": found.notes,
        "not_assigned": _some(left_out),
        "configuration": str(out),
    }


def _some(lines: list[str], most: int = 10) -> list[str]:
    more = len(lines) - most
    return lines if more <= 0 else [*lines[:most], f"... and {more} more"]


def plan_step(plane: FocalPlane, start: Path, goal: Path, seed: int, out: Path) -> dict[str, Any]:
    """Plan, verify and write trajectories."""
    start_deg = read_configuration(start, plane)
    goal_deg = read_configuration(goal, plane)
    prepare_folder(out.parent)
    planned = plan(plane, start_deg, goal_deg, seed=seed)
    checked = verify(plane, planned)
    if not checked.ok:
        return _verdict(plane, [planned], [checked]) | {"trajectories": "not written"}
    planned.save(out, **marks(plane, seed))
    return {
        "robots": len(plane),
        "arrived": len(plane) - len(planned.refused),
        "not_arrived": list(planned.refused.values()),
        "motion_s": planned.duration_s,
        "cpu_s": planned.cpu_s,
        "verified": checked.ok,
        "trajectories": str(out),
    }


def verify_step(plane: FocalPlane, trajectories: Path) -> dict[str, Any]:
    """Verify every plan of a file."""
    plans = read_plans(trajectories, plane)
    return _verdict(plane, plans, [verify(plane, p) for p in plans])


def _verdict(plane: FocalPlane, plans: Sequence[Plan], checks: Sequence[Any]) -> dict[str, Any]:
    return {
        "plans": len(plans),
        "verified": all(check.ok for check in checks),
        "collisions": sum(len(check.collisions) for check in checks),
        "violations": _some([str(v) for check in checks for v in check.violations]),
        "min_clearance_mm": min((c.min_clearance_mm for c in checks), default=float("nan")),
    }


def instruments_step(name: str | None) -> Any:
    """List presets, or give one in full."""
    if name is not None:
        return load_instrument(name).model_dump(mode="json")
    return [
        {
            "name": i.name,
            "positioners": i.layout.n_positioners,
            "arms_mm": f"{i.positioner.l_alpha_mm:g} / {i.positioner.points[i.seen_point].x_mm:g}",
            "pitch_mm": i.layout.pitch_mm,
            "motor": i.alpha.kind,
            "requirement_um": i.operation.requirement_um,
            "images": "yes" if i.camera else "no",
            "twin_drives_it": "yes" if not missing_in_twin(i) else "no",
        }
        for i in map(load_instrument, instrument_names())
    ]


def runs_step(where: str) -> list[dict[str, Any]]:
    """List the runs of a store, or of all stores below a folder."""
    return [row for store in stores_below(where) for row in _runs_of(store)]


def _runs_of(path: str | Path) -> list[dict[str, Any]]:
    with Store.open(path, create=False) as store:
        return [
            {
                "store": str(path),
                "run": run.id,
                "utc": run.utc_start.isoformat(timespec="seconds"),
                "status": run.status,
                "moves": run.n_moves,
                "measurements": run.n_measurements,
                "calibrations": ", ".join(f"{k} {n}" for k, n in store.calibrated(run.id).items()),
                "seed": run.seed,
                "instrument": run.instrument,
                "note": run.note,
            }
            for run in store.runs()
        ]
