"""Where the field is at every moment of a move table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.drive.desi.clock import CRUISE_TENTHS, RAMP_TICKS, SPIN_TICKS, TICK_HZ, degrees_of
from fiberloom.drive.desi.tables import MoveTables
from fiberloom.typing import Floats, Ints

RAMP_CORNERS = np.array([0, 7, 14, 20, 27, 33])
"""Speeds of a ramp at whose ends the path has a corner."""
PATH_ERROR_DEG = 0.023
"""So far a path, straight between its corners, may be from the field, at the arm: seven speeds are 0.7 motor
deg a tick more in 84 ticks, and the line is off by an eighth of that product, and by a step."""


@dataclass(frozen=True)
class FieldPath:
    """Fields of N units at K corners of common ticks, straight in between."""

    tick: Ints
    """(N, K) from the start of the table, never falling."""
    tenths: Floats
    """(N, K, 2) theta and phi from the start, tenths of a motor deg."""

    @property
    def time_s(self) -> Floats:
        """(N, K) s."""
        out: Floats = self.tick / TICK_HZ
        return out

    @property
    def angle_deg(self) -> Floats:
        """(N, K, 2) output angles from the start in deg, of a linear gear."""
        return degrees_of(self.tenths)

    def at(self, tick: ArrayLike) -> Floats:
        """(N, T, 2) tenths of a motor deg at ticks (T,) or (N, T); before and after as at the ends."""
        asked = np.broadcast_to(np.asarray(tick, dtype=np.float64), (len(self.tick), np.shape(tick)[-1]))
        return np.stack([interpolated(asked, self.tick, self.tenths[..., axis]) for axis in (0, 1)], axis=-1)


def interpolated(x: Floats, xp: Ints | Floats, fp: Floats) -> Floats:
    """(N, T) of N piecewise straight lines (N, K) at N times T places; any unit, xp never falling."""
    span = float(max(np.max(xp, initial=0.0), np.max(x, initial=0.0)) + 1.0)
    inside = np.clip(x, xp[:, :1], xp[:, -1:])
    offset = (span * np.arange(len(xp)))[:, None]
    flat = np.interp((inside + offset).ravel(), (xp + offset).ravel(), fp.ravel())
    return flat.reshape(x.shape)


def executed_path(tables: MoveTables) -> FieldPath:
    """The field's path of every table: corners where a motor starts, changes speed, or stops."""
    n = len(tables)
    row_start = np.cumsum(tables.ticks, axis=1) - tables.ticks
    way_start = np.cumsum(tables.way_tenths, axis=1) - tables.way_tenths
    tick, tenths = _corners(tables)
    tick = tick + row_start[..., None, None]
    tenths = tenths + way_start[..., None]
    # (N, 2, corners): each axis on its own
    own_tick = np.moveaxis(tick, 2, 1).reshape(n, 2, -1)
    own_tenths = np.moveaxis(tenths, 2, 1).reshape(n, 2, -1)
    common = np.sort(own_tick.reshape(n, -1), axis=1)
    both = [interpolated(common, own_tick[:, axis], own_tenths[:, axis]) for axis in (0, 1)]
    return FieldPath(common, np.stack(both, axis=-1))


def _corners(tables: MoveTables) -> tuple[Ints, Floats]:
    """(N, R, 2, corners) ticks and tenths of each motor from the start of its row, the row's end last."""
    count, sign = np.abs(tables.steps)[..., None], np.sign(tables.steps)[..., None]
    total, end = np.abs(tables.way_tenths)[..., None], tables.motor_ticks[..., None]
    up_tick = np.broadcast_to(RAMP_TICKS * RAMP_CORNERS, (*tables.steps.shape, len(RAMP_CORNERS)))
    up = np.broadcast_to(RAMP_TICKS * RAMP_CORNERS * (RAMP_CORNERS + 1) // 2, up_tick.shape)
    down_tick = SPIN_TICKS + count + RAMP_TICKS * (CRUISE_TENTHS - RAMP_CORNERS[::-1])
    cruise_tick = np.concatenate([up_tick, down_tick], axis=-1)
    cruise = np.concatenate([up, total - up[..., ::-1]], axis=-1)
    first = np.arange(cruise.shape[-1]) == 0
    cruises = tables.cruise[..., None]
    tick = np.where(cruises, cruise_tick, np.where(first, 0, end))
    way = np.where(cruises, cruise, np.where(first, 0, total))
    row_end = np.broadcast_to(tables.ticks[:, :, None, None], (*tables.steps.shape, 1))
    tick = np.concatenate([tick, row_end], axis=-1)
    return tick, np.concatenate([sign * way, sign * total], axis=-1).astype(np.float64)
