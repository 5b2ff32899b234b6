"""How the in-focal-plane calibration converges with the number of configurations (Kronig 2020, Fig. 20)."""

from __future__ import annotations

from typing import Any

import numpy as np

from fiberloom.calibration.focal_plane.fit import N_GEOMETRY, FitSettings, fit_focal_plane
from fiberloom.calibration.focal_plane.survey_data import SurveyData
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

STEPS = (6, 10, 20, 40, 80, 160, 320)
"""Numbers of configurations at which the convergence is shown."""


def convergence(
    guess: FocalPlane, data: SurveyData, settings: FitSettings, truth: Floats | None = None
) -> list[dict[str, Any]]:
    """Errors and standard errors in um (rms over positioners) by number of configurations (Fig. 20).

    `guess`: the layout from which the fits start; `data`: angles and places of the survey; `settings`
    of the fit; `truth` (N, 6) in mm and rad, a twin only: without it no errors.
    """
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
