"""Planetary gears: how far an arm is from where a linear gear would have it; not periodic in a turn.

A stage of ring 46, sun 14 and planet 16 (ratio r = 46 / 14 + 1) errs at 1, 46 / 16, r - 1 and 46 cycles for
a turn of its carrier; the stage before it at these times r. The orders follow from the teeth; the amplitudes
reproduce the published blind error of DESI (Silber et al. 2022, 54 um rms), each within 30 % for a unit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.drive.desi.maps.orders import ORDERS
from fiberloom.typing import Floats

AMPLITUDE_DEG = np.array([0.45, 0.20, 0.30, 0.15, 0.05, 0.05, 0.01])
"""[D] By order, at the arm."""
AMPLITUDE_SPREAD = 0.30
"""[D] Uniform between units, relative."""
SCATTER_DEG = 0.02
"""[D] Fresh with each move, standard deviation of an axis."""
BACKLASH_DEG = (0.5, 2.0)
"""[A] At the arm, uniform; the approach of 3 deg closes it."""


@dataclass(frozen=True)
class PlanetaryGears:
    """Gears of N units: axis 0 is theta, 1 is phi."""

    amplitude_deg: Floats
    """(N, 2, orders)."""
    phase_rad: Floats
    """(N, 2, orders)."""
    play_deg: Floats
    """(N, 2) backlash, and twice the lag of the rotor, which friction makes."""

    def error_deg(self, gear_deg: Floats) -> Floats:
        """(N, K, 2) deg by which arms are beyond a linear gear at gear angles (N, K, 2) in deg."""
        out = np.zeros_like(gear_deg)
        turned = np.deg2rad(gear_deg)
        for k, order in enumerate(ORDERS):
            phase = self.phase_rad[:, None, :, k]
            out += self.amplitude_deg[:, None, :, k] * np.sin(order * turned + phase)
        return out

    def output_deg(self, gear_deg: Floats) -> Floats:
        """(N, K, 2) angles of the arms in deg at gear angles (N, K, 2) in deg."""
        return gear_deg + self.error_deg(gear_deg)

    def gear_deg(self, output_deg: Floats) -> Floats:
        """(N, K, 2) deg: the inverse of `output_deg`. Slopes are below a tenth: ten rounds leave 1e-9 deg."""
        gear = output_deg
        for _ in range(10):
            gear = output_deg - self.error_deg(gear)
        return gear


def draw_gears(units: int, rng: np.random.Generator, lag_deg: float) -> PlanetaryGears:
    """Gears of so many units by `rng`; `lag_deg`: of their rotors at rest, at the arm."""
    shape = (units, 2, len(ORDERS))
    spread = 1.0 + AMPLITUDE_SPREAD * rng.uniform(-1.0, 1.0, shape)
    phase = rng.uniform(0.0, 2.0 * np.pi, shape)
    backlash = rng.uniform(*BACKLASH_DEG, (units, 2))
    return PlanetaryGears(AMPLITUDE_DEG * spread, phase, backlash + 2.0 * lag_deg)


def played(gear_deg: Floats, rotor_deg: Floats, play_deg: Floats) -> Floats:
    """(N, K, 2) gear angles in deg behind rotors (N, K, 2) that move straight from one to the next.

    `gear_deg` (N, 2): where gears are at first; `play_deg` (N, 2): the whole gap between both contacts.
    """
    out, at, half = np.empty_like(rotor_deg), gear_deg, 0.5 * play_deg
    for k in range(rotor_deg.shape[1]):
        at = np.clip(at, rotor_deg[:, k] - half, rotor_deg[:, k] + half)
        out[:, k] = at
    return out
