"""`fiberloom calibrate focal-plane`: centre, arms and zeros of all positioners, where they are mounted."""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from fiberloom.cli.array.options import ExcludeOptions
from fiberloom.cli.observe import FaultsOption, MapsOption, check, field_of
from fiberloom.cli.options import (
    ErrorsOptions,
    JsonOptions,
    PlaneOptions,
    RequireOptions,
    TimingsOptions,
    require_folder,
)
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError, one_line

SurveyCameraOption = Annotated[
    str | None,
    typer.Option(
        help="image or noise of the twin (default: noise); with --bus: alpaca://HOST:PORT/N, folder:PATH, "
        "indi://HOST:PORT/NAME, aravis:NAME."
    ),
]
_COMMAND_S = 600.0
"""In which a rotator has to be where it is told to be, and a lamp to burn."""
MOUNTED_DEG = 0.2
"""Error of the first guess of the twin's zeros, rms."""


@dataclass(frozen=True, kw_only=True)
class FocalPlaneOptions(
    ExcludeOptions, ErrorsOptions, RequireOptions, PlaneOptions, TimingsOptions, JsonOptions
):
    """Of `calibrate focal-plane`."""

    configurations: Annotated[int, typer.Option(min=4, help="Configurations of all positioners.")] = 40
    harmonics: Annotated[
        int, typer.Option(min=0, max=5, help="Fit the transmission's lowest orders too, up to this one.")
    ] = 0
    safety_mm: Annotated[
        float, typer.Option(min=0.0, max=3.0, help="Added to the radius of every arm for planning, mm.")
    ] = 0.5
    rotator: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=360.0,
            help="Turn the rotator between the configurations, over so many deg in all, and calibrate the "
            "fiducials too. 0: they are taken to be where their table has them.",
        ),
    ] = 0.0
    rotate: Annotated[
        str, typer.Option(help="With --bus and --rotator: command that turns it, e.g. 'tcs rotator {deg}'.")
    ] = ""
    backlit: Annotated[
        bool,
        typer.Option(
            "--backlit",
            help="Light the science fibres from behind too, in every configuration, and find where they are.",
        ),
    ] = False
    lamp: Annotated[
        str,
        typer.Option(help="With --bus and --backlit: command that lights a fibre, e.g. 'lamp {fibre}'."),
    ] = ""
    mounted_um: Annotated[
        float, typer.Option(min=0.0, max=200.0, help="Error of the first guess of the twin's arms, um rms.")
    ] = 50.0
    camera: SurveyCameraOption = None
    faults: FaultsOption = ""
    calibration: MapsOption = None
    measured: Annotated[
        Path | None, typer.Option(help="Fit the last run of a store, also an interrupted one; nothing moves.")
    ] = None
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/focal-plane")


def focal_plane(options: FocalPlaneOptions) -> int:
    """Find centre, arms and zeros of all positioners where they are mounted (Kronig 2020, Eq. 26).

    Exit code 1 where fewer positioners than `--require` says are calibrated; others keep the layout's arms.
    """
    check(options)
    options.met(0, 0)  # a share that is none is told before anything moves
    require_folder(options.out)
    from fiberloom.calibration.focal_plane.fit import FitSettings
    from fiberloom.operation.survey import SurveySettings
    from fiberloom.store.calibrations import record_calibration
    from fiberloom.twin.draw import misplaced

    rotate, lamp = _rotator(options), _lamp(options)
    out, plane = options.out, options.plane()
    settings = SurveySettings(
        configurations=options.configurations,
        safety_mm=options.safety_mm,
        seed=options.seed,
        fit=FitSettings(camera_um=plane.instrument.metrology.noise_rms_um, harmonics=options.harmonics),
        rotator_deg=options.rotator,
        rotate=rotate,
        backlit=tuple(plane.science_fibres) if options.backlit else (),
        lamp=lamp,
    )
    field = field_of(options, camera="noise")
    field.command_line = " ".join(sys.argv)
    # a real array is where its layout says, as well as that is known
    guess = plane if options.bus else misplaced(plane, options.mounted_um, MOUNTED_DEG, options.seed)
    with waiting(options.as_json, options.timings) as field.watcher:
        found = field.run.survey(settings, guess=guess, measured=options.measured, out=out)
    found.save(out)
    made, same_run, arms = found.fit.positioner_id[found.fit.ok], options.measured is None, out / "arms.ecsv"
    record_calibration(arms, "focal-plane", made, found.marks, field.command_line, same_run=same_run)
    fibres = {"fibres": str(out / "fibres.ecsv")} if found.science is not None else {}
    _show(options, found.summary() | {"arms": str(arms), "layout": str(out / "layout")} | fibres)
    return 0 if options.met(len(made), len(made) + len(found.summary()["refused"])) else 1


def _rotator(options: FocalPlaneOptions) -> Callable[[float], None]:
    """Turns the rotator of an instrument by its command; that of the twin turns with its camera."""
    if not options.rotator or not options.bus:
        if options.rotate:
            raise InputError("--rotate: turns the rotator of an instrument; it needs --bus and --rotator DEG")
        if options.rotator and (options.camera or "noise") == "noise":
            raise InputError("--rotator: lens and fiducials are told by images; add --camera image")
        return lambda _: None
    if "{deg}" not in options.rotate:
        raise InputError(
            "--rotator: with --bus it needs --rotate COMMAND, with {deg} where the angle belongs; it returns "
            "when the rotator is there"
        )
    return lambda turned_deg: _carry_out("--rotate", options.rotate, "{deg}", f"{turned_deg:.3f}")


def _lamp(options: FocalPlaneOptions) -> Callable[[str], None]:
    """Lights science fibres of an instrument by its command; those of the twin are lit with its camera."""
    if not options.backlit or not options.bus:
        if options.lamp:
            raise InputError("--lamp: lights the fibres of an instrument; it needs --bus and --backlit")
        if options.backlit and (options.camera or "noise") == "noise":
            raise InputError("--backlit: fibres that shine are seen in images; add --camera image")
        return lambda _: None
    if "{fibre}" not in options.lamp:
        raise InputError(
            "--backlit: with --bus it needs --lamp COMMAND, with {fibre} where the fibre's name belongs; "
            "'off' puts the light out"
        )
    return lambda fibre: _carry_out("--lamp", options.lamp, "{fibre}", fibre or "off")


def _carry_out(option: str, command: str, place: str, value: str) -> None:
    """Runs a command of the user's instrument, and waits for its end."""
    words = [word.replace(place, value) for word in shlex.split(command)]
    try:
        subprocess.run(words, check=True, timeout=_COMMAND_S)
    except (OSError, subprocess.SubprocessError) as error:
        raise InputError(f"{option} {shlex.join(words)}: {one_line(error)}") from None


def _show(options: FocalPlaneOptions, report: dict[str, Any]) -> None:
    if options.as_json:
        options.print_json(report)
        return
    from fiberloom.calibration.focal_plane.convergence import flat_convergence

    options.show({k: v for k, v in report.items() if k != "convergence"})
    options.show(flat_convergence(report["convergence"]))
