"""Homing by the stops: for units whose place is not known.

Phi creeps to its stop, folded, then theta to its lower stop; both back off and come again in their final
direction, so that the play is closed as after a move. The field of a rotor that a stop holds goes on; what is
left of its last turn is not known.
"""

from __future__ import annotations

import numpy as np

from fiberloom.drive.desi.clock import FINAL_DIRECTION, GEAR, MOST_STEPS, tenths_of
from fiberloom.drive.desi.tables import MoveTables
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats, Ints

SEEK = 1.3
"""[Q] Way of a search, in ranges of the axis."""
BACK_DEG = 6.0
"""Off the stop; half of it is gone back again, which closes the play: 3 deg remain, as published."""
HOMED_SIGMA_DEG = 360.0 / GEAR / np.sqrt(12.0)
"""[D] Of a place that a stop tells: a turn of the motor, evenly."""


def homing_tables(plane: FocalPlane, rows: Ints) -> MoveTables:
    """Tables of all N units of a `plane`: those `rows` search their stops by creep, phi before theta."""
    ranges = np.ptp(plane.stops_of(rows), axis=2)
    seek = FINAL_DIRECTION * tenths_of(SEEK * ranges)
    parts = int(np.ceil(np.abs(seek).max(initial=1) / MOST_STEPS))
    share = np.floor_divide(seek[:, None] * np.arange(parts + 1)[:, None], parts)
    each = np.diff(share, axis=1)
    back = FINAL_DIRECTION * tenths_of(BACK_DEG)
    legs = np.zeros((len(rows), 2 * parts + 2, 2), dtype=np.int64)
    legs[:, :parts, 1], legs[:, parts:-2, 0] = each[..., 1], each[..., 0]
    legs[:, -2], legs[:, -1] = -back, back // 2
    steps = np.zeros((len(plane), *legs.shape[1:]), dtype=np.int64)
    steps[rows] = legs
    return MoveTables(steps, np.zeros_like(steps, dtype=bool), np.zeros(steps.shape[:2], dtype=np.int64))


def homed_deg(plane: FocalPlane, rows: Ints) -> Floats:
    """(n, 2) deg where these stand then."""
    stops = plane.stops_of(rows)
    at_stop = np.where(FINAL_DIRECTION > 0, stops[..., 1], stops[..., 0])
    return np.asarray(at_stop - 0.5 * BACK_DEG * FINAL_DIRECTION)
