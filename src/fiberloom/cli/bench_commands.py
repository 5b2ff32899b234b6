"""Commands for a bench: identification of single units, and their acceptance."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from fiberloom.cli.options import InstrumentOption, JsonOption, LayoutOption, SeedOption, read_plane


def register(app: typer.Typer, calibrate: typer.Typer) -> None:
    """Adds them to the command line."""
    for command in (friction, inertia, stiffness, arms, repeatability):
        calibrate.command()(command)
    app.command()(acceptance)


BenchPositioners = Annotated[
    int | None, typer.Option(min=1, help="So many positioners of the preset on the bench, from the centre.")
]
BenchFaults = Annotated[str, typer.Option("--faults", help="Put faults into the twin, e.g. dark=1.")]
TruthOption = Annotated[bool, typer.Option("--truth", help="Compare with what the twin knows of itself.")]
WeightsOption = Annotated[
    bool,
    typer.Option("--weights/--data-sheet", help="Torques by known weights, or by the motor's data sheet."),
]


def _bench(
    where: tuple[str, Path | None, int | None],
    seed: int,
    out: Path,
    faults: str,
    truth: bool,
    quiet: bool,
) -> Any:
    """A bench with one positioner of a preset, unless told otherwise."""
    from fiberloom.cli.bench import BenchRequest

    instrument, layout, positioners = where
    count = positioners if layout is not None else positioners or 1
    plane = read_plane(instrument, layout, seed, count)
    return BenchRequest(plane, seed, out, faults, truth, quiet)


def _identify(name: str, request: Any, work: Any, as_json: bool) -> None:
    from fiberloom.cli.bench import table_rows
    from fiberloom.cli.identify import run_identification
    from fiberloom.report.tables import print_estimates

    content, complete = run_identification(name, request, work)
    if as_json:
        typer.echo(json.dumps(content, indent=2))
    else:
        print_estimates(table_rows(content))
        typer.echo(f"results in {request.out}/: {name}.json, {name}.ecsv, {name}.png")
    raise typer.Exit(0 if complete else 1)


def friction(
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    seed: SeedOption = 0,
    positioners: BenchPositioners = None,
    places: Annotated[int, typer.Option(min=2, help="Output angles at which to creep.")] = 5,
    span: Annotated[
        float | None, typer.Option(min=5.0, help="Run over so many deg of the arm; default: the range.")
    ] = None,
    weights: WeightsOption = True,
    faults: BenchFaults = "",
    truth: TruthOption = False,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/friction"),
    as_json: JsonOption = False,
) -> None:
    """Coulomb friction, spring, cogging and drag (Kronig 2020, Fig. 11 and 12)."""
    from fiberloom.calibration import FrictionSettings
    from fiberloom.cli.identify import friction_work

    request = _bench((instrument, layout, positioners), seed, out, faults, truth, as_json)
    settings = FrictionSettings(n_angles=places, run_span_deg=span)
    _identify("friction", request, friction_work(request, settings, weights), as_json)


def inertia(
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    seed: SeedOption = 0,
    positioners: BenchPositioners = None,
    pushes: Annotated[int, typer.Option(min=2, help="Torque steps, half of them upward.")] = 6,
    weights: WeightsOption = True,
    faults: BenchFaults = "",
    truth: TruthOption = False,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/inertia"),
    as_json: JsonOption = False,
) -> None:
    """Inertia from steps of torque (Kronig 2020, Eq. 12 and Fig. 14)."""
    from fiberloom.calibration import InertiaSettings
    from fiberloom.cli.identify import inertia_work

    request = _bench((instrument, layout, positioners), seed, out, faults, truth, as_json)
    settings = InertiaSettings(pushes=pushes)
    _identify("inertia", request, inertia_work(request, settings, weights), as_json)


def stiffness(
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    seed: SeedOption = 0,
    positioners: BenchPositioners = None,
    repeats: Annotated[int, typer.Option(min=3, help="How often to pull to each side.")] = 10,
    faults: BenchFaults = "",
    truth: TruthOption = False,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/stiffness"),
    as_json: JsonOption = False,
) -> None:
    """Stiffness from a known torque to both sides (Kronig 2020, Fig. 13)."""
    from fiberloom.calibration import StiffnessSettings
    from fiberloom.cli.identify import stiffness_work

    request = _bench((instrument, layout, positioners), seed, out, faults, truth, as_json)
    _identify("stiffness", request, stiffness_work(request, StiffnessSettings(repeats=repeats)), as_json)


def arms(
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    seed: SeedOption = 0,
    positioners: BenchPositioners = None,
    points: Annotated[int, typer.Option(min=8, help="Points on each circle.")] = 40,
    faults: BenchFaults = "",
    truth: TruthOption = False,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/arms"),
    as_json: JsonOption = False,
) -> None:
    """Arm lengths and centre from the circles of both axes."""
    from fiberloom.calibration import ArmsSettings
    from fiberloom.cli.identify import arms_work

    request = _bench((instrument, layout, positioners), seed, out, faults, truth, as_json)
    _identify("arms", request, arms_work(request, ArmsSettings(n_points=points)), as_json)


def repeatability(
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    seed: SeedOption = 0,
    positioners: BenchPositioners = None,
    visits: Annotated[int, typer.Option(min=5, help="Visits to each of three targets.")] = 300,
    faults: BenchFaults = "",
    truth: TruthOption = False,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/repeatability"),
    as_json: JsonOption = False,
) -> None:
    """Three targets 1 um apart, visited again and again (Kronig 2020, Fig. 17)."""
    from fiberloom.calibration import RepeatabilitySettings
    from fiberloom.cli.identify import repeatability_work

    request = _bench((instrument, layout, positioners), seed, out, faults, truth, as_json)
    settings = RepeatabilitySettings(visits=visits)
    _identify("repeatability", request, repeatability_work(request, settings), as_json)


def acceptance(
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    seed: SeedOption = 0,
    positioners: BenchPositioners = None,
    points: Annotated[int, typer.Option(min=8, help="Points per axis and direction.")] = 200,
    targets: Annotated[int, typer.Option(min=1, help="Random targets for blind moves.")] = 20,
    visits: Annotated[int, typer.Option(min=5, help="Visits to each of three targets, per axis.")] = 30,
    serial: Annotated[str, typer.Option(help="Serial number of the unit, for the report.")] = "",
    engineer: Annotated[str, typer.Option(help="Who measures, for the report.")] = "",
    faults: BenchFaults = "",
    out: Annotated[Path, typer.Option(help="Folder for the reports.")] = Path("runs/acceptance"),
    as_json: JsonOption = False,
) -> None:
    """Put units on the bench and hold them against the instrument's requirements."""
    from fiberloom.calibration.bench.acceptance import AcceptanceSettings
    from fiberloom.cli.acceptance import run_acceptance

    request = _bench((instrument, layout, positioners), seed, out, faults, False, as_json)
    settings = AcceptanceSettings(n_points=points, n_targets=targets, visits=visits)
    content = run_acceptance(request, settings, serial, engineer)
    if as_json:
        typer.echo(json.dumps(content, indent=2))
    raise typer.Exit(0 if all(unit["accepted"] for unit in content["units"]) else 1)
