"""Two-phase steppers of MEGARA, MOONS and LAMOST: where the arm is behind a count of microsteps.

The field stands at (pi / 2) k / mu after k microsteps; the rotor follows as in `field_open`. A way that asks
for more torque than the field has pulls the rotor out: it loses whole electrical turns, four full steps each,
and the count does not know. The next search of the datum does. Torques of all three motors are [A].
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fiberloom.errors import InputError
from fiberloom.twin.actuators.field_open import TURN_RAD, FieldMotor, keeps_up, rest_rad
from fiberloom.typing import Flags, Floats, Ints

FULL_STEPS = 4
"""Of an electrical turn."""
PM_STEPPER = FieldMotor(
    pole_pairs=5.0,
    hold_Nm=0.3e-3,
    friction_Nm=0.06e-3,
    damping_Nms=2e-8,
    inertia_kg_m2=8e-9,
    detent_Nm=0.03e-3,
)
"""[A] A permanent-magnet motor of 6 to 8 mm with 20 steps a turn."""


@dataclass(frozen=True, eq=False)
class GearedStepper:
    """Motors and gears of M axes."""

    motor: FieldMotor = PM_STEPPER
    microsteps: int = 1
    """Of a full step."""
    gear: float | Floats = 1000.0
    """Motor turns per output turn; one for all or (M,)."""
    corner_Hz: float = 1000.0
    """[A] f_e, full steps a second: back-EMF leaves T_h / sqrt(1 + (f / f_e)^2)."""

    def __post_init__(self) -> None:
        if self.microsteps < 1 or self.corner_Hz <= 0.0 or np.min(self.gear) <= 0.0:
            raise InputError(
                f"stepper: {self.microsteps} microsteps, gear {np.min(self.gear):g}, corner "
                f"{self.corner_Hz:g} Hz; the first must be 1 or more, the others above 0"
            )

    def field_rad(self, count: Ints | Floats) -> Floats:
        """Electrical angle of the field in rad after `count` microsteps, any shape."""
        out: Floats = 0.5 * np.pi * np.asarray(count, dtype=np.float64) / self.microsteps
        return out

    @property
    def turn_deg(self) -> Floats:
        """What one electrical turn is at the arm, deg, (M,) or one: the least that a pull-out loses."""
        return np.asarray(np.rad2deg(TURN_RAD / self.motor.pole_pairs) / self.gear)

    def output_deg(
        self, count: Ints | Floats, direction: Floats | float, load_Nm: Floats | float = 0.0
    ) -> Floats:
        """(M,) deg of the gear's output at rest after `count` (M,) microsteps.

        `direction` (M,): 1 or -1, from which the rotor came; `load_Nm` at the arm, against positive angles.
        With lag and detent; NaN where the field cannot hold the load.
        """
        shaft = rest_rad(self.motor, self.field_rad(count), direction, np.asarray(load_Nm) / self.gear)
        return np.asarray(np.rad2deg(shaft) / self.gear)

    def at_rate(self, rate_Hz: Floats | float) -> FieldMotor:
        """The motor at a rate in full steps per second: what back-EMF leaves of its torque."""
        weaker = np.sqrt(1.0 + (np.asarray(rate_Hz) / self.corner_Hz) ** 2)
        return replace(self.motor, hold_Nm=self.motor.hold_Nm / weaker)

    def pulled_out(
        self, rate_Hz: Floats, acceleration_Hz2: Floats | float = 0.0, load_Nm: Floats | float = 0.0
    ) -> Flags:
        """(M,) whether a way is too much for the field.

        `rate_Hz` and `acceleration_Hz2`: of it, in full steps per s and s2; `load_Nm` at the arm.
        """
        step_rad = TURN_RAD / (FULL_STEPS * np.asarray(self.motor.pole_pairs))
        motor = self.at_rate(rate_Hz)
        speed, acceleration = step_rad * np.asarray(rate_Hz), step_rad * np.asarray(acceleration_Hz2)
        return ~keeps_up(motor, speed, acceleration, np.asarray(load_Nm) / self.gear)


@dataclass(frozen=True, eq=False)
class DatumSwitches:
    """Home switches of M axes, at 0 of a true arm."""

    offset_deg: Floats
    """(M,) where each closes, in the mean."""
    repeat_deg: float
    """Standard deviation of where it closes at each search."""
    hysteresis_deg: float = 0.0
    """By which it opens later than it closes."""

    def closes_deg(self, rng: np.random.Generator) -> Floats:
        """(M,) deg of the arms at which they close in a search, drawn by `rng`."""
        return np.asarray(self.offset_deg + self.repeat_deg * rng.standard_normal(len(self.offset_deg)))

    def opens_deg(self, closed_deg: Floats, direction: float) -> Floats:
        """(M,) deg at which they open again, of those `closed_deg` (M,) by a search in a `direction`."""
        return np.asarray(closed_deg - np.sign(direction) * self.hysteresis_deg)


def lost_turns(drive: GearedStepper, slip_deg: Floats) -> Ints:
    """(M,) electrical turns that were lost, by what counts (M,) in deg were off at the datum.

    The nearest whole number: a switch that repeats to less than half a turn tells it exactly.
    """
    return np.rint(np.asarray(slip_deg) / drive.turn_deg).astype(np.int64)
