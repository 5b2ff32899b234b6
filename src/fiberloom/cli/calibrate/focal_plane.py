"""`fiberloom calibrate focal-plane`: centre, arms and zeros of all positioners, where they are mounted."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from fiberloom.cli.array.options import ExcludeOptions
from fiberloom.cli.observe import FaultsOption, MapsOption, check, field_of
from fiberloom.cli.options import ErrorsOptions, JsonOptions, PlaneOptions, RequireOptions, require_folder
from fiberloom.cli.terminal import waiting

SurveyCameraOption = Annotated[
    str | None,
    typer.Option(
        help="image or noise of the twin (default: noise); with --bus: alpaca://HOST:PORT/N, folder:PATH, "
        "indi://HOST:PORT/NAME, aravis:NAME."
    ),
]
MOUNTED_DEG = 0.2
"""Error of the first guess of the twin's zeros, rms."""


@dataclass(frozen=True, kw_only=True)
class FocalPlaneOptions(ExcludeOptions, ErrorsOptions, RequireOptions, PlaneOptions, JsonOptions):
    """Of `calibrate focal-plane`."""

    configurations: Annotated[int, typer.Option(min=4, help="Configurations of all positioners.")] = 40
    harmonics: Annotated[
        int, typer.Option(min=0, max=5, help="Fit the transmission's lowest orders too, up to this one.")
    ] = 0
    safety_mm: Annotated[
        float, typer.Option(min=0.0, max=3.0, help="Added to the radius of every arm for planning, mm.")
    ] = 0.5
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

    out, plane = options.out, options.plane()
    settings = SurveySettings(
        configurations=options.configurations,
        safety_mm=options.safety_mm,
        seed=options.seed,
        fit=FitSettings(camera_um=plane.instrument.metrology.noise_rms_um, harmonics=options.harmonics),
    )
    field = field_of(options, camera="noise")
    field.command_line = " ".join(sys.argv)
    # a real array is where its layout says, as well as that is known
    guess = plane if options.bus else misplaced(plane, options.mounted_um, MOUNTED_DEG, options.seed)
    with waiting(options.as_json) as field.watcher:
        found = field.run.survey(settings, guess=guess, measured=options.measured, out=out)
    found.save(out)
    made, same_run, arms = found.fit.positioner_id[found.fit.ok], options.measured is None, out / "arms.ecsv"
    record_calibration(arms, "focal-plane", made, found.marks, field.command_line, same_run=same_run)
    _show(options, found.summary() | {"arms": str(arms), "layout": str(out / "layout")})
    return 0 if options.met(len(made), len(made) + len(found.summary()["refused"])) else 1


def _show(options: FocalPlaneOptions, report: dict[str, Any]) -> None:
    if options.as_json:
        options.print_json(report)
        return
    from fiberloom.calibration.focal_plane.convergence import flat_convergence

    options.show({k: v for k, v in report.items() if k != "convergence"})
    options.show(flat_convergence(report["convergence"]))
