"""`fiberloom assign`, `plan` and `verify`: the single steps between a target list and motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.options import (
    JsonOptions,
    PlaneOptions,
    SupplyOptions,
    interruptible,
    naming,
    require_file,
)
from fiberloom.cli.terminal import Waiting, waiting
from fiberloom.errors import InputError

if TYPE_CHECKING:
    from fiberloom.assignment import Assignment
    from fiberloom.instruments import FocalPlane
    from fiberloom.planning import LateVerification, Plan, PlanSettings, Verification
    from fiberloom.targets import TargetList
    from fiberloom.typing import Floats

TargetsArgument = Annotated[Path, typer.Argument(help="CSV, ECSV, FITS or SDSS confSummary file.")]


@dataclass(frozen=True, kw_only=True)
class ChoiceOptions:
    """Of a command that chooses targets."""

    strict: Annotated[
        bool, typer.Option("--strict", help="No number of targets outweighs one of a higher priority.")
    ] = False
    field: Annotated[
        Path | None,
        typer.Option(help="Field of a list with ra and dec, TOML: centre, time, exposure, site, weather."),
    ] = None

    def read_targets(self, path: Path, instrument: str) -> TargetList:
        """The list, in mm; `instrument`: whose optics lead from the sky to the focal plane."""
        from fiberloom.targets import read_targets

        require_file(self.field)
        return read_targets(path, self.field, instrument)


@dataclass(frozen=True, kw_only=True)
class AssignOptions(ChoiceOptions, PlaneOptions, JsonOptions):
    """Of `fiberloom assign`."""

    targets: TargetsArgument
    start: Annotated[
        Path | None,
        typer.Option(
            help="Configuration CSV where the positioners are: of equally good choices that of the shortest "
            "ways."
        ),
    ] = None
    swap: Annotated[
        bool,
        typer.Option(
            "--swap/--no-swap",
            help="With --start: plan the motion, and swap targets where positioners are refused or late.",
        ),
    ] = True
    out: Annotated[Path, typer.Option(help="Configuration to write.")] = Path("goal.csv")


UNASSIGNED = "unassigned.ecsv"
"""Beside the configuration: the targets without a positioner."""


def assign(options: AssignOptions) -> int:
    """Choose a target for each positioner; write the configuration and what was left out.

    Exit code 1 where no positioner has a target.
    """
    from fiberloom.report.folder import prepare_file

    options.check_plane()
    require_file(options.start)
    wanted = options.read_targets(options.targets, options.instrument)
    left_out = options.out.with_name(UNASSIGNED)
    for path in (options.out, left_out):
        prepare_file(path, inputs=(options.targets, options.start, options.field))
    plane = options.plane()
    with interruptible("nothing was written"), waiting(options.as_json) as wait:
        found, motion = _assigned(options, plane, wanted, wait)
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
        | motion
    )
    return 0 if found.n_assigned else 1


def _assigned(
    options: AssignOptions, plane: FocalPlane, wanted: TargetList, wait: Waiting
) -> tuple[Assignment, dict[str, Any]]:
    """The assignment and, where the start is known, what is to be told of the motion."""
    from fiberloom.assignment import AssignSettings, SwapSettings, assign_relaxed, swap_targets
    from fiberloom.drive.way_rules import way_rule
    from fiberloom.planning import bound_s, read_configuration

    start_deg = None if options.start is None else read_configuration(options.start, plane)
    how = AssignSettings(strict=options.strict, progress=wait.say, ways=way_rule(plane))
    with naming(options.targets):
        kept, found = assign_relaxed(plane, wanted, seed=options.seed, start_deg=start_deg, settings=how)
    if start_deg is None:
        return found, {}
    if not options.swap:
        return found, {"bound_s": bound_s(kept, start_deg, found.goal_deg)}
    how_hard = SwapSettings(progress=wait.say)
    swapped = swap_targets(kept, wanted, found, start_deg, seed=options.seed, settings=how_hard)
    made = swapped.plan
    return swapped.assignment, {
        "bound_s": bound_s(kept, start_deg, swapped.assignment.goal_deg, refused=made.refused),
        "motion_s": made.duration_s,
        "motion_without_swaps_s": swapped.first.duration_s,
        "not_arrived": [why for _, why in sorted(made.refused.items())],
        "plans": swapped.n_plans,
        "cpu_s": swapped.cpu_s,
    }


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
class AtOnceOptions(SupplyOptions):
    """Of a command that keeps how many positioners move at once."""

    at_once: Annotated[
        int | None,
        typer.Option(min=1, help="Positioners that move at the same time, at most: a plan comes in waves."),
    ] = None

    def fed(self, plane: FocalPlane, plans: Sequence[Plan]) -> tuple[bool, dict[str, Any]]:
        """Whether all plans keep the limits, by the proof of the supply; and what is to be told of it."""
        from fiberloom.planning import verify_supply

        counted = [verify_supply(plane, made, at_once=self.at_once) for made in plans]
        told: dict[str, Any] = {"most_at_once": max((c.most_at_once for c in counted), default=0)}
        supply_A = plane.instrument.care.supply_A
        if supply_A is not None:
            peak_A = max((c.peak_A for c in counted), default=0.0)
            told |= {"peak_A": peak_A, "supply_A": supply_A}
            if self.power is not None:
                told |= {"peak_W": self.power * peak_A / supply_A, "power_W": self.power}
        beyond = [str(c) for c in counted if not c.ok]
        return not beyond, told | ({"beyond_the_supply": _some(beyond)} if beyond else {})


@dataclass(frozen=True, kw_only=True)
class PlanOptions(AtOnceOptions, JsonOptions):
    """Of `fiberloom plan`."""

    start: Annotated[Path, typer.Option(help="Configuration CSV: positioner_id,alpha_deg,beta_deg.")]
    goal: Annotated[Path, typer.Option(help="Configuration CSV to reach.")]
    buffer: Annotated[
        float | None, typer.Option(help="Collision buffer to plan with, mm; default: the instrument's.")
    ] = None
    budget: Annotated[
        float | None,
        typer.Option(
            help="Processor time to plan with, s; then the best plan so far. Default: what it needs."
        ),
    ] = None
    late: Annotated[
        float,
        typer.Option(
            help="Any one positioner may be late by so many seconds and touches none that is on time; inf: "
            "it may stop on its way. As far as it can be had; the table says which pairs cannot bear it."
        ),
    ] = 0.0
    most_frames: Annotated[
        int | None,
        typer.Option(help="Frames to load the trajectories at most; a plan that takes more is not written."),
    ] = None
    out: Annotated[Path, typer.Option(help="Trajectories to write.")] = Path("trajectories.json")
    animate: Annotated[
        Path | None, typer.Option(help="Film of the motion to write, .gif or .mp4 (needs ffmpeg).")
    ] = None

    def check(self) -> None:
        """Raises InputError for what can be found wrong without a slow import."""
        require_file(self.start)
        require_file(self.goal)
        self.check_plane()
        _require_buffer(self.buffer)
        if self.budget is not None and not 0.0 < self.budget < math.inf:
            raise InputError(f"--budget {self.budget:g}: must be a finite number above 0 s")
        if self.most_frames is not None and self.most_frames < 1:
            raise InputError(f"--most-frames {self.most_frames}: must be 1 or more")
        if not self.late >= 0.0:
            raise InputError(f"--late {self.late:g}: must be a number of seconds from 0 on, or inf")
        if self.animate is not None:
            from fiberloom.report.film.formats import require_film

            require_film("--animate", self.animate)

    def prepare(self) -> None:
        """Proves that what is written can be, and is not what is read, before anything long starts."""
        from fiberloom.report.folder import prepare_file

        prepare_file(self.out, inputs=(self.start, self.goal))
        if self.animate is None:
            return
        prepare_file(self.animate, "--animate", (self.start, self.goal))
        if self.animate.resolve() == self.out.resolve():
            raise InputError(f"--animate {self.animate}: is --out too; give another name")


@dataclass(frozen=True, eq=False)
class _Planned:
    """A plan with what it was made from, and what the verifier says of it."""

    plane: FocalPlane
    start_deg: Floats
    goal_deg: Floats
    settings: PlanSettings
    plan: Plan
    checked: Verification
    late: LateVerification | None = None
    """Where it was asked for."""
    on_time_s: float | None = None
    """How long the motion would be if it had not been."""

    def report(self) -> dict[str, Any]:
        """What a plan comes to, for operators and for machines."""
        from fiberloom.planning import bound_s

        n, made = self.plane.n, self.plan
        ends, refused = (self.start_deg, self.goal_deg), made.refused
        least_s = bound_s(self.plane, *ends, settings=self.settings, refused=refused)
        points = made.points_per_axis
        gap_mm = self.checked.min_clearance_mm
        return {
            "robots": n,
            "arrived": n - len(refused),
            "not_arrived": [why for _, why in sorted(refused.items())],
            "own_approach": {str(number): str(own) for number, own in made.approaches.items()},
            "notes": self.notes(),
            "buffer_mm": made.collision_buffer_mm,
            "bound_s": least_s,
            "motion_s": made.duration_s,
            "motion_over_bound": made.duration_s / least_s if least_s else None,
            "cpu_s": made.cpu_s,
            "points_per_axis_mean": sum(points) / max(1, len(points)),
            "points_per_axis_worst": max(points, default=0),
            **self.frames(),
            "min_clearance_mm": gap_mm if math.isfinite(gap_mm) else None,
            "verified": self.checked.ok,
        } | self.late_report()

    def frames(self) -> dict[str, Any]:
        """What loading takes; the time, where the motors understand the frames of SDSS-V."""
        from fiberloom.drive.sdssv.frame_budget import frame_budget

        takes = frame_budget(self.plan)
        sdssv = self.plane.instrument.drive.protocol == "sdssv"
        return {"frames": takes.frames} | ({"wire_s": takes.wire_s} if sdssv else {})

    def late_report(self) -> dict[str, Any]:
        """What it costs that one may be late, and which pairs cannot bear it."""
        if self.late is None:
            return {}
        without_s = {} if self.on_time_s is None else {"motion_if_none_is_late_s": self.on_time_s}
        pairs = _some([f"{first} and {second}" for first, second in self.late.failing_pairs], 5)
        return {
            "late_s": self.late.late_s if math.isfinite(self.late.late_s) else "for good",
            **without_s,
            "pairs_that_can_meet": self.late.n_pairs,
            "pairs_that_cannot_bear_it": len(self.late.failing_pairs),
            "cannot_bear_it": pairs,
        }

    def notes(self) -> list[str]:
        """What an operator should know before the trajectories are sent."""
        from fiberloom.planning.trajectories import least_buffer_mm

        plane, has_mm = self.plane, self.plan.collision_buffer_mm
        notes = []
        if has_mm < plane.collision_buffer_mm:
            only = has_mm < least_buffer_mm(plane) - 1e-9
            hint = f"; `fiberloom verify` takes the file with --buffer {has_mm:g} only" if only else ""
            notes.append(
                f"planned with a buffer of {has_mm:g} mm, below the {plane.collision_buffer_mm:g} mm of "
                f"{plane.instrument.name}: arms come nearer than the instrument allows{hint}"
            )
        if self.plan.statistics.get("cut_short"):
            notes.append(
                f"the budget of {self.settings.budget_s:g} s was used up: positioners that still met others "
                "are given up, and motions may be longer than they need be"
            )
        if plane.offline.any():
            names = ", ".join(map(str, plane.positioner_id[plane.offline]))
            notes.append(f"offline, stay where they are: positioner {names}")
        if self.checked.contacts:
            notes += _some([f"overlap, and stay: {contact}" for contact in self.checked.contacts])
            wide = has_mm > plane.collision_buffer_mm
            recover = "`fiberloom recover` takes arms apart that touch"
            notes.append("a smaller --buffer may let them move" if wide else recover)
        return notes

    def film(self, path: Path, wait: Waiting) -> None:
        """Writes the motion as a film."""
        from fiberloom.report.film.film import film_title, write_film
        from fiberloom.report.film.moments import Moments

        wait.say("drawing the film")
        shown = Moments(self.plane, self.plan, self.goal_deg)
        write_film(path, shown, film_title(shown, self.checked), wait.count)


def plan(options: PlanOptions) -> int:
    """Plan collision-free trajectories from one configuration to another.

    Exit code 1 where a positioner does not arrive, or the plan is not verified and not written.
    """
    options.check()
    from fiberloom import planning

    plane = options.plane()
    start_deg, goal_deg = (planning.read_configuration(f, plane) for f in (options.start, options.goal))
    options.prepare()
    with interruptible("nothing was written"), waiting(options.as_json) as wait:
        found = _planned(options, plane, (start_deg, goal_deg), wait)
    fed, supply = options.fed(plane, [found.plan])
    if not (found.checked.ok and fed):
        options.show(_verdict([found.plan], [found.checked], fed) | supply | {"trajectories": "not written"})
        return 1
    _require_frames(found.frames()["frames"], options.most_frames)
    from fiberloom.report.outputs import marks

    found.plan.save(options.out, **marks(plane, options.seed))
    report = found.report() | supply | {"trajectories": str(options.out)}
    if options.animate is not None:
        try:
            kept = f"the trajectories are in {options.out}, the film is not made"
            with interruptible(kept), waiting(options.as_json) as wait:
                found.film(options.animate, wait)
        except InputError:  # the trajectories are there all the same
            options.show(report | {"film": "not made"})
            raise
        report["film"] = str(options.animate)
    options.show(report)
    return 1 if found.plan.refused else 0


def _planned(options: PlanOptions, plane: FocalPlane, ends: tuple[Floats, Floats], wait: Waiting) -> _Planned:
    """Plans, and has the verifier check the plan with the same buffer."""
    from fiberloom import planning

    def told(stage: str, done: int, total: int) -> None:
        wait.say(stage)
        wait.count(done, total)

    wait.say(f"planning {plane.n} trajectories")
    asked = planning.PlanSettings(
        collision_buffer_mm=options.buffer, budget_s=options.budget, late_s=options.late, progress=told
    )
    settings = asked.of(plane)
    made = _made(options, plane, ends, settings)
    wait.say("verifying them in continuous time")
    limits = planning.MotionLimits(collision_buffer_mm=settings.collision_buffer_mm)
    checked = planning.verify(plane, made, goal_deg=ends[1], limits=limits)
    if not options.late:
        return _Planned(plane, *ends, settings, made, checked)
    wait.say("looking at each of them being late")
    late = planning.verify_late(plane, made, options.late)
    on_time_s = None
    if options.budget is None:
        wait.say("planning once more, as if none were ever late")
        on_time = _made(options, plane, ends, replace(settings, late_s=0.0))
        on_time_s = on_time.duration_s
    return _Planned(plane, *ends, settings, made, checked, late, on_time_s)


def _made(
    options: PlanOptions, plane: FocalPlane, ends: tuple[Floats, Floats], settings: PlanSettings
) -> Plan:
    """A plan within what the supply gives, and with no more at once than may be."""
    from fiberloom.planning import plan as all_together
    from fiberloom.planning.supply import plan_in_waves, plan_within_supply

    def slowed(share: float) -> PlanSettings:
        return replace(settings, speed_deg_s=share * (settings.speed_deg_s or 0.0), grid_deg=None).of(plane)

    def in_waves(most: int, share: float) -> Plan:
        return plan_in_waves(plane, *ends, most=most, seed=options.seed, settings=slowed(share))

    def at_share(share: float) -> Plan:
        if options.at_once is not None:
            return in_waves(options.at_once, share)
        return all_together(plane, *ends, seed=options.seed, settings=slowed(share))

    fewer = options.at_once or len(plane)
    return plan_within_supply(
        plane.instrument, at_share, lambda most, share: in_waves(min(most, fewer), share)
    )


@dataclass(frozen=True, kw_only=True)
class VerifyOptions(AtOnceOptions, JsonOptions):
    """Of `fiberloom verify`."""

    trajectories: Annotated[Path, typer.Argument(help="trajectories.json of `plan` or `observe`.")]
    buffer: Annotated[
        float | None,
        typer.Option(
            help="Collision buffer to check with, mm; default: the file's, if the instrument's or more."
        ),
    ] = None


def verify(options: VerifyOptions) -> int:
    """Check trajectories in continuous time: clearances, limits, speeds, accelerations, the supply.

    Exit code 1 where the trajectories are not verified.
    """
    require_file(options.trajectories)
    options.check_plane()
    _require_buffer(options.buffer)
    from fiberloom import planning

    plane, asked_mm = options.plane(), options.buffer
    plans = planning.read_plans(options.trajectories, plane, buffer_mm=asked_mm)
    limits = planning.MotionLimits(collision_buffer_mm=asked_mm)
    fed, supply = options.fed(plane, plans)
    verdict = _verdict(plans, [planning.verify(plane, p, limits=limits) for p in plans], fed) | supply
    file_mm = min(p.collision_buffer_mm for p in plans)
    verdict |= {
        "checked_with_buffer_mm": file_mm if asked_mm is None else asked_mm,
        "buffer_of_file_mm": file_mm,
        "buffer_of_instrument_mm": plane.collision_buffer_mm,
    }
    options.show(verdict)
    return 0 if verdict["verified"] else 1


def _require_buffer(asked_mm: float | None) -> None:
    """Raises InputError for a buffer that no arm can have."""
    if asked_mm is not None and not 0.0 < asked_mm < math.inf:
        raise InputError(f"--buffer {asked_mm:g}: must be a finite number above 0 mm")


def _require_frames(needed: int, most: int | None) -> None:
    """Raises InputError for a plan with more frames than asked for."""
    if most is not None and needed > most:
        raise InputError(
            f"--most-frames {most}: this plan takes {needed} frames; not written. Allow more, or move fewer "
            "positioners"
        )


def _verdict(plans: Sequence[Plan], checks: Sequence[Any], fed: bool) -> dict[str, Any]:
    """What the verifier found; `fed`: the supply is enough, and no more move at once than may."""
    return {
        "plans": len(plans),
        "verified": fed and all(check.ok for check in checks),
        "collisions": sum(len(check.collisions) for check in checks),
        "violations": _some([str(v) for check in checks for v in check.violations]),
        "min_clearance_mm": min((c.min_clearance_mm for c in checks), default=float("nan")),
    }


def _some(lines: list[str], most: int = 10) -> list[str]:
    more = len(lines) - most
    return lines if more <= 0 else [*lines[:most], f"... and {more} more"]
