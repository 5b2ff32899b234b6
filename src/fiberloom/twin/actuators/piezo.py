"""Stick-slip piezo motors of cobras (PFS), in standstill positions: what a number of steps makes of an angle.

A step of pulse t moves the arm by s = p0 (sqrt(t^2 + p1^2) - p1), p0 by place and direction (the motor
map). A move of N steps makes (1 + e_unit + e_here) (1 + sigma_move xi) sum(s) + s sigma_step sqrt(N) xi',
and ends at a hard stop at the latest. Sources: maps and p1 from cobraCharmer; sizes of the errors by what
reproduces the published convergence of visit 72752, of which the split into lasting and fresh is not known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from fiberloom.drive.piezo import MotorMaps, direction_of, pulse_factor
from fiberloom.drive.piezo.maps import PULSE_CURVE_US
from fiberloom.typing import Floats, Ints

BINS, BIN_DEG = 112, 400.0 / 112
MEAN_STEP_DEG, MEAN_STEP_LOG_SD = (0.0717, 0.0705), (0.27, 0.54)
"""Theta and phi, slow: medians of 2394 cobras; the 5 and 95 % of their table."""
MAP_SD, MAP_BINS = 0.23, ((3.2, 0.75), (9.0, 0.25))
"""Of the shape of a map: rms over mean; two lengths and their shares of the variance: correlations of 0.95,
0.84, 0.64, 0.25 over 1, 2, 4, 8 bins."""
PULSE_US = (44.0, 22.0)
"""Slow on-times of theta and phi, medians."""


@dataclass(frozen=True)
class PiezoErrors:
    """Sizes, dimensionless. The defaults come from the published convergence; the rest is marked [A]."""

    unit_mean: float = -0.05
    unit_sd: float = 0.20
    """Lasting, by motor and direction."""
    here_sd: float = 0.10
    here_bins: float = 3.0
    """Lasting, by place: smooth over so many bins."""
    move_median: float = 0.10
    move_log_sd: float = 0.7
    move_most: float = 0.9
    """Fresh, of the way: log-normal between motors."""
    step: float = 0.6
    """Fresh, in steps for each root of their number."""
    stuck_share: float = 0.006
    """Of the cobras; both motors."""
    curve_sd: float = 0.10
    """[A] p1 of a motor differs from the published one."""
    least_pulse_us: float = 8.0
    """[A] Shorter pulses do not overcome static friction."""


class PiezoMotors:
    """The theta and phi motors of n cobras, M = 2 n: rows 0, 2, ... theta, rows 1, 3, ... phi."""

    def __init__(
        self, maps: MotorMaps, stops_deg: Floats, angle_deg: Floats, errors: PiezoErrors, seed: int
    ) -> None:
        """`maps`: of the motors, without their errors; `stops_deg`: (M,) range, from 0; `angle_deg` (M,)."""
        rng = np.random.default_rng(seed)
        cobras = maps.motors // 2
        self.errors, self.stops_deg, self.angle_deg = errors, stops_deg, angle_deg.copy()
        self.curve_us = np.tile(PULSE_CURVE_US, cobras) * (
            1.0 + errors.curve_sd * rng.standard_normal(maps.motors)
        )
        lasting = errors.unit_mean + errors.unit_sd * rng.standard_normal((maps.motors, 2, 1))
        here = _smooth(rng, maps.step_deg.shape, errors.here_bins) * errors.here_sd
        step_deg = maps.step_deg * np.maximum(1.0 + lasting + here, 0.05)
        self.maps = MotorMaps(step_deg, maps.bin_deg, maps.pulse_us)
        scatter = errors.move_median * np.exp(errors.move_log_sd * rng.standard_normal(maps.motors))
        self.move_sigma = np.minimum(scatter, errors.move_most)
        self.stuck = np.repeat(rng.random(cobras) < errors.stuck_share, 2)
        self._rng = rng

    def run(self, steps: Ints, pulse_us: Floats) -> Course:
        """All motors make their steps (M,), signed, with pulses (M,) in us; returns how."""
        rows, direction = np.arange(self.maps.motors), direction_of(steps.astype(np.float64))
        factor = pulse_factor(pulse_us, self.maps.pulse_us[rows, direction], self.curve_us)
        factor = np.where(pulse_us < self.errors.least_pulse_us, 0.0, factor)
        way = self.maps.way_deg(self.angle_deg, steps * factor)
        step_deg = np.abs(way) / np.maximum(np.abs(steps), 1)
        fresh = self._rng.standard_normal((2, self.maps.motors))
        moved = way * (1.0 + self.move_sigma * fresh[0])
        moved += step_deg * self.errors.step * np.sqrt(np.abs(steps)) * fresh[1]
        goes = (steps != 0) & ~self.stuck
        course = Course(self, self.angle_deg, steps * factor, np.where(goes, moved, 0.0), way)
        self.angle_deg = np.clip(self.angle_deg + course.moved_deg, 0.0, self.stops_deg)
        return course


@dataclass(frozen=True, eq=False)
class Course:
    """The way of M motors in one move."""

    motors: PiezoMotors
    start_deg: Floats
    steps: Floats
    """(M,) as they count on the map: of its own pulse."""
    moved_deg: Floats
    """(M,) signed, were there no stops."""
    way_deg: Floats
    """(M,) signed, by the map alone."""

    def at_deg(self, share: Floats) -> Floats:
        """(M,) angles in deg after a `share` (M,) of the steps."""
        by_map = self.motors.maps.way_deg(self.start_deg, self.steps * share)
        scale = self.moved_deg / np.where(self.way_deg == 0.0, 1.0, self.way_deg)
        here: Floats = np.clip(self.start_deg + scale * by_map, 0.0, self.motors.stops_deg)
        return here


def drawn_maps(cobras: int, seed: int) -> MotorMaps:
    """Motor maps of n cobras as the published ones are distributed: (2 n, 2, 112) deg per step."""
    rng = np.random.default_rng(seed)
    motors = 2 * cobras
    spread = np.tile(MEAN_STEP_LOG_SD, cobras) * rng.standard_normal(motors)
    mean = np.tile(MEAN_STEP_DEG, cobras) * np.exp(spread)
    # forward and reverse differ less than motors do
    both = mean[:, None] * np.exp(0.15 * rng.standard_normal((motors, 2)))
    waves = [np.sqrt(share) * _smooth(rng, (motors, 2, BINS), bins) for bins, share in MAP_BINS]
    shape = 1.0 + MAP_SD * np.sum(waves, axis=0)
    pulse = np.tile(PULSE_US, cobras)[:, None].repeat(2, axis=1)
    return MotorMaps(both[..., None] * np.clip(shape, 0.4, 1.7), BIN_DEG, pulse)


def _smooth(rng: np.random.Generator, shape: tuple[int, ...], bins: float) -> Floats:
    """Noise of this shape, smooth over so many bins of the last axis, standard deviation 1."""
    noise = gaussian_filter1d(rng.standard_normal(shape), bins / np.sqrt(2.0), axis=-1, mode="wrap")
    out: Floats = noise / noise.std()
    return out
