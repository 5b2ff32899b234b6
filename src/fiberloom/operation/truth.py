"""Where the fibres really were, at the image and while light was collected: of a twin, for reports."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from fiberloom.hardware import Truth
from fiberloom.instruments.model import METROLOGY
from fiberloom.instruments.pointing import ExposurePointing
from fiberloom.operation.move import Goals
from fiberloom.typing import Floats


def truths(truth: Truth | None, goals: Goals, pointing: ExposurePointing | None) -> dict[str, Any]:
    """The true positions of a `Move`, by its names, mm; none where the `truth` is not known.

    `goals`: of N positioners, which fibre of each counts; `pointing`: of the image and the exposure after
    it. None: of nothing but the image.
    """
    if truth is None:
        return {"true_mm": None}
    known: dict[str, Any] = {"true_metrology_mm": truth.fibre_xy(METROLOGY)}
    here_mm = _science(truth.fibre_xy, goals)
    if pointing is None:
        return known | {"true_mm": here_mm}
    begin, middle, end = (_science(partial(truth.fibre_xy_at, pointing=at), goals) for at in pointing.along())
    return known | {"true_mm": middle, "true_image_mm": here_mm, "true_ends_mm": np.stack([begin, end])}


def _science(fibre_xy: Callable[[str], Floats], goals: Goals) -> Floats:
    """(N, 2) the fibre that goes to a target; the metrology fibre without one."""
    true_mm = fibre_xy(METROLOGY)
    for fibre in np.unique(goals.fibre[goals.has_target]):
        rows = goals.has_target & (goals.fibre == fibre)
        true_mm[rows] = fibre_xy(str(fibre))[rows]
    return true_mm
