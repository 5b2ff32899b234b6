"""The true units of DESI: arms, gears, scales of degraded motors, and which of them do not work."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.drive.desi.clock import GEAR
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.arms import L_ALPHA
from fiberloom.twin.actuators.field_open import FieldMotor, lag_rad
from fiberloom.twin.actuators.planetary import SCATTER_DEG, PlanetaryGears, draw_gears
from fiberloom.typing import Flags, Floats

UP, DOWN = 0, 1
"""Directions of a motor's scale."""
LAG_DEG = float(np.rad2deg(lag_rad(FieldMotor(), np.zeros(1), 1.0)[0])) / GEAR
"""Of a rotor at rest behind its field, at the arm: 0.09 deg."""


@dataclass(frozen=True)
class DesiSizes:
    """What is drawn beside the gears. Shares of the units, and standard deviations."""

    stuck: float = 0.0
    linear_theta: float = 0.0
    linear_phi: float = 0.0
    """Degraded motors: their way is a scale times what was commanded, by direction."""
    idle: float = 0.16
    """[M] Of the moves of a degraded motor do nothing, and are reported as done."""
    dark: float = 0.0
    scatter_deg: float = SCATTER_DEG
    centre_um: float = 1.0
    """[M] Per coordinate: of the calibration that the layout holds."""
    length_um: float = 2.4
    """[M] Of either arm."""


PUBLISHED_FAULTS = DesiSizes(stuck=391 / 5020, linear_theta=295 / 4647, linear_phi=206 / 4647, dark=42 / 5020)
"""[M] Counts of the calibration of 2026-03-03."""
PERFECT_ARMS = DesiSizes(centre_um=0.0, length_um=0.0)


@dataclass(frozen=True, eq=False)
class DesiUnits:
    """N units; axis 0 is theta, 1 is phi."""

    arms: Floats
    """(N, 5) true arms: columns of FocalPlane.arms."""
    beta_longer_mm: Floats
    """(N,) by which the true fibre lies farther out than the layout says."""
    gears: PlanetaryGears
    scale: Floats
    """(N, 2, 2) way over what was commanded, a ratio, by axis and direction (UP, DOWN)."""
    stops_deg: Floats
    """(N, 2, 2) lowest and highest angle of each axis."""
    stuck: Flags
    """(N,) no motion, reported as done."""
    dark: Flags
    """(N,)."""
    sizes: DesiSizes

    def __len__(self) -> int:
        return len(self.arms)

    @property
    def linear(self) -> Flags:
        """(N, 2) degraded motors."""
        return np.asarray((self.scale != 1.0).any(axis=2))

    @property
    def healthy(self) -> Flags:
        """(N,) neither stuck, dark nor degraded."""
        return ~(self.stuck | self.dark | self.linear.any(axis=1))


def draw_desi_units(plane: FocalPlane, seed: int, sizes: DesiSizes | None = None) -> DesiUnits:
    """Units of a focal plane by a `seed`: `sizes` of what is wrong with them; by default none is broken.

    Offline positioners of the plane are stuck where it says.
    """
    sizes = sizes or DesiSizes()
    rng = np.random.default_rng([seed, 0xDE51])
    n = len(plane)
    arms = plane.arms.copy()
    arms[:, :2] += 1e-3 * sizes.centre_um * rng.standard_normal((n, 2))
    lengths = 1e-3 * sizes.length_um * rng.standard_normal((n, 2))
    arms[:, L_ALPHA] += lengths[:, 0]
    gears = draw_gears(n, rng, LAG_DEG)
    stuck = (rng.random(n) < sizes.stuck) | plane.offline
    dark = rng.random(n) < sizes.dark
    scale = _scales(n, rng, sizes)
    stops = plane.stops_of().copy()
    return DesiUnits(arms, lengths[:, 1], gears, scale, stops, stuck, dark, sizes)


def _scales(n: int, rng: np.random.Generator, sizes: DesiSizes) -> Floats:
    """(N, 2, 2): 1, or those of degraded motors.

    [M] phi 0.75 +- 0.095 within 0.49 to 1, both directions 0.05 apart; theta 0.75 times what it makes of
    commands scaled so, 0.8 in the median [A] +- 0.3.
    """
    out = np.ones((n, 2, 2))
    theta = 0.75 * np.clip(0.8 + 0.3 * rng.standard_normal(n), 0.0, 1.31)
    phi = np.clip(0.75 + 0.095 * rng.standard_normal(n), 0.49, 1.0)
    apart = 0.05 * rng.standard_normal((n, 2))
    for axis, (share, mean) in enumerate(((sizes.linear_theta, theta), (sizes.linear_phi, phi))):
        linear = rng.random(n) < share
        both = np.column_stack([mean, np.clip(mean + apart[:, axis], 0.0, 1.4)])
        out[linear, axis] = both[linear]
    return out
