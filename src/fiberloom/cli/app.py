"""The command `fiberloom`: parses, calls, prints. Everything it does can be done from Python too."""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from fiberloom.cli import bench_commands as cli_bench
from fiberloom.cli.options import (
    InstrumentOption,
    JsonOption,
    LayoutOption,
    PositionersOption,
    SeedOption,
)
from fiberloom.cli.options import print_report as _print_report
from fiberloom.cli.options import read_plane as _plane
from fiberloom.errors import InputError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="From a target list to fibres on target, for alpha-beta fibre positioners.",
)
calibrate = typer.Typer(no_args_is_help=True, help="Measure what is particular to each positioner.")
app.add_typer(calibrate, name="calibrate")


class Correction(StrEnum):
    """How corrections weigh what the camera says."""

    filtered = "filtered"
    plain = "plain"


class CameraKind(StrEnum):
    """Where measured positions come from."""

    noise = "noise"
    image = "image"


class Pages(StrEnum):
    """Exposures that get pages to look at."""

    none = "none"
    last = "last"
    all = "all"


def _version(show: bool) -> None:
    if show:
        from fiberloom.version import __version__

        typer.echo(f"fiberloom {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command()
def observe(
    targets: Annotated[Path, typer.Argument(help="CSV, ECSV, FITS or SDSS confSummary file.")],
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    moves: Annotated[
        int | None,
        typer.Option(min=1, help="Exactly so many, blind move counted; default: the instrument's stop rule."),
    ] = None,
    correction: Annotated[
        Correction | None,
        typer.Option(help="Kalman filter, or Eq. 25 as printed; default: the instrument's."),
    ] = None,
    camera: Annotated[CameraKind, typer.Option(help="Camera images, or a noise model.")] = CameraKind.image,
    pages: Annotated[
        Pages, typer.Option(help="Exposures that get pages: image, residuals, distortion.")
    ] = Pages.last,
    save_images: Annotated[bool, typer.Option(help="Keep every exposure as FITS.")] = False,
    faults: Annotated[str, typer.Option(help="Put faults into the twin, e.g. dark=3,dead=1,lying=1.")] = "",
    compare_linear: Annotated[
        bool, typer.Option(help="Measure a blind move by a linear gear ratio too, at the end.")
    ] = False,
    seed: SeedOption = 0,
    positioners: PositionersOption = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/latest"),
    calibration: Annotated[
        Path | None,
        typer.Option(help="Transmission maps; default: calibrate once, then the cache."),
    ] = None,
    arms: Annotated[
        Path | None, typer.Option(help="Arms of `calibrate focal-plane`, in place of the layout's.")
    ] = None,
    adapt: Annotated[
        bool, typer.Option("--adapt/--no-adapt", help="Learn the maps from every measured move.")
    ] = False,
    learnt: Annotated[
        str | None,
        typer.Option(help="Store with what was learnt; default with --adapt: beside the maps."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Put fibres on the targets of a list, and say how near each one came."""
    from fiberloom.cli.observe import ObserveRequest, run_observe

    request = ObserveRequest(
        targets=targets,
        moves=moves,
        correction=None if correction is None else correction.value,
        camera=camera.value,
        pages=pages.value,
        save_images=save_images,
        faults=faults,
        compare_linear=compare_linear,
        seed=seed,
        out=out,
        calibration=calibration,
        arms=arms,
        adapt=adapt,
        learnt=learnt,
        quiet=as_json,
    )
    summary = run_observe(_plane(instrument, layout, seed, positioners), request)
    if as_json:
        typer.echo(json.dumps(summary, indent=2))
    missed = summary["n_valid"] - summary["n_within_requirement"]
    raise typer.Exit(1 if missed or summary["collisions_verified"] else 0)


@app.command()
def assign(
    targets: Annotated[Path, typer.Argument(help="CSV, ECSV, FITS or SDSS confSummary file.")],
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    seed: SeedOption = 0,
    positioners: PositionersOption = None,
    out: Annotated[Path, typer.Option(help="Configuration to write.")] = Path("goal.csv"),
    as_json: JsonOption = False,
) -> None:
    """Choose a target for each positioner; write the configuration as CSV."""
    from fiberloom.cli.steps import assign_step

    report = assign_step(_plane(instrument, layout, seed, positioners), targets, seed, out)
    _print_report(report, as_json)


@app.command()
def plan(
    start: Annotated[Path, typer.Option(help="Configuration CSV: positioner_id,alpha_deg,beta_deg.")],
    goal: Annotated[Path, typer.Option(help="Configuration CSV to reach.")],
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    seed: SeedOption = 0,
    positioners: PositionersOption = None,
    out: Annotated[Path, typer.Option(help="Trajectories to write.")] = Path("trajectories.json"),
    as_json: JsonOption = False,
) -> None:
    """Plan collision-free trajectories from one configuration to another."""
    from fiberloom.cli.steps import plan_step

    report = plan_step(_plane(instrument, layout, seed, positioners), start, goal, seed, out)
    _print_report(report, as_json)
    raise typer.Exit(0 if report["arrived"] == report["robots"] and report["verified"] else 1)


@app.command()
def verify(
    trajectories: Annotated[Path, typer.Argument(help="trajectories.json of `plan` or `observe`.")],
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    seed: SeedOption = 0,
    positioners: PositionersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check trajectories in continuous time: clearances, limits, speeds, accelerations."""
    from fiberloom.cli.steps import verify_step

    report = verify_step(_plane(instrument, layout, seed, positioners), trajectories)
    _print_report(report, as_json)
    raise typer.Exit(0 if report["verified"] else 1)


@app.command()
def twin(
    listen: Annotated[str, typer.Option(help="HOST:PORT of the first device.")] = "127.0.0.1:19228",
    devices: Annotated[
        int | None, typer.Option(min=1, max=64, help="CAN@net devices; default: one for 84 positioners.")
    ] = None,
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    positioners: PositionersOption = None,
    seed: SeedOption = 0,
    faults: Annotated[
        str,
        typer.Option(
            help="What goes wrong: KIND=COUNT[@START][+DURATION],... e.g. lying=2,lost=0.01,powercut=1@30."
        ),
    ] = "",
    speed: Annotated[float, typer.Option(help="Virtual seconds a second; 1 is real time.")] = 1.0,
    neighbours: Annotated[bool, typer.Option(help="Arms touch, or pass through each other.")] = True,
    bootloader: Annotated[
        bool, typer.Option("--bootloader", help="Begin as after power-on: ten seconds in the bootloader.")
    ] = False,
    first: Annotated[
        bool, typer.Option("--first", help="Clock before all ordinary programs; the system must allow it.")
    ] = False,
    jaeger_config: Annotated[
        Path | None, typer.Option(help="Write the configuration that jaeger needs for these devices.")
    ] = None,
    report_every: Annotated[
        float, typer.Option(min=0.0, help="Seconds between reports of lateness; 0: at the end only.")
    ] = 0.0,
    stop_after: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after so many seconds; default: Ctrl-C, SIGTERM.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Serve positioners on CAN@net TCP ports in real time, for jaeger or any other host."""
    from fiberloom.cli.twin import ServeRequest, run_twin

    request = ServeRequest(
        listen=listen,
        devices=devices,
        seed=seed,
        faults=faults,
        speed=speed,
        neighbours=neighbours,
        bootloader=bootloader,
        first=first,
        jaeger_config=jaeger_config,
        report_every_s=report_every,
        stop_after_s=stop_after,
        as_json=as_json,
    )
    run_twin(_plane(instrument, layout, seed, positioners), request)


@calibrate.command()
def transmission(
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    seed: SeedOption = 0,
    positioners: PositionersOption = None,
    points: Annotated[int, typer.Option(min=8, help="Points per axis and direction.")] = 200,
    out: Annotated[Path, typer.Option(help="Folder for the maps.")] = Path("runs/transmission"),
    as_json: JsonOption = False,
) -> None:
    """Measure motor angle against output angle in both directions (Kronig 2020, Eq. 6 and 7)."""
    from fiberloom.cli.transmission import run_calibrate_transmission

    plane = _plane(instrument, layout, seed, positioners)
    report = run_calibrate_transmission(plane, seed, points, out, quiet=as_json)
    _print_report(report, as_json)
    raise typer.Exit(1 if report["refused"] else 0)


@calibrate.command("focal-plane")
def focal_plane(
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    seed: SeedOption = 0,
    positioners: PositionersOption = None,
    configurations: Annotated[int, typer.Option(min=4, help="Configurations of everybody.")] = 40,
    harmonics: Annotated[
        int, typer.Option(min=0, max=5, help="Fit the transmission's lowest orders too, up to this one.")
    ] = 0,
    safety_mm: Annotated[
        float, typer.Option(min=0.0, max=3.0, help="By which arms are taken to be thicker than they are.")
    ] = 0.5,
    mounted_um: Annotated[
        float, typer.Option(min=0.0, max=200.0, help="How far off the first guess of the twin's arms is.")
    ] = 50.0,
    camera: Annotated[CameraKind, typer.Option(help="Camera images, or a noise model.")] = CameraKind.noise,
    faults: Annotated[str, typer.Option(help="Put faults into the twin, e.g. dark=3,dead=1,lying=1.")] = "",
    calibration: Annotated[
        Path | None,
        typer.Option(help="Transmission maps; default: calibrate once, then the cache."),
    ] = None,
    measured: Annotated[
        Path | None, typer.Option(help="Fit what a store holds, also of an interrupted run; nothing moves.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/focal-plane"),
    as_json: JsonOption = False,
) -> None:
    """Find centre, arms and zeros of all positioners where they are mounted (Kronig 2020, Eq. 26)."""
    from fiberloom.calibration.focal_plane.convergence import flat_convergence
    from fiberloom.cli.focal_plane import FocalPlaneRequest, run_calibrate_focal_plane

    request = FocalPlaneRequest(
        out=out,
        seed=seed,
        configurations=configurations,
        harmonics=harmonics,
        safety_mm=safety_mm,
        mounted_um=mounted_um,
        faults=faults,
        camera=camera.value,
        calibration=calibration,
        measured=measured,
        quiet=as_json,
    )
    report = run_calibrate_focal_plane(_plane(instrument, layout, seed, positioners), request)
    _print_report(report if as_json else {k: v for k, v in report.items() if k != "convergence"}, as_json)
    if not as_json:
        _print_report(flat_convergence(report["convergence"]), as_json)
    raise typer.Exit(1 if report["refused"] else 0)


@calibrate.command()
def history(
    learnt: Annotated[str, typer.Argument(help="Store with what was learnt, as `observe --adapt` names it.")],
    positioner: Annotated[
        int | None, typer.Option(help="Only the generations that changed this one.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show what operation has taught the maps, generation by generation."""
    from fiberloom.cli.learnt import history_step

    rows = history_step(learnt, positioner)
    if not as_json:  # the others do not fit a terminal's width
        rows = [{k: v for k, v in row.items() if k not in ("calibration", "seed")} for row in rows]
    _print_report(rows, as_json)


@calibrate.command()
def undo(
    learnt: Annotated[str, typer.Argument(help="Store with what was learnt.")],
    to: Annotated[int, typer.Option(min=0, help="Generation to go back to; 0: the calibration itself.")],
    positioner: Annotated[
        list[int] | None, typer.Option(help="Only this one; may be given several times.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Go back to what was known at an earlier generation; nothing is deleted."""
    from fiberloom.cli.learnt import undo_step

    _print_report(undo_step(learnt, to, positioner), as_json)


@app.command()
def lifetime(
    cycles: Annotated[int, typer.Option(min=1, help="Of 15260 moves each, as the paper's.")] = 100,
    positioners: Annotated[int, typer.Option(min=1, help="How many, each on a bench of its own.")] = 2,
    instrument: InstrumentOption = "sdssv",
    points: Annotated[int, typer.Option(min=8, help="Of a calibration, per axis and direction.")] = 200,
    targets: Annotated[
        int, typer.Option(min=1, help="Random targets a cycle; each one takes ten moves.")
    ] = 1220,
    every: Annotated[int, typer.Option(min=1, help="Simulate only every so many cycles.")] = 1,
    faults: Annotated[
        str,
        typer.Option(help="Ailments of the first positioners, half-way, e.g. broken_tooth=1,loose_arm=1."),
    ] = "",
    workers: Annotated[int, typer.Option(min=1, help="Processes of this machine.")] = 1,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler, e.g. tcp://host:8786, instead.")
    ] = None,
    seed: SeedOption = 0,
    out: Annotated[
        Path, typer.Option(help="Folder for the results; an interrupted run goes on in it.")
    ] = Path("runs/lifetime"),
    as_json: JsonOption = False,
) -> None:
    """Wear positioners out, and compare ways to know their gears (Kronig 2020, Fig. 21 to 26)."""
    from fiberloom.cli.lifetime import LifetimeRequest, run_lifetime, table, within_requirement
    from fiberloom.studies.lifetime import LifetimeSettings

    settings = LifetimeSettings(
        instrument=instrument,
        cycles=cycles,
        points=points,
        approaches=targets,
        cycle_step=every,
        faults=faults,
    )
    result = run_lifetime(
        LifetimeRequest(positioners, seed, settings, out, workers, scheduler, quiet=as_json)
    )
    if as_json:
        typer.echo(json.dumps(result, indent=2))
    else:
        typer.echo("Blind moves, rms in um as measured:")
        _print_report(table(result), as_json)
        _print_report(result["summary"] | {"results": str(out)}, as_json)
    raise typer.Exit(0 if within_requirement(result["summary"]) else 1)


@app.command()
def reproduce(
    figures: Annotated[
        list[str] | None, typer.Argument(help="Figures of the paper, e.g. 16 19 eq22; default: all.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for report, results and figures.")] = Path(
        "runs/reproduce"
    ),
    seed: SeedOption = 0,
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds in a row give the spread.")] = 3,
    full: Annotated[bool, typer.Option("--full", help="The size of the paper's experiments.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Make the paper's figures and numbers on the twin, ours beside theirs."""
    from fiberloom.cli.reproduce import ReproduceRequest, run_reproduce

    request = ReproduceRequest(tuple(figures or ()), out, seed, seeds, full, quiet=as_json)
    records = run_reproduce(request)
    if as_json:
        typer.echo(json.dumps(records, indent=2))


@app.command()
def instruments(
    name: Annotated[str | None, typer.Argument(help="Show one preset in full.")] = None,
    as_json: JsonOption = False,
) -> None:
    """List the presets, or show one."""
    from fiberloom.cli.steps import instruments_step

    _print_report(instruments_step(name), as_json)


@app.command()
def runs(
    where: Annotated[
        str, typer.Argument(help="Store, database URL, or a folder with stores below it.")
    ] = "runs",
    as_json: JsonOption = False,
) -> None:
    """Show what was observed, and how it ended."""
    from fiberloom.cli.steps import runs_step

    _print_report(runs_step(where), as_json)


@app.command()
def health(
    where: Annotated[
        str, typer.Argument(help="Store, database URL, or a folder with stores below it.")
    ] = "runs",
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    seed: SeedOption = 0,
    positioners: PositionersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say who is healthy, degraded, suspect or disabled by all that was observed, and what to do."""
    from fiberloom.cli.health import health_report, print_health

    report = health_report(where, _plane(instrument, layout, seed, positioners))
    if as_json:
        typer.echo(json.dumps(report, indent=2))
    else:
        print_health(report)
    raise typer.Exit(1 if report["findings"] else 0)


@app.command()
def centroid(
    image: Annotated[Path, typer.Argument(help="FITS image of back-lit fibres.")],
    out: Annotated[Path, typer.Option(help="Spots to write.")] = Path("spots.csv"),
    gain: Annotated[float | None, typer.Option(help="Electrons per count; default: the header's.")] = None,
    saturation: Annotated[float | None, typer.Option(help="Counts; default: the header's.")] = None,
    threshold: Annotated[float, typer.Option(help="Faintest spot, in sigmas of the noise.")] = 6.0,
    extension: Annotated[str | None, typer.Option(help="HDU, by number or name.")] = None,
    expected: Annotated[Path | None, typer.Option(help="Look only there: CSV with x_px, y_px.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Picture of the image with its spots.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Find and measure the spots of a camera image."""
    from fiberloom.cli.metrology import CentroidRequest
    from fiberloom.cli.metrology import centroid as run_centroid

    request = CentroidRequest(
        image=image,
        out=out,
        gain_e_adu=gain,
        saturation_adu=saturation,
        threshold=threshold,
        extension=extension,
        expected=expected,
        plot=plot,
    )
    report = run_centroid(request)
    _print_report(report, as_json)
    raise typer.Exit(0 if report["spots"] else 1)


@app.command()
def match(
    source: Annotated[Path, typer.Argument(help="Spots of `centroid`, or an image.")],
    instrument: InstrumentOption = "sdssv",
    layout: LayoutOption = None,
    seed: SeedOption = 0,
    positioners: PositionersOption = None,
    expected: Annotated[
        Path | None, typer.Option(help="Configuration CSV that the positioners should have.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Positions to write.")] = Path("positions.csv"),
    scale: Annotated[
        float | None, typer.Option(help="mm per pixel; default: the instrument's camera.")
    ] = None,
    rotation: Annotated[
        float | None, typer.Option(help="Direction of the pixel x axis in the focal plane, deg.")
    ] = None,
    rotation_tolerance: Annotated[float, typer.Option(min=0, help="Off by at most so much, deg.")] = 15.0,
    flipped: Annotated[
        bool | None, typer.Option("--flipped/--not-flipped", help="Is the image a mirror image?")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Tell which spot is whose, and where it is in the focal plane."""
    from fiberloom.cli.metrology import MatchRequest
    from fiberloom.cli.metrology import match as run_match

    plane = _plane(instrument, layout, seed, positioners)
    request = MatchRequest(
        source=source,
        out=out,
        expected=expected,
        scale_mm_px=scale,
        rotation_deg=rotation,
        rotation_tolerance_deg=rotation_tolerance,
        flipped=flipped,
    )
    _print_report(run_match(plane, request), as_json)


cli_bench.register(app, calibrate)

INTERRUPTED = 130

_BAD_WORDS: Any = typer.BadParameter.__mro__[2]
"""ClickException, of the click that this typer uses: newer ones bring their own."""


def main() -> None:
    """Entry point: exit code 0, 1 (ran, below requirement), 2 (bad input) or 130 (interrupted)."""
    try:
        code = app(standalone_mode=False)
        if code == INTERRUPTED:  # how typer tells of Ctrl-C
            raise KeyboardInterrupt
        sys.exit(code)
    except InputError as error:
        _fail(str(error), 2)
    except (typer.Abort, KeyboardInterrupt):
        _fail("interrupted; what was measured is kept: `fiberloom runs`, or the output folder", INTERRUPTED)
    except _BAD_WORDS as error:
        _fail(f"{error.format_message()}; see `fiberloom --help`", 2)
    except OSError as error:
        _fail(f"{error.filename or 'input/output'}: {error.strerror or error}", 2)


def _fail(message: str, code: int) -> None:
    print(f"fiberloom: {message}", file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
