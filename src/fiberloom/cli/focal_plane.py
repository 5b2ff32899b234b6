"""`fiberloom calibrate focal-plane`: centre, arms and zeros of all positioners, where they are mounted."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fiberloom.calibration.focal_plane.fit import FitSettings
from fiberloom.cli.terminal import waiting
from fiberloom.field import Field
from fiberloom.instruments import FocalPlane
from fiberloom.operation.survey import SurveySettings
from fiberloom.report.outputs import prepare_folder
from fiberloom.store.calibrations import record_calibration
from fiberloom.twin.draw import misplaced


@dataclass(frozen=True)
class FocalPlaneRequest:
    """What the command line asked for."""

    out: Path
    seed: int = 0
    configurations: int = 40
    harmonics: int = 0
    safety_mm: float = 0.5
    mounted_um: float = 50.0
    """How far the host's first guess is off (a twin's mounting): centre and lengths, rms per number."""
    mounted_deg: float = 0.2
    faults: str = ""
    camera: str = "noise"
    calibration: Path | None = None
    measured: Path | None = None
    """Store of an earlier run, also an interrupted one: nothing moves, its images are fitted."""
    quiet: bool = False


def run_calibrate_focal_plane(plane: FocalPlane, request: FocalPlaneRequest) -> dict[str, Any]:
    """Calibrate the focal plane of the twin; write arms, layout, convergence and a figure."""
    out = prepare_folder(request.out)
    field = Field.twin(plane, request.seed, request.camera, request.faults, request.calibration)
    field.command_line = " ".join(sys.argv)
    guess = misplaced(plane, request.mounted_um, request.mounted_deg, request.seed)
    with waiting(request.quiet) as field.watcher:
        found = field.run.survey(_settings(plane, request), guess=guess, measured=request.measured, out=out)
    found.save(out)
    made, same_run = found.fit.positioner_id[found.fit.ok], request.measured is None
    arms = out / "arms.ecsv"
    record_calibration(arms, "focal-plane", made, found.marks, field.command_line, same_run=same_run)
    return found.summary() | {"arms": str(arms), "layout": str(out / "layout")}


def _settings(plane: FocalPlane, request: FocalPlaneRequest) -> SurveySettings:
    camera_um = plane.instrument.metrology.noise_rms_um
    return SurveySettings(
        configurations=request.configurations,
        safety_mm=request.safety_mm,
        seed=request.seed,
        fit=FitSettings(camera_um=camera_um, harmonics=request.harmonics),
    )
