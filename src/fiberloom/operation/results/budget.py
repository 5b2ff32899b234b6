"""Of what the errors of the science fibres are made, after the last move of an observation.

    loop      where the camera saw the metrology fibre, less its goal
    camera    where the metrology fibre was, less where the camera saw it: noise, and a frame that is off
    fibre     from the metrology to the science fibre, less that way in the layout

On a twin they are known, and add up to the error of the science fibre, fibre by fibre. On hardware the first
is measured, the second is the noise of the image as the camera tells it (a frame that is off adds to it,
unseen), and the third the standard error of the offsets that `calibrate fibres` has found.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fiberloom.calibration.fibres.guider import guided
from fiberloom.typing import Flags, Floats
from fiberloom.units import UM_PER_MM

if TYPE_CHECKING:
    from fiberloom.operation.move import Move
    from fiberloom.operation.results.observed import ObservedField

IN_TRUTH, EXPECTED = "in truth", "measured, and as calibrations tell"


def budget(observed: ObservedField) -> dict[str, Any]:
    """Of `observed`: rms in um by part, two-dimensional, of healthy fibres; None where nothing tells it."""
    move = observed.final
    rows = observed.counted(move) & move.measurement.seen & (observed.assignment.target >= 0)
    if move.true_mm is None or move.true_metrology_mm is None:
        return _expected(observed, move, rows)
    metrology = move.true_metrology_mm - observed.metrology_goal_mm() - observed.frame_mm()
    return _in_truth(observed, rows, metrology, move.true_mm - observed.target_mm())


def _in_truth(observed: ObservedField, rows: Flags, metrology: Floats, science: Floats) -> dict[str, Any]:
    """By true errors (N, 2) of both fibres, mm."""
    star_mm = observed.target_mm()
    loop = observed.final.measurement.xy_mm - observed.metrology_goal_mm()
    left = guided(science[rows], star_mm[rows], np.ones(int(rows.sum()), dtype=bool))
    return {
        "known": IN_TRUTH,
        "loop_um": _rms_um(loop[rows]),
        "camera_um": _rms_um((metrology - loop)[rows]),
        "fibre_um": _rms_um((science - metrology)[rows]),
        "science_um": _rms_um(science[rows]),
        "guider_takes_um": _rms_um(science[rows] - left),
    }


def _expected(observed: ObservedField, move: Move, rows: Flags) -> dict[str, Any]:
    noise = move.measurement.noise_mm2
    camera = None if noise is None else _rms_um(np.sqrt(np.einsum("nii->ni", noise[rows])))
    return {
        "known": EXPECTED,
        "loop_um": _rms_um((move.measurement.xy_mm - observed.metrology_goal_mm())[rows]),
        "camera_um": camera,
        "fibre_um": observed.about.get("fibre_calibration", {}).get("formal_um"),
        "science_um": None,
        "guider_takes_um": None,
    }


def _rms_um(apart_mm: Floats) -> float | None:
    if not len(apart_mm):
        return None
    return UM_PER_MM * float(np.sqrt((apart_mm**2).sum(axis=-1).mean()))
