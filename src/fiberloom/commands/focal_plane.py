"""`fiberloom calibrate focal-plane`: centre, arms and zeros of all positioners, where they are mounted."""

from __future__ import annotations

import asyncio
import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fiberloom.calibration.arms_file import save_arms
from fiberloom.calibration.focal_plane import (
    N_GEOMETRY,
    FitSettings,
    FocalPlaneFit,
    fit_focal_plane,
    layout_parameters,
)
from fiberloom.calibration.transmission import TransmissionMaps
from fiberloom.commands.outputs import marks, prepare_folder
from fiberloom.commands.terminal import Waiting, waiting
from fiberloom.commands.transmission import calibrated_maps
from fiberloom.instruments import FocalPlane, write_layout
from fiberloom.operation.recording import SurveyRecorder
from fiberloom.operation.survey import SurveyData, SurveySettings, survey, survey_of_store
from fiberloom.report.convergence import plot_convergence
from fiberloom.store import Store
from fiberloom.twin import Units, draw_units, field_hardware
from fiberloom.units import MM_PER_UM, RAD_PER_DEG, UM_PER_MM

Floats = NDArray[np.float64]

STEPS = (6, 10, 20, 40, 80, 160, 320)
"""Numbers of configurations at which the convergence is shown."""


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


def misplaced(plane: FocalPlane, by_um: float, by_deg: float, seed: int) -> FocalPlane:
    """A layout as it is known before anything was measured: every number off by so much, rms."""
    rng = np.random.default_rng([seed, 0x3015])
    sigmas = np.array([*[by_um * MM_PER_UM] * 3, *[by_deg * RAD_PER_DEG] * 2])
    return replace(plane, arms=plane.arms + rng.normal(size=plane.arms.shape) * sigmas)


def convergence(
    guess: FocalPlane, data: SurveyData, settings: FitSettings, truth: Floats | None = None
) -> list[dict[str, Any]]:
    """Errors and standard errors (rms over positioners) by number of configurations (Fig. 20)."""
    total = data.theta_deg.shape[1]
    numbers = [s for s in STEPS if s < total] + [total]
    return [_converged(guess, data, settings, truth, s) for s in numbers]


def _converged(
    guess: FocalPlane, data: SurveyData, settings: FitSettings, truth: Floats | None, number: int
) -> dict[str, Any]:
    fit = fit_focal_plane(guess, data.theta_deg[:, :number], data.xy_mm[:, :number], settings)
    good = fit.ok
    error = None if truth is None else (fit.parameters[:, :N_GEOMETRY] - truth)[good]
    return {
        "configurations": number,
        "calibrated": int(good.sum()),
        "error_um": None if error is None else _by_name(error),
        "standard_error_um": _by_name(fit.sigma[good]),
        "worst_error_um": None if error is None else UM_PER_MM * float(np.abs(error[:, :4]).max(initial=0.0)),
        "angles_mdeg": [1e3 * a for a in fit.angles_deg],
    }


def _by_name(values: Floats) -> dict[str, float]:
    """rms over positioners, in um; the centre's in two dimensions."""
    rms = UM_PER_MM * np.sqrt((values[:, :4] ** 2).mean(axis=0)) if len(values) else np.full(4, np.nan)
    return {"centre": float(np.hypot(*rms[:2])), "l_alpha": float(rms[2]), "l_beta": float(rms[3])}


def flat_convergence(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """For people: one line per number of configurations; um, `se` a standard error."""
    return [
        {"number": row["configurations"], "fitted": row["calibrated"]}
        | {name.replace("l_", ""): value for name, value in (row["error_um"] or {}).items()}
        | {"worst": row["worst_error_um"]}
        | {f"se {name.replace('l_', '')}": value for name, value in row["standard_error_um"].items()}
        for row in rows
    ]


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
