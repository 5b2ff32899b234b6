"""Of what the errors of the science fibres are made, after the last move of an observation.

    loop      where the camera saw the metrology fibre, less its goal
    camera    where the metrology fibre was, less where the camera saw it: noise, and a frame that is off
    fibre     from the metrology to the science fibre, less that way in the layout
    guiding   where the target was taken to be, less where its star was: of a telescope that points off
    gravity   from the image to the middle of the exposure, less the way by which the fibre was led; where the
              pointing of the telescope is known

On a twin they are known, and add up to the error of the science fibre, fibre by fibre. On hardware the first
is measured, the second is the noise of the image as the camera tells it (a frame that is off adds to it,
unseen), the third the standard error of the offsets that `calibrate fibres` has found, and the fourth that of
the sag of `calibrate gravity`, times the change of gravity.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fiberloom.calibration.fibres.guider import guided
from fiberloom.instruments.pointing import STANDARD_GRAVITY_M_S2, ExposurePointing
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
    metrology = move.true_metrology_mm - observed.metrology_goal_mm(move) - observed.frame_mm()
    return _in_truth(observed, rows, metrology, move.true_mm - observed.star_mm(move))


def _in_truth(observed: ObservedField, rows: Flags, metrology: Floats, science: Floats) -> dict[str, Any]:
    """By true errors (N, 2), mm: metrology fibre at the image, science fibre in the exposure."""
    star_mm, sagged = observed.star_mm(observed.final), _sagged_mm(observed)
    beside_mm = observed.target_mm(observed.final) - star_mm
    loop = observed.final.measurement.xy_mm - observed.metrology_goal_mm(observed.final)
    left = guided(science[rows], star_mm[rows], np.ones(int(rows.sum()), dtype=bool))
    return {
        "known": IN_TRUTH,
        "loop_um": _rms_um(loop[rows]),
        "camera_um": _rms_um((metrology - loop)[rows]),
        "fibre_um": _rms_um((science - beside_mm - sagged - metrology)[rows]),
        "guiding_um": None if observed.final.star_mm is None else _rms_um(beside_mm[rows]),
        "gravity_um": None if observed.final.true_image_mm is None else _rms_um(sagged[rows]),
        "science_um": _rms_um(science[rows]),
        "guider_takes_um": _rms_um(science[rows] - left),
    }


def _sagged_mm(observed: ObservedField) -> Floats:
    """(N, 2) from the image to the middle of the exposure, less the way by which each fibre was led."""
    then_mm, here_mm = observed.final.true_mm, observed.final.true_image_mm
    if then_mm is None or here_mm is None:
        return np.zeros((len(observed.plane), 2))
    return then_mm - here_mm + observed.lead_mm()


def _expected(observed: ObservedField, move: Move, rows: Flags) -> dict[str, Any]:
    noise = move.measurement.noise_mm2
    camera = None if noise is None else _rms_um(np.sqrt(np.einsum("nii->ni", noise[rows])))
    return {
        "known": EXPECTED,
        "loop_um": _rms_um((move.measurement.xy_mm - observed.metrology_goal_mm(move))[rows]),
        "camera_um": camera,
        "fibre_um": observed.about.get("fibre_calibration", {}).get("formal_um"),
        "guiding_um": _expected_guiding_um(observed, move, rows),
        "gravity_um": _expected_sag_um(observed),
        "science_um": None,
        "guider_takes_um": None,
    }


def _expected_sag_um(observed: ObservedField) -> float | None:
    """What the calibration leaves open of the sag from the image to the middle of the exposure."""
    formal_um = observed.about.get("gravity_calibration", {}).get("formal_um")
    told = observed.about.get("pointing")
    if formal_um is None or told is None:
        return None
    pointing = ExposurePointing.of(told)
    change_m_s2 = pointing.middle.gravity_m_s2() - pointing.image.gravity_m_s2()
    return float(formal_um * np.hypot(*change_m_s2) / STANDARD_GRAVITY_M_S2)


def _expected_guiding_um(observed: ObservedField, move: Move, rows: Flags) -> float | None:
    """By the errors of the last fit of guide stars."""
    told = [one for one in observed.about.get("guiding", []) if one["applied"]]
    if move.pointed is None or not told or not rows.any():
        return None
    turn = np.radians(told[-1]["rotation_error_arcsec"] / 3600.0)
    square = 0.5 * (turn**2 + (1e-6 * told[-1]["scale_error_ppm"]) ** 2)
    radius_um = UM_PER_MM * np.hypot(*observed.target_mm(move)[rows].T)
    return float(np.sqrt(2.0 * (told[-1]["offset_error_um"] ** 2 + square * (radius_um**2).mean())))


def _rms_um(apart_mm: Floats) -> float | None:
    if not len(apart_mm):
        return None
    return UM_PER_MM * float(np.sqrt((apart_mm**2).sum(axis=-1).mean()))
