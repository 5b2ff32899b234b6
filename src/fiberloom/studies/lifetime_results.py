"""What a lifetime campaign found: curves, summary, requirement, and the files that hold them."""

from __future__ import annotations

import datetime
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.instruments.model import AXES
from fiberloom.report.lifetime import LifetimeCurves, plot_deltas, plot_lifetime, rms
from fiberloom.studies.campaign import Campaign
from fiberloom.studies.lifetime import (
    DELTAS,
    MOVES_PER_CYCLE,
    WAYS,
    LifetimeSettings,
    delta_angles_deg,
    lifetime,
)
from fiberloom.studies.workers import Rows
from fiberloom.twin.bench import bench_units
from fiberloom.typing import Floats
from fiberloom.version import __version__
from fiberloom.wholefile import write_whole

WITHIN = 1.05
"""The improved estimator's error over that of recalibration, at most."""
MAP_GAIN = 3.0
"""The linear ratio's error over that of a map, at least; the paper's factor is 3.5."""


def lifetime_campaign(positioners: int, seed: int, settings: LifetimeSettings) -> Campaign:
    """The campaign of so many units."""
    return Campaign("lifetime", lifetime, positioners, seed, settings, chunk=_chunk(positioners))


def _chunk(positioners: int) -> int:
    """Units simulated side by side: the more, the cheaper each; by their number alone."""
    return min(max(2, positioners // 8), 16)


def write_results(out: Path, study: Campaign, rows: Rows) -> dict[str, Any]:
    """lifetime.json, lifetime.png and delta.png of all rows of the campaign; returns the content."""
    curves = _curves(study, rows)
    result = _marks(study) | _result(study, rows) | {"summary": summarize(curves)}
    _write(out / "lifetime.json", result)
    plot_lifetime(out / "lifetime.png", curves)
    plot_deltas(out / "delta.png", curves)
    return result


def _curves(study: Campaign, rows: Rows) -> LifetimeCurves:
    plane, _ = bench_units(study.settings.instrument, study.seed, range(study.n_units))
    return LifetimeCurves(
        cycles=study.settings.simulated,
        positioner_id=plane.positioner_id,
        blind_um={way: rows["measured_um"][:, i] for i, way in enumerate(WAYS)},
        arms_mm=rows["arms_mm"],
        true_arms_mm=rows["true_arms_mm"],
        delta_cycles=study.settings.kept,
        delta_angles_deg=delta_angles_deg(plane),
        delta_deg={name: rows["delta_deg"][:, :, i] for i, name in enumerate(DELTAS)},
    )


def _rms(per_unit_um: Floats) -> list[float | None]:
    """Over positioners, by cycle."""
    return [None if np.isnan(um) else round(float(um), 4) for um in rms(per_unit_um, axis=0)]


def summarize(curves: LifetimeCurves) -> dict[str, float]:
    """Ratios of the blind errors, rms over the later half of the cycles."""
    late = slice(len(curves.cycles) // 2, None)
    um = {way: float(rms(e[:, late])) for way, e in curves.blind_um.items()}
    change = curves.delta_deg["true"][:, -1:] - curves.delta_deg["true"][:, :1]
    arms_um = 1e3 * np.ptp(curves.arms_mm, axis=1)
    return {
        **{f"{way}_um": um[way] for way in WAYS},
        "linear_over_recalibrated": um["linear"] / um["recalibrated"],
        "fixed_over_recalibrated": um["fixed"] / um["recalibrated"],
        "adaptive_paper_over_recalibrated": um["adaptive_paper"] / um["recalibrated"],
        "adaptive_over_recalibrated": um["adaptive"] / um["recalibrated"],
        "adaptive_over_recalibrated_fine": um["adaptive"] / um["recalibrated_fine"],
        "largest_change_of_delta_deg": float(np.abs(change).max()),
        "largest_span_of_an_arm_um": float(arms_um.max()),
    }


def within_requirement(summary: dict[str, float]) -> bool:
    """Whether learning does what recalibrating would, and a map what it is for: by the ratios of errors
    (um over um, no unit) in `summary`."""
    return summary["adaptive_over_recalibrated"] <= WITHIN and summary["linear_over_recalibrated"] >= MAP_GAIN


def _result(study: Campaign, rows: Rows) -> dict[str, Any]:
    settings = study.settings
    by_way = {name: dict(zip(WAYS, np.swapaxes(rows[name], 0, 1), strict=True)) for name in
              ("measured_um", "true_um", "corrected_um")}  # fmt: skip
    corrected = {w: _rms(e) for w, e in by_way["corrected_um"].items() if np.isfinite(e).any()}
    few = slice(0, 8)
    return {
        "cycles": settings.simulated.tolist(),
        "blind_rms_um": {way: _rms(e) for way, e in by_way["measured_um"].items()},
        "blind_true_rms_um": {way: _rms(e) for way, e in by_way["true_um"].items()},
        "corrected_true_rms_um": corrected,
        "moves_per_cycle": MOVES_PER_CYCLE,
        "moves_to_targets": settings.approaches * (1 + settings.corrections),
        "positioners": study.n_units,
        "dropped_out": np.isnan(rows["true_um"][:, 0]).sum(axis=0).tolist(),
        "settings": asdict(settings),
        "put_in": {
            "wear": asdict(settings.wear),
            "gears": settings.gears,
            "note": "heights of the marks tuned to 0.15 deg (Fig. 22), arms within 1 um given (Fig. 21); "
            "number, widths and pace assumed; the spectrum of the gears tuned to blind errors (Fig. 19, 26)",
        },
        "arms": {
            "columns": list(AXES),
            "calibrated_mm": rows["arms_mm"][few].round(6).tolist(),
            "true_mm": rows["true_arms_mm"][few].round(6).tolist(),
        },
    }


def _marks(study: Campaign) -> dict[str, Any]:
    settings = study.settings
    plane, units = bench_units(settings.instrument, study.seed, range(study.n_units), settings.gears)
    return {
        "version": __version__,
        "seed": study.seed,
        "instrument": plane.instrument.name,
        "config_hash": plane.config_hash(),
        "units": units.digest(),
        "utc": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def _write(path: Path, result: dict[str, Any]) -> None:
    write_whole(path, json.dumps(result, indent=1) + "\n")


_HEADS = {
    "linear": "linear",
    "fixed": "fixed",
    "adaptive_paper": "as printed",
    "adaptive": "adaptive",
    "recalibrated": "recalib.",
    "recalibrated_fine": "recalib. 4x",
}


def _um(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def blind_errors(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Blind errors at some cycles, for a terminal."""
    cycles = result["cycles"]
    shown = sorted({0, len(cycles) - 1, *(i for i, c in enumerate(cycles) if c in (2, 5, 10, 20, 50, 100))})
    return [
        {"cycle": cycles[i]} | {head: _um(result["blind_rms_um"][w][i]) for w, head in _HEADS.items()}
        for i in shown
    ]
