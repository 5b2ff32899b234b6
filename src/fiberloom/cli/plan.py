"""`fiberloom assign`, `plan` and `verify`: the single steps between a target list and motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.options import JsonOptions, PlaneOptions, naming, require_file, require_folder
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError

if TYPE_CHECKING:
    from fiberloom.assignment import Assignment
    from fiberloom.instruments import FocalPlane
    from fiberloom.planning import Plan
    from fiberloom.targets import TargetList

TargetsArgument = Annotated[Path, typer.Argument(help="CSV, ECSV, FITS or SDSS confSummary file.")]


@dataclass(frozen=True, kw_only=True)
class AssignOptions(PlaneOptions, JsonOptions):
    """Of `fiberloom assign`."""

    targets: TargetsArgument
    out: Annotated[Path, typer.Option(help="Configuration to write.")] = Path("goal.csv")


UNASSIGNED = "unassigned.ecsv"
"""Beside the configuration: the targets without a positioner."""


def assign(options: AssignOptions) -> int:
    """Choose a target for each positioner; write the configuration and what was left out.

    Exit code 1 where no positioner has a target.
    """
    from fiberloom.targets import read_targets

    options.check_plane()
    wanted = read_targets(options.targets)
    require_folder(options.out.parent)
    from fiberloom.assignment import assign_relaxed

    plane = options.plane()
    with waiting(options.as_json) as wait, naming(options.targets):
        _, found = assign_relaxed(plane, wanted, seed=options.seed, progress=wait.say)
    left_out = options.out.with_name(UNASSIGNED)
    _write(options, plane, wanted, found)
    options.show(
        {
            "targets": len(wanted),
            "assigned": found.n_assigned,
            "positioners": len(plane),
            "notes": found.notes,
            "not_assigned": found.reasons(),
            "configuration": str(options.out),
            "left_out": str(left_out),
        }
    )
    return 0 if found.n_assigned else 1


def _write(options: AssignOptions, plane: FocalPlane, wanted: TargetList, found: Assignment) -> None:
    """The configuration with who takes what, and the targets that no positioner takes."""
    from fiberloom.planning import write_configuration
    from fiberloom.report.outputs import marks
    from fiberloom.tables import write_columns

    has = found.target >= 0
    rows = found.target.tolist()
    taken = {
        "target_id": [str(wanted.target_id[k]) if k >= 0 else "" for k in rows],
        "fibre": [str(fibre) if mine else "" for fibre, mine in zip(found.fibre, has, strict=True)],
        "priority": [f"{wanted.priority[k]:g}" if k >= 0 else "" for k in rows],
    }
    write_configuration(options.out, plane.positioner_id, found.goal_deg, taken)
    left = sorted(found.unassigned)
    columns = {
        "target_id": [str(wanted.target_id[k]) for k in left],
        "reason": [found.unassigned[k] for k in left],
    }
    write_columns(options.out.with_name(UNASSIGNED), columns, marks(plane, options.seed))


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
    with waiting(options.as_json) as wait:

        def told(stage: str, done: int, total: int) -> None:
            wait.say(stage)
            wait.count(done, total)

        wait.say(f"planning {plane.n} trajectories")
        settings = planning.PlanSettings(progress=told)
        planned = planning.plan(plane, start_deg, goal_deg, seed=options.seed, settings=settings)
        wait.say("verifying them in continuous time")
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
            "own_approach": {str(number): str(own) for number, own in planned.approaches.items()},
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
    buffer: Annotated[
        float | None,
        typer.Option(
            help="Collision buffer to check with, mm; default: the file's, if the instrument's or more."
        ),
    ] = None


def verify(options: VerifyOptions) -> int:
    """Check trajectories in continuous time: clearances, limits, speeds, accelerations.

    Exit code 1 where the trajectories are not verified.
    """
    require_file(options.trajectories)
    options.check_plane()
    from fiberloom import planning

    plane, asked_mm = options.plane(), options.buffer
    if asked_mm is not None and not 0.0 < asked_mm < float("inf"):
        raise InputError(f"--buffer {asked_mm:g}: must be above 0 mm")
    plans = planning.read_plans(options.trajectories, plane, buffer_mm=asked_mm)
    limits = planning.MotionLimits(collision_buffer_mm=asked_mm)
    verdict = _verdict(plans, [planning.verify(plane, p, limits=limits) for p in plans])
    file_mm = min(p.collision_buffer_mm for p in plans)
    verdict |= {
        "checked_with_buffer_mm": file_mm if asked_mm is None else asked_mm,
        "buffer_of_file_mm": file_mm,
        "buffer_of_instrument_mm": plane.collision_buffer_mm,
    }
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
