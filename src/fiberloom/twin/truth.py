"""What a twin's units really are, by the names that identifications give: for reports and tests."""

from __future__ import annotations

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.instruments.arms import CENTRE, L_ALPHA
from fiberloom.instruments.model import AXES
from fiberloom.twin.draw import firmware_truth
from fiberloom.twin.units import Units
from fiberloom.typing import Floats
from fiberloom.units import GEAR, RAD_PER_DEG

SEAT_BETWEEN_NODES = (1.0 - (1.0 - 0.7788) / 3.0) ** 0.5
"""The plant draws seats at nodes whose neighbours go together by 0.7788 (plant.cpp) and is straight in
between, where the scatter is smaller: 0.94 to 1, this on average."""


def true_values(plane: FocalPlane, units: Units) -> dict[str, Floats]:
    """(N,) true values by the names of Estimates, in their units (mm, uNm, mNm/deg, mdeg, rad, kg m^2)."""
    out = {
        "centre x": units.arms[:, CENTRE][:, 0],
        "centre y": units.arms[:, CENTRE][:, 1],
        "l_alpha": units.arms[:, L_ALPHA],
        "l_beta": plane.l_beta_mm,
    }
    for axis, name in enumerate(AXES):
        out |= {f"{name} {key}": value for key, value in _axis(units, axis).items()}
    return out


def _split(units: Units, axis: int, told: dict[str, Floats]) -> dict[str, Floats]:
    """What the drag is made of, and the ratios to the inertia that coasting tells."""
    plant = units.plant[:, axis]
    viscous = np.asarray(plant["viscous_motor"] + plant["viscous_gear"], dtype=np.float64)
    back_emf = told["drag"] - viscous
    return {
        "back-EMF drag": back_emf * 1e6,
        "viscous friction": viscous * 1e6,
        "back-EMF drag over inertia": back_emf / told["inertia"],
        "viscous friction over inertia": viscous / told["inertia"],
        "Coulomb friction over inertia": told["coulomb"] / told["inertia"],
    }


def _axis(units: Units, axis: int) -> dict[str, Floats]:
    rows = [firmware_truth(plant) for plant in units.plant[:, axis]]
    told = {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}
    return {
        "torque at full voltage": told["torque_per_volt"] * told["u_dc"] * 1e6,
        "Coulomb friction": told["coulomb"] * 1e6,
        # Eq. 11's sign: what the motor needs, not what the spring gives
        "spring at 0 deg": -told["spring_torque"] * 1e6,
        "spring rate": -told["spring_rate"] * 1e6 * GEAR * RAD_PER_DEG,
        "cogging": told["cogging_torque"] * 1e6,
        "cogging phase": told["cogging_phase"],
        "drag": told["drag"] * 1e6,
        **_split(units, axis, told),
        "inertia": told["inertia"],
        "stiffness": units.plant["stiffness"][:, axis] * 1e3 * RAD_PER_DEG,
        # of the gear: hall noise and control add a few nm
        "angular repeatability": np.rad2deg(SEAT_BETWEEN_NODES * units.plant["seat_rms"][:, axis]) * 1e3,
    }
