"""Wear: what a unit is after so many cycles of a lifetime test. Kronig 2020, Section 4.3.

One model for the full physics and for the statistical twin, because wear changes `Units` and nothing
else: marks on the transmission that develop, arm lengths that wander, friction that grows. All of
it depends on (seed, number of the unit) alone, and at any cycle it is known without those before.

TUNED: heights of the marks, so that the largest change of beta's delta among four units after 100
cycles is 0.15 deg (Fig. 22). Given: arm lengths within about 1 um (Fig. 21). Assumed: number, widths,
beginning and growth of the marks, the pace at which lengths wander, the growth of friction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.instruments.arms import L_ALPHA
from fiberloom.twin.units import MARKS, Units
from fiberloom.typing import Floats
from fiberloom.units import MM_PER_UM, RAD_PER_DEG

TOOTH_MARK = MARKS - 1
"""The last mark of a gear is kept for a broken tooth (`fiberloom.twin.faults.ailments`)."""
_WAVES = 3
_WORN_FRICTION = ("coulomb_gear", "viscous_gear")
_TARGETS_DEG = (360.0, 180.0)
"""Marks lie where targets are: anywhere on alpha, on beta between stretched and folded."""


@dataclass(frozen=True)
class WearModel:
    """Sizes of wear. A cycle is the paper's: 15260 moves."""

    mark_rms_deg: float = 0.08
    """Height of a mark that is fully grown, cut at twice as much. TUNED."""
    change_limit_deg: float = 0.16
    """All marks of an axis together change delta by no more, ever: up to 0.147 deg in 100 cycles. TUNED."""
    width_deg: tuple[float, float] = (6.0, 30.0)
    onset_cycles: float = 30.0
    """Marks begin at any cycle up to this one,"""
    grow_cycles: float = 40.0
    """and grow towards their height with this time constant."""
    arm_um: float = 1.0
    """Lengths stay within this of where they began."""
    arm_period_cycles: tuple[float, float] = (15.0, 90.0)
    friction_growth: tuple[float, float] = (0.0, 0.3)
    """Share by which the friction of a gear grows in 100 cycles, from unit to unit."""


class Wear:
    """The lives of some units: `at(cycles)` gives them as they are then.

    `cycles` may be a fraction, and one number or one for each unit.
    """

    def __init__(self, units: Units, seed: int = 0, model: WearModel | None = None) -> None:
        self.units, self.model = units, model or WearModel()
        draws = [self._draw(np.random.default_rng([seed, 0x3EA2, int(i)])) for i in units.number]
        empty = (np.empty((0, 2, TOOTH_MARK, 4)), np.empty((0, 2, _WAVES, 2)), np.empty((0, 2)))
        columns = [np.stack(c) for c in zip(*draws, strict=True)] if draws else list(empty)
        self._marks: Floats = columns[0]
        self._waves: Floats = columns[1]
        self._friction: Floats = columns[2]

    def at(self, cycles: ArrayLike) -> Units:
        """The units after `cycles` (one, or (N,)) cycles; before the first they are new."""
        age = np.broadcast_to(np.maximum(np.asarray(cycles, dtype=np.float64), 0.0), (len(self.units),))
        gear, arms = self.units.gear.copy(), self.units.arms.copy()
        gear["wear"][:, :, :TOOTH_MARK] = self._grown(age)
        longer_mm = self._wandered_mm(age)
        arms[:, L_ALPHA] += longer_mm[:, 0]
        plant = self.units.plant.copy()
        for name in _WORN_FRICTION:
            plant[name] *= 1.0 + self._friction * age[:, None] / 100.0
        shift = self.units.beta_longer_mm + longer_mm[:, 1]
        return replace(self.units, plant=plant, gear=gear, arms=arms, beta_longer_mm=shift)

    def _draw(self, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
        """Marks (2, 7, 4), waves of the lengths (2, 3, 2) and growth of friction (2,) of one unit."""
        m = self.model
        marks = np.stack([self._draw_marks(rng, turn) for turn in _TARGETS_DEG])
        period = rng.uniform(*m.arm_period_cycles, (2, _WAVES))
        phase = rng.uniform(0.0, 2.0 * np.pi, (2, _WAVES))
        return marks, np.stack([period, phase], axis=-1), rng.uniform(*m.friction_growth, 2)

    def _draw_marks(self, rng: np.random.Generator, turn_deg: float) -> Floats:
        """(7, 4): centre, width, height in deg, cycle at which it begins."""
        m, n = self.model, TOOTH_MARK
        height = np.clip(rng.normal(0.0, m.mark_rms_deg, n), -2.0 * m.mark_rms_deg, 2.0 * m.mark_rms_deg)
        marks = np.column_stack(
            [
                rng.uniform(0.0, turn_deg, n),
                rng.uniform(*m.width_deg, n),
                height,
                rng.uniform(0.0, m.onset_cycles, n),
            ]
        )
        theta = np.linspace(0.0, turn_deg, 721)
        most = np.abs(marks_deg(marks[:, :3], theta)).max()
        marks[:, 2] *= min(1.0, m.change_limit_deg / most) if most else 1.0
        return marks

    def _grown(self, age: Floats) -> Floats:
        """(N, 2, 7, 3) centre, width and height of the marks now, rad."""
        since = np.maximum(age[:, None, None] - self._marks[..., 3], 0.0)
        marks = self._marks[..., :3] * RAD_PER_DEG
        marks[..., 2] *= -np.expm1(-since / self.model.grow_cycles)
        return marks

    def _wandered_mm(self, age: Floats) -> Floats:
        """(N, 2) mm by which alpha and beta arm are longer than when new: bounded by `arm_um`."""
        period, phase = self._waves[..., 0], self._waves[..., 1]
        turn = 2.0 * np.pi * age[:, None, None] / period + phase
        longer: Floats = self.model.arm_um * MM_PER_UM * np.mean(np.sin(turn) - np.sin(phase), axis=-1) / 2.0
        return longer


def marks_deg(marks: Floats, theta_deg: Floats) -> Floats:
    """Sum of marks (M, 3: centre, width, height, all in deg) at angles: raised cosines, as the gear has
    them.
    """
    off = np.abs(theta_deg - marks[:, :1])
    shape = 0.5 * (1.0 + np.cos(2.0 * np.pi * off / marks[:, 1:2]))
    total: Floats = np.sum(np.where(off < 0.5 * marks[:, 1:2], marks[:, 2:3] * shape, 0.0), axis=0)
    return total


def worn(units: Units, cycles: ArrayLike, seed: int = 0, model: WearModel | None = None) -> Units:
    """The same `units` after so many lifetime `cycles` (one, or (N,)). `Twin.set_units` puts them into a
    running twin.

    `seed` draws the wear, `model` gives its sizes, defaults when None.
    """
    return Wear(units, seed, model).at(cycles)
