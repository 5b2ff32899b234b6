"""The true gears of many units as tables: motor, gear and output angles without the physics.

The truth lies between 4096 nodes a turn by straight lines (core/twin, transmission.hpp), so tables
of the nodes are the same gears, not an approximation. All angles in rad, arrays (N, 2, M).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fiberloom._core import twin as _core
from fiberloom.twin.units import ORDERS, Units
from fiberloom.typing import Floats, Ints
from fiberloom.units import GEAR

NODE_RAD = 2.0 * np.pi / _core.NODES_PER_TURN
_SPAN = (-160, _core.NODES_PER_TURN + 280)
"""Nodes that the tables hold: -14 to 384 deg, beyond every hard stop. Straight on outside."""


@lru_cache(maxsize=1)
def _waves() -> Floats:
    """(2 orders, nodes): cosines and sines of every order."""
    turn = np.outer(ORDERS, np.arange(*_SPAN)) % _core.NODES_PER_TURN * NODE_RAD
    return np.stack([np.cos(turn), np.sin(turn)], axis=1).reshape(2 * len(ORDERS), -1)


def _worn_rad(wear: Floats, theta: Floats) -> Floats:
    """(N, 2, K) sum of the marks (N, 2, M, 3); most have a height of zero."""
    out = np.zeros((*wear.shape[:2], len(theta)))
    for row, axis, k in np.argwhere(wear[..., 2] != 0.0):
        centre, width, height = wear[row, axis, k]
        first, last = np.searchsorted(theta, [centre - 0.5 * width, centre + 0.5 * width])
        off = np.abs(theta[first:last] - centre)
        out[row, axis, first:last] += 0.5 * height * (1.0 + np.cos(2.0 * np.pi * off / width))
    return out


class Gears:
    """T- and backlash of N units, (N, 2, K) at the nodes; Kronig 2020, Eq. 6 and 7."""

    def __init__(self, units: Units) -> None:
        n, gear = len(units), units.gear
        theta: Floats = np.asarray(NODE_RAD * np.arange(*_SPAN), dtype=np.float64)
        delta: Floats = gear["delta_rad"].reshape(n, 2, -1) @ _waves() + _worn_rad(gear["wear"], theta)
        backlash = gear["backlash_rad"].reshape(n, 2, -1) @ _waves()
        self.output_rad = np.broadcast_to(theta, delta.shape).copy()
        self.gear_rad = GEAR * (theta + delta)
        self.motor_rad = self.gear_rad + gear["backlash_mean_rad"][..., None] + backlash
        """Rotor in positive contact, Eq. 3b with its sign corrected."""

    def put(self, rows: NDArray[np.intp], gears: Gears) -> None:
        """Other gears for some units."""
        self.gear_rad[rows], self.motor_rad[rows] = gears.gear_rad, gears.motor_rad

    def output_of(self, gear_rad: Floats) -> Floats:
        """Output angle in rad of a gear angle, without outside torque; (N, 2, M)."""
        return _line(self.gear_rad, self.output_rad, gear_rad, GEAR * NODE_RAD)

    def gear_of(self, output_rad: Floats) -> Floats:
        """T-: gear angle in rad of an output angle; (N, 2, M)."""
        return _line(self.output_rad, self.gear_rad, output_rad, NODE_RAD)

    def pushed_up(self, motor_rad: Floats) -> Floats:
        """Gear angle in rad at which a rotor is in positive contact: upward motion of the gear stops
        there; (N, 2, M).
        """
        return _line(self.motor_rad, self.gear_rad, motor_rad, GEAR * NODE_RAD)

    def play(self, gear_rad: Floats, motor_rad: Floats) -> Floats:
        """Gear angle in rad after the rotor went straight to `motor_rad`, Eq. 4: in the gap it stays;
        (N, 2, M).
        """
        return np.minimum(np.maximum(gear_rad, self.pushed_up(motor_rad)), motor_rad)


def _line(x: Floats, y: Floats, at: Floats, cell: float) -> Floats:
    """y between nodes x that rise by about `cell`, at (N, 2, M)."""
    k = _locate(x, at, cell)
    low, y_low = x.take(k), y.take(k)
    k += 1
    return y_low + (at - low) / (x.take(k) - low) * (y.take(k) - y_low)


_NEWTON = 2
"""Steps by the mean slope that may pass the cell: gears are straight to a sixth, so two leave a cell."""


def _locate(x: Floats, at: Floats, cell: float) -> Ints:
    """Flat index of the cell that holds `at`: guessed by the mean slope, then stepped to."""
    nodes = x.shape[-1]
    first = nodes * np.arange(x.size // nodes).reshape(*x.shape[:-1], 1)
    last = first + (nodes - 2)
    k: Ints = first
    for _ in range(1 + _NEWTON):
        k = np.clip(k + np.floor((at - x.take(k)) / cell).astype(np.int64), first, last)
    while True:
        # never past it: gears are steeper than half their mean
        down = np.ceil(np.maximum(x.take(k) - at, 0.0) / (2.0 * cell))
        up = np.floor(np.maximum(at - x.take(k + 1), -cell) / (2.0 * cell)) + 1.0
        stepped = np.clip(k + (up - down).astype(np.int64), first, last)
        if np.array_equal(stepped, k):
            return k
        k = stepped
