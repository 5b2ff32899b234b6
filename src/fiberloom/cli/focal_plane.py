"""`fiberloom calibrate focal-plane`: centre, arms and zeros of all positioners, where they are mounted."""

from __future__ import annotations

import asyncio
import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.calibration.focal_plane.arms_file import save_arms
from fiberloom.calibration.focal_plane.convergence import convergence
from fiberloom.calibration.focal_plane.fit import (
    FitSettings,
    FocalPlaneFit,
    fit_focal_plane,
    layout_parameters,
)
from fiberloom.calibration.focal_plane.survey_data import SurveyData
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.cli.terminal import Waiting, waiting
from fiberloom.cli.transmission import calibrated_maps
from fiberloom.instruments import FocalPlane, write_layout
from fiberloom.operation.recording import SurveyRecorder
from fiberloom.operation.survey import SurveySettings, survey, survey_of_store
from fiberloom.report.convergence import plot_convergence
from fiberloom.report.outputs import marks, prepare_folder
from fiberloom.store import Store
from fiberloom.store.calibrations import record_calibration
from fiberloom.twin import Units, draw_units, field_hardware
from fiberloom.twin.mounting import misplaced


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
    settings = _settings(plane, request)
    with waiting(request.quiet) as wait:
        units = draw_units(plane, request.seed)
        maps = calibrated_maps(plane, units, request.seed, wait, path=request.calibration)
        guess = misplaced(plane, request.mounted_um, request.mounted_deg, request.seed)
        if request.measured is None:
            wait.say("moving and looking")
            data = _measure(plane, guess, maps, units, settings, request, wait)
        else:
            with Store.open(request.measured, create=False) as store:
                data = survey_of_store(store, plane, maps)
        wait.say("fitting")
        fit = fit_focal_plane(guess, data.theta_deg, data.xy_mm, settings.fit)
        truth = layout_parameters(replace(plane, arms=units.arms))
        rows = convergence(guess, data, settings.fit, truth)
    return _write(plane, guess, fit, rows, request, out)


def _measure(
    plane: FocalPlane,
    guess: FocalPlane,
    maps: TransmissionMaps,
    units: Units,
    settings: SurveySettings,
    request: FocalPlaneRequest,
    wait: Waiting,
) -> SurveyData:
    hardware = field_hardware(plane, units, request.seed, faults=request.faults, camera=request.camera)
    with (
        Store.open(request.out / "store.sqlite") as store,
        store.start_run(
            command_line=" ".join(sys.argv),
            instrument=plane.instrument.name,
            config_hash=plane.config_hash(),
            seed=request.seed,
        ) as run,
    ):
        recorder = SurveyRecorder(run, plane)
        return asyncio.run(survey(guess, maps, hardware, settings, recorder, wait.count))


def _settings(plane: FocalPlane, request: FocalPlaneRequest) -> SurveySettings:
    camera_um = plane.instrument.metrology.noise_rms_um
    return SurveySettings(
        configurations=request.configurations,
        safety_mm=request.safety_mm,
        seed=request.seed,
        fit=FitSettings(camera_um=camera_um, harmonics=request.harmonics),
    )


def _write(
    plane: FocalPlane,
    guess: FocalPlane,
    fit: FocalPlaneFit,
    rows: list[dict[str, Any]],
    request: FocalPlaneRequest,
    out: Path,
) -> dict[str, Any]:
    stamp = marks(plane, request.seed)
    save_arms(out / "arms.ecsv", fit, stamp)
    measured_now = request.measured is None
    made = fit.positioner_id[fit.ok]
    command = " ".join(sys.argv)
    record_calibration(out / "arms.ecsv", "focal-plane", made, stamp, command, same_run=measured_now)
    write_layout(fit.plane(guess), out / "layout")
    plot_convergence(out / "convergence.png", rows, plane.n, plane.instrument.metrology.noise_rms_um)
    refused = {int(p): r for p, r in zip(fit.positioner_id, fit.reason, strict=True) if r}
    summary = stamp | {
        "positioners": plane.n,
        "calibrated": int(fit.ok.sum()),
        "refused": refused,
        "lowest_rank": int(fit.rank.min()),
        "parameters": fit.parameters.shape[1],
        "outliers": int(fit.n_outliers.sum()),
        "residual_rms_um": float(np.sqrt((fit.rms_um[fit.ok] ** 2).mean())) if fit.ok.any() else None,
        "angles_mdeg": [1e3 * a for a in fit.angles_deg],
        "convergence": rows,
    }
    (out / "focal_plane.json").write_text(json.dumps(summary, indent=2) + "\n")
    return summary | {"arms": str(out / "arms.ecsv"), "layout": str(out / "layout")}
