"""`fiberloom calibrate friction|inertia|coast|stiffness|arms|repeatability`: measure, identify, write."""

from __future__ import annotations

import json
import sys
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.calibrate.bench import BenchOptions, CreepOptions, counting, on_bench
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError
from fiberloom.wholefile import write_whole

if TYPE_CHECKING:
    from fiberloom.calibration import (
        ArmsSettings,
        CoastSettings,
        FrictionSettings,
        InertiaSettings,
        RepeatabilitySettings,
        StiffnessSettings,
        TorqueScale,
    )
    from fiberloom.calibration.bench.bench import Progress
    from fiberloom.calibration.bench.estimate import Estimate
    from fiberloom.calibration.bench.rig import BenchRig
    from fiberloom.instruments import FocalPlane


@dataclass(frozen=True)
class MeasuredUnit:
    """Result of a measurement."""

    estimates: Sequence[Estimate]
    draw: Callable[[Path, int], None]
    """Draws the figure of one row into a file."""


@dataclass(frozen=True)
class Task:
    """Input of a measurement."""

    rig: BenchRig
    plane: FocalPlane
    progress: Progress


Work = Callable[[Task], Awaitable[MeasuredUnit]]


@dataclass(frozen=True, kw_only=True)
class IdentificationOptions(BenchOptions):
    """Of every identification."""

    truth: Annotated[bool, typer.Option("--truth", help="Compare with the true values of the twin.")] = False


@dataclass(frozen=True, kw_only=True)
class WeightsOptions(BenchOptions):
    """Of an identification that needs the motor's torque."""

    weights: Annotated[
        bool,
        typer.Option(
            "--weights/--data-sheet", help="Torques by known weights, or by the motor's data sheet."
        ),
    ] = True


@dataclass(frozen=True, kw_only=True)
class FrictionOptions(IdentificationOptions, WeightsOptions, CreepOptions):
    """Of `calibrate friction`."""

    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/friction")


def friction(options: FrictionOptions) -> int:
    """Coulomb friction, spring, cogging and drag (Kronig 2020, Fig. 11 and 12).

    Exit code 1 where an estimate of a positioner is refused.
    """
    options.check(options.out)
    from fiberloom.calibration import FrictionSettings

    settings = FrictionSettings(n_angles=options.places, run_span_deg=options.span)
    return _identify("friction", options, options.out, friction_work(settings, options.weights))


def friction_work(settings: FrictionSettings, weights: bool) -> Work:
    """Measures and identifies."""
    from fiberloom.calibration import identify_friction, measure_friction
    from fiberloom.report.identification import plot_friction

    async def work(task: Task) -> MeasuredUnit:
        scales, found = await _scales(task, weights)
        data = await measure_friction(task.rig.client, None, task.plane, settings, task.progress)
        both = [identify_friction(d, s) for d, s in zip(data, scales, strict=True)]
        return MeasuredUnit(
            [*found, *(e for axis in both for e in axis.estimates)],
            lambda file, row: plot_friction(file, task.plane, data, both, scales, row),
        )

    return work


@dataclass(frozen=True, kw_only=True)
class InertiaOptions(IdentificationOptions, WeightsOptions):
    """Of `calibrate inertia`."""

    pushes: Annotated[int, typer.Option(min=2, help="Torque steps, half of them upward.")] = 6
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/inertia")


def inertia(options: InertiaOptions) -> int:
    """Inertia from steps of torque (Kronig 2020, Eq. 12 and Fig. 14).

    Exit code 1 where an estimate of a positioner is refused.
    """
    options.check(options.out)
    from fiberloom.calibration import InertiaSettings

    settings = InertiaSettings(pushes=options.pushes)
    return _identify("inertia", options, options.out, inertia_work(settings, options.weights))


def inertia_work(settings: InertiaSettings, weights: bool) -> Work:
    """Measures and identifies."""
    from fiberloom.calibration import identify_inertia, measure_inertia
    from fiberloom.report.identification import plot_inertia

    async def work(task: Task) -> MeasuredUnit:
        scales, found = await _scales(task, weights)
        data = await measure_inertia(task.rig.client, None, task.plane, settings, task.progress)
        both = [identify_inertia(d, s) for d, s in zip(data, scales, strict=True)]
        return MeasuredUnit(
            [*found, *(e for axis in both for e in (axis.inertia, axis.drag))],
            lambda file, row: plot_inertia(file, task.plane, data, both, scales, row),
        )

    return work


@dataclass(frozen=True, kw_only=True)
class CoastOptions(IdentificationOptions, WeightsOptions):
    """Of `calibrate coast`."""

    repeats: Annotated[
        int, typer.Option(min=1, help="Times four coasts: up and down, bridge open and shorted.")
    ] = 4
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/coast")


def coast(options: CoastOptions) -> int:
    """Back-EMF and friction apart, from coasting with the bridge open and shorted.

    The inertia is measured first: coasting alone gives ratios to it. Exit code 1 where an estimate of a
    positioner is refused; a board that cannot open its bridges is.
    """
    options.check(options.out)
    from fiberloom.calibration import CoastSettings

    settings = CoastSettings(repeats=options.repeats)
    return _identify("coast", options, options.out, coast_work(settings, options.weights))


def coast_work(settings: CoastSettings, weights: bool) -> Work:
    """Measures and identifies."""
    from fiberloom.calibration import identify_coast, identify_inertia, measure_coast, measure_inertia
    from fiberloom.report.identification import plot_coast

    async def work(task: Task) -> MeasuredUnit:
        scales, found = await _scales(task, weights)
        pushes = await measure_inertia(task.rig.client, None, task.plane, progress=task.progress)
        inertias = [identify_inertia(d, s).inertia for d, s in zip(pushes, scales, strict=True)]
        data = await measure_coast(task.rig.client, None, task.plane, settings, task.progress)
        both = [identify_coast(d, j) for d, j in zip(data, inertias, strict=True)]
        return MeasuredUnit(
            [*found, *inertias, *(e for axis in both for e in axis.estimates)],
            lambda file, row: plot_coast(file, task.plane, data, both, row),
        )

    return work


@dataclass(frozen=True, kw_only=True)
class StiffnessOptions(IdentificationOptions):
    """Of `calibrate stiffness`."""

    repeats: Annotated[int, typer.Option(min=3, help="How often to pull to each side.")] = 10
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/stiffness")


def stiffness(options: StiffnessOptions) -> int:
    """Stiffness from a known torque to both sides (Kronig 2020, Fig. 13).

    Exit code 1 where an estimate of a positioner is refused.
    """
    options.check(options.out)
    from fiberloom.calibration import StiffnessSettings

    settings = StiffnessSettings(repeats=options.repeats)
    return _identify("stiffness", options, options.out, stiffness_work(settings))


def stiffness_work(settings: StiffnessSettings) -> Work:
    """Measures and identifies."""
    from fiberloom.calibration import identify_stiffness, measure_stiffness
    from fiberloom.report.identification import plot_stiffness

    async def work(task: Task) -> MeasuredUnit:
        rig = task.rig
        data = await measure_stiffness(
            rig.client, rig.camera, rig.weights, task.plane, settings, task.progress
        )
        both = [identify_stiffness(d) for d in data]
        return MeasuredUnit(both, lambda file, row: plot_stiffness(file, task.plane, data, both, row))

    return work


@dataclass(frozen=True, kw_only=True)
class ArmsOptions(IdentificationOptions):
    """Of `calibrate arms`."""

    points: Annotated[int, typer.Option(min=8, help="Points on each circle.")] = 40
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/arms")


def arms(options: ArmsOptions) -> int:
    """Arm lengths and centre from the circles of both axes.

    Exit code 1 where an estimate of a positioner is refused.
    """
    options.check(options.out)
    from fiberloom.calibration import ArmsSettings

    settings = ArmsSettings(n_points=options.points)
    return _identify("arms", options, options.out, arms_work(settings))


def arms_work(settings: ArmsSettings) -> Work:
    """Measures and identifies."""
    from fiberloom.calibration import identify_arms, measure_arms
    from fiberloom.report.identification import plot_arms

    async def work(task: Task) -> MeasuredUnit:
        data = await measure_arms(task.rig.client, task.rig.camera, task.plane, settings, task.progress)
        found = identify_arms(data)
        return MeasuredUnit(
            list(found.estimates), lambda file, row: plot_arms(file, task.plane, data, found, row)
        )

    return work


@dataclass(frozen=True, kw_only=True)
class RepeatabilityOptions(IdentificationOptions):
    """Of `calibrate repeatability`."""

    visits: Annotated[int, typer.Option(min=5, help="Visits to each of three targets.")] = 300
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/repeatability")


def repeatability(options: RepeatabilityOptions) -> int:
    """Three targets 1 um apart, visited again and again (Kronig 2020, Fig. 17).

    Exit code 1 where an estimate of a positioner is refused.
    """
    options.check(options.out)
    from fiberloom.calibration import RepeatabilitySettings

    settings = RepeatabilitySettings(visits=options.visits)
    return _identify("repeatability", options, options.out, repeatability_work(settings))


def repeatability_work(settings: RepeatabilitySettings) -> Work:
    """Measures and identifies."""
    from fiberloom.calibration import identify_repeatability, measure_repeatability
    from fiberloom.report.identification import plot_repeatability

    async def work(task: Task) -> MeasuredUnit:
        rig = task.rig
        data = await measure_repeatability(rig.client, rig.close_up, task.plane, settings, task.progress)
        both = [identify_repeatability(d, rig.close_up_um) for d in data]
        return MeasuredUnit(
            [e for axis in both for e in (axis.measured, axis.own, axis.angle)],
            lambda file, row: plot_repeatability(file, task.plane, data, both, row),
        )

    return work


async def _scales(task: Task, weights: bool) -> tuple[list[TorqueScale], list[Estimate]]:
    """Torque scales of both axes, by weights or by the data sheet."""
    from fiberloom.calibration import (
        data_sheet_scale,
        identify_torque_scale,
        measure_torque_scale,
        measured_scale,
    )

    if not weights:
        return [data_sheet_scale(task.plane, axis) for axis in range(2)], []
    rig = task.rig
    data = await measure_torque_scale(rig.client, None, rig.weights, task.plane, progress=task.progress)
    found = [identify_torque_scale(d) for d in data]
    return [measured_scale(e) for e in found], found


def _identify(name: str, options: IdentificationOptions, out: Path, work: Work) -> int:
    """Measures on the bench; writes NAME.json, NAME.ecsv and NAME.png.

    Returns 0 where every positioner has all its estimates, else 1.
    """
    plane = options.plane()
    rig, units = options.rig(plane)
    with waiting(options.as_json) as wait:
        wait.say(f"measuring {name}")
        try:
            measured = on_bench(rig, lambda rig: work(Task(rig, plane, counting(wait.count))))
        except InputError as error:
            ids = ", ".join(map(str, plane.positioner_id[:3]))
            raise InputError(f"calibrate {name}, positioner {ids}: {error}") from None
    import numpy as np

    from fiberloom.report.estimates import estimate_records
    from fiberloom.store.calibrations import record_calibration
    from fiberloom.twin.truth import true_values

    truth = true_values(plane, units) if options.truth else {}
    content = estimate_records(plane, options.seed, measured.estimates, truth)
    _write(name, options, out, content)
    whole = plane.positioner_id[np.all([e.ok for e in measured.estimates], axis=0)]
    record_calibration(out / f"{name}.json", name, whole, content, " ".join(sys.argv))
    measured.draw(out / f"{name}.png", complete_row(measured.estimates))
    return 1 if any(any(e.reason) for e in measured.estimates) else 0


def _write(name: str, options: IdentificationOptions, out: Path, content: dict[str, Any]) -> None:
    from fiberloom.report.estimates import estimate_rows
    from fiberloom.report.tables import print_estimates
    from fiberloom.tables import write_ecsv

    write_whole(out / f"{name}.json", json.dumps(content, indent=2) + "\n")
    head = {key: value for key, value in content.items() if key != "positioners"}
    write_ecsv(out / f"{name}.ecsv", estimate_rows(content), head)
    if options.as_json:
        options.print_json(content)
    else:
        print_estimates(estimate_rows(content))
        typer.echo(f"results in {out}/: {name}.json, {name}.ecsv, {name}.png")


def complete_row(estimates: Sequence[Estimate]) -> int:
    """Row of the first positioner that has all estimates, else 0."""
    import numpy as np

    return int(np.argmax(np.all([e.ok for e in estimates], axis=0)))
