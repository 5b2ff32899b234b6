"""What wrong fiducials do to a camera that gives positions and no images.

The host fits its transformation on the fiducials, by where its table has them: it goes through all of them
as nearly as its terms allow, and every fibre in between is off by the same field in every image. With the
61 fiducials of the preset sdssv, 8 um in each coordinate become 3.3 um at the fibres
(`python -m benchmarks.tables`).
"""

from __future__ import annotations

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.metrology.cameras import view_of
from fiberloom.metrology.transform import Distortion, FieldTransform, fit_transform
from fiberloom.typing import Floats


class WrongFrame:
    """The map from where a fibre is to where a fit on wrong fiducials has it."""

    def __init__(self, plane: FocalPlane, true_fiducials_mm: Floats) -> None:
        """`true_fiducials_mm`: (F, 2), in the order of the plane's."""
        self._fit: FieldTransform | None = None
        table_mm = plane.fiducials[:, :2]
        if len(table_mm) >= _FEWEST and not np.array_equal(true_fiducials_mm, table_mm):
            field = Distortion(view_of(plane)[1])
            self._fit = fit_transform(true_fiducials_mm, table_mm, field).transform

    def seen_mm(self, xy_mm: Floats) -> Floats:
        """(N, 2) mm: where the host has fibres that are at `xy_mm` (N, 2)."""
        return xy_mm if self._fit is None else self._fit.to_mm(xy_mm)


_FEWEST = 3
"""Fiducials that a similarity needs."""
