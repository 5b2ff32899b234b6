"""Sets of motor parameters: the paper's, which is the default, and motors that catalogues sell.

Kronig 2020, Fig. 14 fixes ratios only: drag over inertia, torque over inertia. All torques of alpha may be
4.7 times larger, with the rotor of a 12 mm motor, and the firmware sees no difference; and no catalogue has
the paper's coil of 319 Ohm (213 between two terminals). A catalogue winding of the same torque needs 3 to 4
V. Which set is right cannot be settled, so an instrument chooses: `[twin.alpha] motor = "NAME"`.

Coil and flux follow from a data sheet's resistance between two terminals R_t and torque constant k_M as R =
1.5 R_t (delta), lambda = k_M; K_M^2 = 1.5 lambda^2/R is torque squared per copper watt and the drag of the
back-EMF in one. Assumed in every set but the paper's: the supply, how friction is shared between rotor and
gear (as in the paper's set), and where nothing else is said cogging and spring.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from fiberloom.errors import InputError
from fiberloom.typing import Records
from fiberloom.units import AXES

INERTIAS = ("inertia_motor", "inertia_gear")
VISCOUS = ("viscous_motor", "viscous_gear")
TORQUES = ("coulomb_motor", "coulomb_gear", "cogging_2", "cogging_4", "spring_rate")


@dataclass(frozen=True)
class MotorSet:
    """One motor: how the paper's parameters of its axes change."""

    axes: tuple[str, ...]
    """Those that it is made for."""
    source: str
    times: dict[str, float] = field(default_factory=dict)
    """Factors on the paper's nominal values of the axis."""
    values: dict[str, float] = field(default_factory=dict)
    """Values in their place: Wb, Ohm, V."""


def _times(inertia: float = 1.0, viscous: float = 1.0, torques: float = 1.0) -> dict[str, float]:
    return {
        **dict.fromkeys(INERTIAS, inertia),
        **dict.fromkeys(VISCOUS, viscous),
        **dict.fromkeys(TORQUES, torques),
    }


PAPER = "paper"
MOTOR_SETS: dict[str, MotorSet] = {
    PAPER: MotorSet(
        AXES,
        "Kronig 2020, Fig. 11 to 14: ratios printed, torques derived; 12 V. Beta's a tenth (assumed)",
    ),
    "10mm": MotorSet(
        ("alpha",),
        "Orbray BMS10-1008 (10 mm flat, 0.03 g cm^2, K_M^2 0.25 uNm s): 8.2 Ohm, 1.42 mNm/A; drag and "
        "inertia the paper's, viscous friction the rest of it; 3.5 V assumed",
        _times(viscous=0.55 / 0.30),
        {"flux_linkage": 1.42e-3, "coil_resistance": 12.3, "supply": 3.5},
    ),
    "13mm": MotorSet(
        ("alpha",),
        "maxon EC 13 (0.165 g cm^2, K_M^2 2.86 uNm s): 5.74 Ohm, 4.05 mNm/A; drag over inertia the paper's, "
        "friction, cogging and spring 4.7 times; 4 V assumed",
        _times(inertia=16.5 / 3.5, viscous=0.91 / 0.30, torques=4.7),
        {"flux_linkage": 4.05e-3, "coil_resistance": 8.6, "supply": 4.0},
    ),
    "6mm": MotorSet(
        ("beta",),
        "between maxon EC 4 and Orbray BMS10 by power laws (J as d^3.6, K_M^2 as d^1.1): 0.004 g cm^2, K_M^2 "
        "0.13 uNm s; friction, cogging and spring the paper's; 1.5 V assumed, a limit of u_cmd at 3 to 4 V",
        _times(inertia=4.0 / 3.5),
        {"flux_linkage": 1.5e-3, "coil_resistance": 26.0, "supply": 1.5},
    ),
}
"""By the name that an instrument's `[twin.alpha]` or `[twin.beta]` table may give as `motor`."""


def with_motor(paper: Records, axis: int, name: object, where: str) -> Records:
    """The nominal plant of an axis with another motor.

    `paper`: a record of PLANT_DTYPE (SI) of the paper's set, not changed; `axis` 0 alpha, 1 beta; `name` of
    the set; `where`: the table that asks, for the message. InputError where the axis has no such set.
    """
    known = [key for key, motor in MOTOR_SETS.items() if AXES[axis] in motor.axes]
    if name not in known:
        raise InputError(
            f'{where}.motor = "{name}": {AXES[axis]} has the sets {", ".join(known)}; see docs/twin.md'
        )
    motor = MOTOR_SETS[str(name)]
    record = paper.copy()
    for key, factor in motor.times.items():
        record[key] *= factor
    for key, value in motor.values.items():
        record[key] = value
    return record
