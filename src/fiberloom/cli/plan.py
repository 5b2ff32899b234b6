"""`fiberloom assign`, `plan` and `verify`: the single steps between a target list and motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.options import JsonOptions, PlaneOptions, require_file, require_folder

if TYPE_CHECKING:
    from fiberloom.planning import Plan

TargetsArgument = Annotated[Path, typer.Argument(help="CSV, ECSV, FITS or SDSS confSummary file.")]


@dataclass(frozen=True, kw_only=True)
class AssignOptions(PlaneOptions, JsonOptions):
    """Of `fiberloom assign`."""

    targets: TargetsArgument
    out: Annotated[Path, typer.Option(help="Configuration to write.")] = Path("goal.csv")


def assign(options: AssignOptions) -> None:
    """Choose a target for each positioner; write the configuration as CSV."""
    from fiberloom.targets import read_targets

    options.check_plane()
    wanted = read_targets(options.targets)
    require_folder(options.out.parent)
    from fiberloom.assignment import assign_relaxed
    from fiberloom.planning import write_configuration

    plane = options.plane()
    _, found = assign_relaxed(plane, wanted, seed=options.seed)
    write_configuration(options.out, plane.positioner_id, found.goal_deg)
    left_out = [f"{wanted.target_id[k]}: {why}" for k, why in sorted(found.unassigned.items())]
    options.show(
        {
            "targets": len(wanted),
            "assigned": found.n_assigned,
            "positioners": len(plane),
            "notes": found.notes,
            "not_assigned": _some(left_out),
            "configuration": str(options.out),
        }
    )


@dataclass(frozen=True, kw_only=True)
class PlanOptions(PlaneOptions, JsonOptions):
    """Of `fiberloom plan`."""

    start: Annotated[Path, typer.Option(help="Configuration CSV: positioner_id,alpha_deg,beta_deg.")]
    goal: Annotated[Path, typer.Option(help="Configuration CSV to reach.")]
    out: Annotated[Path, typer.Option(help="Trajectories to write.")] = Path("trajectories.json")


def plan(options: PlanOptions) -> int:
    """Plan collision-free trajectories from one configuration to another.

    Exit code 1 where a positioner does not arrive, or the plan is not verified and not written.
    """
    require_file(options.start)
    require_file(options.goal)
    options.check_plane()
    from fiberloom import planning

    plane = options.plane()
    start_deg, goal_deg = (planning.read_configuration(f, plane) for f in (options.start, options.goal))
    require_folder(options.out.parent)
    planned = planning.plan(plane, start_deg, goal_deg, seed=options.seed)
    checked = planning.verify(plane, planned)
    if not checked.ok:
        options.show(_verdict([planned], [checked]) | {"trajectories": "not written"})
        return 1
    from fiberloom.report.outputs import marks

    planned.save(options.out, **marks(plane, options.seed))
    options.show(
        {
            "robots": len(plane),
            "arrived": len(plane) - len(planned.refused),
            "not_arrived": list(planned.refused.values()),
            "motion_s": planned.duration_s,
            "cpu_s": planned.cpu_s,
            "verified": checked.ok,
            "trajectories": str(options.out),
        }
    )
    return 1 if planned.refused else 0


@dataclass(frozen=True, kw_only=True)
class VerifyOptions(PlaneOptions, JsonOptions):
    """Of `fiberloom verify`."""

    trajectories: Annotated[Path, typer.Argument(help="trajectories.json of `plan` or `observe`.")]


def verify(options: VerifyOptions) -> int:
    """Check trajectories in continuous time: clearances, limits, speeds, accelerations.

    Exit code 1 where the trajectories are not verified.
    """
    require_file(options.trajectories)
    options.check_plane()
    from fiberloom import planning

    plane = options.plane()
    plans = planning.read_plans(options.trajectories, plane)
    verdict = _verdict(plans, [planning.verify(plane, p) for p in plans])
    options.show(verdict)
    return 0 if verdict["verified"] else 1


def _verdict(plans: Sequence[Plan], checks: Sequence[Any]) -> dict[str, Any]:
    return {
        "plans": len(plans),
        "verified": all(check.ok for check in checks),
        "collisions": sum(len(check.collisions) for check in checks),
        "violations": _some([str(v) for check in checks for v in check.violations]),
        "min_clearance_mm": min((c.min_clearance_mm for c in checks), default=float("nan")),
    }


def _some(lines: list[str], most: int = 10) -> list[str]:
    more = len(lines) - most
    return lines if more <= 0 else [*lines[:most], f"... and {more} more"]
