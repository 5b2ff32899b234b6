"""The true units of an array of steppers: arms, switches, gears, motors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import ValidationError

from fiberloom.drive.steppers.steps import AxisSteps
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, Instrument
from fiberloom.instruments.arms import L_ALPHA
from fiberloom.instruments.table import NotNegative, Positive, Table
from fiberloom.twin.actuators.stepper import FULL_STEPS, DatumSwitches, GearedStepper
from fiberloom.typing import Floats

ORDERS = np.array([1.0, 2.0, 3.0])
"""[A] Of the gear's error, cycles a turn of the arm."""


class StepperSizes(Table):
    """`[twin.steppers]` of an instrument: what is drawn for its units."""

    body_radius_mm: Positive
    """Of the real beta arm; the collision buffer has a margin besides."""
    centre_um: NotNegative = 0.0
    """By which a centre is off the layout, per coordinate."""
    length_um: NotNegative = 0.0
    """By which either arm is."""
    switch_deg: NotNegative = 0.0
    """By which a datum switch closes off the home of the layout."""
    repeat_deg: NotNegative = 0.0
    """By which it closes elsewhere from search to search."""
    gear_deg: NotNegative = 0.0
    """Amplitude of the gear's error at each of its orders, in the mean."""
    play_deg: NotNegative = 0.0
    """Of the gear, at the arm."""
    spring: bool = False
    """A spring takes the play away."""

    @classmethod
    def of(cls, instrument: Instrument) -> StepperSizes:
        """Those of an instrument; InputError with the key that is wrong."""
        found = instrument.twin.get("steppers")
        if found is None:
            raise InputError(f"{instrument.name}: the twin needs a [twin.steppers] table")
        try:
            return cls.model_validate(found)
        except ValidationError as wrong:
            first = wrong.errors()[0]
            key = ".".join(map(str, first["loc"]))
            raise InputError(f"{instrument.name}: twin.steppers.{key}: {first['msg']}") from None


@dataclass(frozen=True, eq=False)
class StepperUnits:
    """N units; columns are alpha and beta."""

    steps: AxisSteps
    arms: Floats
    """(N, 5) true arms: columns of FocalPlane.arms."""
    beta_longer_mm: Floats
    """(N,) by which the true fibre lies farther out than the layout says."""
    switches: tuple[DatumSwitches, DatumSwitches]
    """Of alpha and beta, about home."""
    gear_deg: Floats
    """(N, 2, orders) amplitudes."""
    gear_rad: Floats
    """(N, 2, orders) phases."""
    play_deg: Floats
    """(N, 2)."""
    drives: tuple[GearedStepper, GearedStepper]
    sizes: StepperSizes

    def __len__(self) -> int:
        return len(self.arms)

    def output_deg(self, counts: Floats, rising: Floats, datum_deg: Floats, at_rest: bool = True) -> Floats:
        """(..., N, 2) true angles in deg of rotors in step with `counts` (..., N, 2).

        `rising` (..., N, 2): 1 or -1, how angles changed last; `datum_deg` (N, 2): where the switches closed;
        `at_rest`: with the lag of the rotor, some 0.001 deg, which no contact depends on.
        """
        plain = self.steps.sign * counts * self.steps.step_deg
        turned = self._shaft_deg(counts, rising) if at_rest else plain
        waves = np.deg2rad(turned)[..., None] * ORDERS + self.gear_rad
        gear = (self.gear_deg * (np.sin(waves) - np.sin(self.gear_rad))).sum(axis=-1)
        out: Floats = self.steps.home_deg + datum_deg + turned + gear - 0.5 * self.play_deg * rising
        return out

    def _shaft_deg(self, counts: Floats, rising: Floats) -> Floats:
        """(..., N, 2) deg at the arm from the datum: with lag and detent, at rest."""
        sign = self.steps.sign
        both = [
            drive.output_deg(counts[..., axis], sign * rising[..., axis])
            for axis, drive in enumerate(self.drives)
        ]
        return sign * np.stack(both, axis=-1)

    @property
    def turn_steps(self) -> int:
        """Counts of an electrical turn: the least that a pull-out loses."""
        return FULL_STEPS * self.drives[0].microsteps


def draw_stepper_units(plane: FocalPlane, seed: int) -> StepperUnits:
    """Units of a focal plane by a `seed`, with sizes as `[twin.steppers]` of its instrument says."""
    sizes, n = StepperSizes.of(plane.instrument), len(plane)
    steps, rng = AxisSteps.of(plane.instrument), np.random.default_rng([seed, 0x57E9])
    arms = plane.arms.copy()
    arms[:, :2] += 1e-3 * sizes.centre_um * rng.standard_normal((n, 2))
    lengths = 1e-3 * sizes.length_um * rng.standard_normal((n, 2))
    arms[:, L_ALPHA] += lengths[:, 0]
    switch = sizes.switch_deg * rng.standard_normal((n, 2))
    shape = (n, 2, len(ORDERS))
    amplitude = sizes.gear_deg * (1.0 + 0.3 * rng.standard_normal(shape))
    play = np.zeros((n, 2)) if sizes.spring else sizes.play_deg * rng.uniform(0.5, 1.5, (n, 2))
    full_deg = 360.0 / 20.0  # a full step of the motor of the twin
    drives = tuple(GearedStepper(gear=full_deg / step) for step in steps.step_deg)
    return StepperUnits(
        steps,
        arms,
        lengths[:, 1],
        (DatumSwitches(switch[:, 0], sizes.repeat_deg), DatumSwitches(switch[:, 1], sizes.repeat_deg)),
        amplitude,
        rng.uniform(0.0, 2.0 * np.pi, shape),
        play,
        (drives[0], drives[1]),
        sizes,
    )
