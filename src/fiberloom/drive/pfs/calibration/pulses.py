"""Pulses for steps of a wanted length: slow ones and fast ones (cobraCharmer)."""

from __future__ import annotations

import numpy as np

from fiberloom.drive.piezo import MotorMaps, pulse_factor
from fiberloom.typing import Floats

SLOW_STEP_DEG, FAST_STEP_DEG = 0.06, 0.12
"""Mean steps that the on-times of slow and fast maps are chosen for."""
LEAST_PULSE_US, MOST_PULSE_US = 12.0, 140.0


def pulses_for(maps: MotorMaps, curve_us: Floats, step_deg: float) -> Floats:
    """(M, 2) whole us of pulses by which motors make steps of `step_deg` on average; within what boards take.

    `maps` of M motors at their pulses; `curve_us` (M,): p1 of these. A step goes as sqrt(t^2 + p1^2) - p1.
    """
    p1 = curve_us[:, None]
    height = step_deg / maps.step_deg.mean(axis=2) * (np.hypot(maps.pulse_us, p1) - p1)
    pulse = np.sqrt(height * (height + 2.0 * p1))
    whole: Floats = np.clip(np.rint(pulse), LEAST_PULSE_US, MOST_PULSE_US)
    return whole


def maps_at(maps: MotorMaps, curve_us: Floats, pulse_us: Floats) -> MotorMaps:
    """The maps for other pulses `pulse_us` (M, 2) in us, by the curve p1 (M,) in us: calibrate them then."""
    farther = pulse_factor(pulse_us, maps.pulse_us, curve_us[:, None])
    return MotorMaps(maps.step_deg * farther[:, :, None], maps.bin_deg, pulse_us)
