"""Current, power and heat of a motor: what its coils turn into heat, and what the supply gives.

Kronig 2020, Eq. 14 to 17, without inductance (L/R of catalogue windings is 4 to 40 us, a tick 500): each coil
of the delta carries i = (u - e)/R, with the EMF e = lambda omega cos(theta) and cyclic. So

    supply sum(u i) = copper sum(R i^2) + sum(e i),    sum(e i) = T_em omega.

The bridge is ideal: no switching losses, no ripple of the PWM, nothing for electronics; and closed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.twin.twin import SCOPE_DTYPE
from fiberloom.typing import Floats, Records
from fiberloom.units import TICK_S

_THIRD = 2.0 * np.pi / 3.0


@dataclass(frozen=True, eq=False)
class MotorPower:
    """Of one motor over M equal stretches of time."""

    copper_W: Floats
    """(M,) heat in the coils."""
    supply_W: Floats
    """(M,) from the supply; negative where the motor feeds back."""
    shaft_W: Floats
    """(M,) to the rotor: T_em omega."""
    supply_V: float
    period_s: float

    @property
    def copper_J(self) -> float:
        """Heat in all, J."""
        return float(self.copper_W.sum()) * self.period_s

    @property
    def supply_J(self) -> float:
        """From the supply in all, J."""
        return float(self.supply_W.sum()) * self.period_s

    @property
    def current_A(self) -> tuple[float, float]:
        """Of the supply: mean and peak, A."""
        return float(self.supply_W.mean()) / self.supply_V, float(self.supply_W.max()) / self.supply_V


def power_of_scope(scope: Records, plant: Records) -> MotorPower:
    """Of what one axis of the twin did, tick by tick.

    `scope`: M + 1 samples of SCOPE_DTYPE, one tick apart; `plant`: its record of PLANT_DTYPE (SI). The rotor
    is taken where it is in the middle of a tick, at the mean speed of it.
    """
    assert scope.dtype == SCOPE_DTYPE
    turned = np.diff(scope["motor_rad"])
    angle_rad = scope["motor_rad"][:-1] + 0.5 * turned
    duty = np.stack([scope[f"duty_{k}"][1:] for k in "abc"], axis=-1)
    return power_of_duties(duty, angle_rad, turned / TICK_S, plant)


def power_of_duties(duty: Floats, angle_rad: Floats, speed_rad_s: Floats, plant: Records) -> MotorPower:
    """Of any commutation: closed loop, open loop, shorted.

    `duty` (M, 3) of the phases, shares of the supply; `angle_rad` (M,) and `speed_rad_s` (M,) of the rotor;
    `plant`: its record of PLANT_DTYPE (SI).
    """
    coil_V = (np.roll(duty, -1, axis=-1) - duty) * float(plant["supply"])  # u_AB = u_B - u_A and cyclic
    shift = np.array([0.0, _THIRD, 2.0 * _THIRD])
    emf_V = float(plant["flux_linkage"]) * speed_rad_s[:, None] * np.cos(angle_rad[:, None] + shift)
    coil_A = (coil_V - emf_V) / float(plant["coil_resistance"])
    return MotorPower(
        float(plant["coil_resistance"]) * (coil_A**2).sum(axis=-1),
        (coil_V * coil_A).sum(axis=-1),
        (emf_V * coil_A).sum(axis=-1),
        float(plant["supply"]),
        TICK_S,
    )


def power_of_torque(torque_Nm: Floats, speed_rad_s: Floats, plant: Records, period_s: float) -> MotorPower:
    """Of a plan in closed loop, where the field leads by 90 degrees: P = T^2/K_M^2, and T omega beside it.

    `torque_Nm` (M,) of the motor, its back-EMF already off (friction, spring, inertia); `speed_rad_s` (M,);
    `plant`: a record of PLANT_DTYPE (SI); `period_s`: of each of the M.
    """
    k_M2 = 1.5 * float(plant["flux_linkage"]) ** 2 / float(plant["coil_resistance"])
    copper, shaft = torque_Nm**2 / k_M2, torque_Nm * speed_rad_s
    return MotorPower(copper, copper + shaft, shaft, float(plant["supply"]), period_s)
