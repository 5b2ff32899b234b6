"""The true gears of units: how they are drawn, and as tables without the physics.

What a gear deviates by is a harmonic series over the output turn. No paper prints which orders a gear
has, so the spectrum is a choice (`GearSpectrum`), and what depends on it must be shown for more than one.

The truth lies between 4096 nodes a turn by straight lines (core/twin, transmission.hpp), so tables
of the nodes are the same gears, not an approximation. All angles in rad, arrays (N, 2, M).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fiberloom._core import twin as _core
from fiberloom.twin.errors.switches import GearSpectrum, gear_spectrum
from fiberloom.twin.units import GEAR_DTYPE, ORDERS, Units
from fiberloom.typing import Floats, Ints, Records
from fiberloom.units import GEAR, RAD_PER_DEG

Rng = np.random.Generator

STAGES: Mapping[int, tuple[float, float]] = {
    1: (1.75e-3, 2.55e-3),
    2: (1.05e-3, 1.25e-3),
    3: (5.8e-4, 7.0e-4),
    35: (9e-5, 9e-5),
    36: (4.0e-4, 4.0e-4),
    37: (9e-5, 9e-5),
    72: (1.8e-4, 1.8e-4),
    108: (1.3e-4, 1.3e-4),
    204: (5.0e-4, 5.0e-4),
}
"""Amplitude of each order of delta, alpha and beta, output rad. TUNED: see `fiberloom.twin.draw`."""
TEETH: Mapping[int, tuple[float, float]] = {
    1: (1.60e-3, 2.35e-3),
    2: (9.7e-4, 1.15e-3),
    3: (5.4e-4, 6.50e-4),
    35: (1.50e-4, 1.50e-4),
    36: (6.0e-4, 6.0e-4),
    37: (1.50e-4, 1.50e-4),
    71: (1.50e-4, 1.50e-4),
    72: (6.0e-4, 6.0e-4),
    73: (1.50e-4, 1.50e-4),
    108: (9.0e-4, 9.0e-4),
}
"""The same without an earlier stage. TUNED to the same blind errors."""
BACKLASH_SHAPE: Mapping[int, float] = {
    1: 1.0,
    2: 0.55,
    3: 0.35,
    35: 0.05,
    36: 0.22,
    37: 0.05,
    71: 0.02,
    72: 0.08,
    73: 0.02,
    108: 0.04,
    203: 0.02,
    204: 0.06,
    205: 0.02,
}
"""Backlash of each order that a gear has, relative; scaled to the extremes drawn from Fig. 10's range."""
BACKLASH_LOWEST_DEG = (40.0, 70.0)
BACKLASH_HIGHEST_DEG = (190.0, 250.0)

_LINES = {36: (35, 37), 72: (71, 73), 108: (), 204: (203, 205)}
"""Orders of teeth and their sidebands, of which a gear of the family has some."""
_MAY_LACK = (72, 108, 204)
_PRESENT = 0.6
"""Probability of each of these; at least one is there. Assumed, as are the ranges below."""
_STRENGTH = (0.5, 2.0)
"""Amplitude of a line over its middle size, log-uniform."""
_SIDEBAND = (0.1, 0.5)
"""Sidebands over their line, uniform."""
_FAMILY_RAD = {36: 5.0e-4, 72: 3.50e-4, 108: 3.50e-4, 204: 4.50e-4}
"""Middle sizes, output rad. TUNED to the same blind errors, over many gears."""

NODE_RAD = 2.0 * np.pi / _core.NODES_PER_TURN
_SPAN = (-160, _core.NODES_PER_TURN + 280)
"""Nodes that the tables hold: -14 to 384 deg, beyond every hard stop. Straight on outside."""


# drawing


def told_of(spectrum: GearSpectrum) -> str:
    """For `put_in`: the amplitudes of a `spectrum`, in deg, and where they come from."""
    source = "harmonic amplitudes, tuned to the blind errors of Fig. 19 and 26"
    if spectrum == "family":
        return f"{source}: each gear has lines of its own at 36, 72, 108 and 204 a turn, some of them"
    sizes = {"stages": STAGES, "teeth": TEETH}[spectrum]
    (alpha, beta), (teeth, _) = np.divide(sizes[1], RAD_PER_DEG), np.divide(sizes[36], RAD_PER_DEG)
    once = f"{alpha:.3f} / {beta:.3f} deg once a turn (alpha / beta)"
    return f"{source}: {once}, {teeth:.3f} deg at the 36 tooth pairings"


def draw_gear(axis: int, rng: Rng, spectrum: GearSpectrum = "stages") -> Records:
    """A true transmission, one GEAR_DTYPE record without wear, of `axis` 0 or 1, drawn by `rng`.

    `spectrum`: which orders it has.
    """
    record = np.zeros((), GEAR_DTYPE)
    sizes = _sizes(axis, rng, spectrum)
    rows, orders = _rows_of(frozenset(sizes))
    record["delta_rad"][rows] = [_wave(sizes[m], rng) for m in orders]
    shape = np.array([_wave(BACKLASH_SHAPE[m], rng) for m in orders])
    lowest_rad = rng.uniform(*BACKLASH_LOWEST_DEG) * RAD_PER_DEG
    highest_rad = rng.uniform(*BACKLASH_HIGHEST_DEG) * RAD_PER_DEG
    # stretched between two extremes: its mean was zero and its scale free
    curve = shape.ravel() @ _turn(orders)
    stretch = (highest_rad - lowest_rad) / (curve.max() - curve.min())
    record["backlash_rad"][rows] = stretch * shape
    record["backlash_mean_rad"] = lowest_rad - stretch * curve.min()
    return record


def other_gears(numbers: Ints, seed: int, spectrum: GearSpectrum) -> Records:
    """(N, 2) gears of the units of these `numbers` with another `spectrum`; by `seed` and number alone.

    InputError for a spectrum that is not known.
    """
    spectrum = gear_spectrum(spectrum)
    out = np.zeros((len(numbers), 2), GEAR_DTYPE)
    for row, number in enumerate(numbers):
        rng = np.random.default_rng([seed, int(number), 0x6EA2])
        out[row] = [draw_gear(axis, rng, spectrum) for axis in (0, 1)]
    return out


@lru_cache(maxsize=64)
def _rows_of(orders: frozenset[int]) -> tuple[Ints, tuple[int, ...]]:
    """Where ORDERS has these `orders`, and they themselves, rising."""
    rows: Ints = np.flatnonzero(np.isin(ORDERS, list(orders)))
    return rows, tuple(ORDERS[rows].tolist())


def held(rng: Rng, count: int) -> list[float]:
    """Standard normals, ratios of deviation to sd, cut at three: acceptance refuses units beyond."""
    return [min(max(x, -3.0), 3.0) for x in rng.standard_normal(count).tolist()]


def _sizes(axis: int, rng: Rng, spectrum: GearSpectrum) -> dict[int, float]:
    """Amplitude in output rad of every order that this gear has."""
    if spectrum == "family":
        return {m: STAGES[m][axis] for m in (1, 2, 3)} | _lines(rng)
    return {m: both[axis] for m, both in (STAGES if spectrum == "stages" else TEETH).items()}


def _lines(rng: Rng) -> dict[int, float]:
    """The orders of teeth of one gear of the family, with their sidebands."""
    there = [m for m in _MAY_LACK if rng.random() < _PRESENT] or [int(rng.choice(_MAY_LACK))]
    out = {}
    for line in (36, *there):
        out[line] = _FAMILY_RAD[line] * float(np.exp(rng.uniform(*np.log(_STRENGTH))))
        out |= {side: out[line] * rng.uniform(*_SIDEBAND) for side in _LINES[line]}
    return out


def _wave(amplitude: float, rng: Rng) -> tuple[float, float]:
    phase = 2.0 * math.pi * rng.random()
    size = amplitude * (1.0 + 0.2 * min(max(rng.standard_normal(), -3.0), 3.0))  # as `held` one
    return size * math.cos(phase), size * math.sin(phase)


@lru_cache(maxsize=64)
def _turn(orders: tuple[int, ...]) -> Floats:
    """(2 orders, nodes of a turn): cosines and sines of these orders."""
    waves = np.outer(orders, np.arange(_core.NODES_PER_TURN) * NODE_RAD)
    return np.stack([np.cos(waves), np.sin(waves)], axis=1).reshape(2 * len(orders), -1)


# tables


@lru_cache(maxsize=1)
def _waves() -> Floats:
    """(2 orders, nodes): cosines and sines of every order."""
    turn = np.outer(ORDERS, np.arange(*_SPAN)) % _core.NODES_PER_TURN * NODE_RAD
    return np.stack([np.cos(turn), np.sin(turn)], axis=1).reshape(2 * len(ORDERS), -1)


def _series(amplitudes: Floats) -> Floats:
    """(N, 2, K) sums of (N, 2, orders, 2) amplitudes at the nodes."""
    waves = _waves()
    total = np.zeros((*amplitudes.shape[:2], waves.shape[1]))
    # one by one: what another unit has does not touch this one's last digit
    for k in np.flatnonzero(amplitudes.any(axis=(0, 1, 3))):
        total += amplitudes[:, :, k, :1] * waves[2 * k] + amplitudes[:, :, k, 1:] * waves[2 * k + 1]
    return total


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
        gear = units.gear
        theta: Floats = np.asarray(NODE_RAD * np.arange(*_SPAN), dtype=np.float64)
        delta: Floats = _series(gear["delta_rad"]) + _worn_rad(gear["wear"], theta)
        backlash = _series(gear["backlash_rad"])
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
