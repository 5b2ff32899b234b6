"""`fiberloom calibrate focal-plane`: centre, arms and zeros of all positioners, where they are mounted."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from fiberloom.cli.observe import CameraKind, FaultsOption, MapsOption, check
from fiberloom.cli.options import JsonOptions, PlaneOptions, require_folder
from fiberloom.cli.terminal import waiting

MOUNTED_DEG = 0.2
"""How far off the first guess of the twin's zeros is, rms."""


@dataclass(frozen=True, kw_only=True)
class FocalPlaneOptions(PlaneOptions, JsonOptions):
    """Of `calibrate focal-plane`."""

    configurations: Annotated[int, typer.Option(min=4, help="Configurations of all positioners.")] = 40
    harmonics: Annotated[
        int, typer.Option(min=0, max=5, help="Fit the transmission's lowest orders too, up to this one.")
    ] = 0
    safety_mm: Annotated[
        float, typer.Option(min=0.0, max=3.0, help="By which arms are taken to be thicker than they are.")
    ] = 0.5
    mounted_um: Annotated[
        float, typer.Option(min=0.0, max=200.0, help="How far off the first guess of the twin's arms is.")
    ] = 50.0
    camera: Annotated[CameraKind, typer.Option(help="Camera images, or a noise model.")] = CameraKind.noise
    faults: FaultsOption = ""
    calibration: MapsOption = None
    measured: Annotated[
        Path | None, typer.Option(help="Fit what a store holds, also of an interrupted run; nothing moves.")
    ] = None
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/focal-plane")


def focal_plane(options: FocalPlaneOptions) -> int:
    """Find centre, arms and zeros of all positioners where they are mounted (Kronig 2020, Eq. 26)."""
    check(options)
    require_folder(options.out)
    from fiberloom.calibration.focal_plane.fit import FitSettings
    from fiberloom.field import Field
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
    field = Field.twin(plane, options.seed, options.camera.value, options.faults, options.calibration)
    field.command_line = " ".join(sys.argv)
    guess = misplaced(plane, options.mounted_um, MOUNTED_DEG, options.seed)
    with waiting(options.as_json) as field.watcher:
        found = field.run.survey(settings, guess=guess, measured=options.measured, out=out)
    found.save(out)
    made, same_run, arms = found.fit.positioner_id[found.fit.ok], options.measured is None, out / "arms.ecsv"
    record_calibration(arms, "focal-plane", made, found.marks, field.command_line, same_run=same_run)
    _show(options, found.summary() | {"arms": str(arms), "layout": str(out / "layout")})
    return 1 if found.summary()["refused"] else 0


def _show(options: FocalPlaneOptions, report: dict[str, Any]) -> None:
    if options.as_json:
        options.print_json(report)
        return
    from fiberloom.calibration.focal_plane.convergence import flat_convergence

    options.show({k: v for k, v in report.items() if k != "convergence"})
    options.show(flat_convergence(report["convergence"]))
