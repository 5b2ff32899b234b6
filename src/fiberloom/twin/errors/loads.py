"""What pulls at the arms of a twin: gravity, and the bundle of fibres that is turned with them.

Gravity turns an axis by (moment x gravity) / stiffness. The moment is mass times the place of its centre;
the stiffness is that of the unit's gear (Kronig 2020, Fig. 13: 0.337 and 0.025 Nm/deg). The bundle of
fibres pulls like a spring, and by its friction a little back after each turn.

`[twin.errors]` of an instrument says its own sizes; all are ASSUMED, nothing is published:

    [twin.errors]
    moment_g_mm = [148.0, 12.0]          # 20 g at the elbow, 7.4 mm from alpha; 1.5 g at 8 mm from beta
    torque_mNm_rad = [0.1, 0.01]         # a tenth of the springs against backlash
    torque_friction_mNm = [0.05, 0.01]

The springs against backlash hold the flanks against both. At the end of the range of alpha 1.8 mNm are
left of them in the zenith, 0.7 at a zenith distance of 45 deg, 0.5 at 60 deg (median; `spring_left_Nm`).
At 45 deg one alpha of 12000 lacks a little, at 60 deg one in 90, at the horizon one in eight. The plant's
gear then stays where it is by its friction (19 mNm at the output, beta a tenth), since it is not
back-drivable: this twin has no arm that falls through its backlash.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments.pointing import Pointing
from fiberloom.typing import Floats, Records
from fiberloom.units import RAD_PER_DEG

_COLUMNS = ("moment_x", "moment_y", "fibre_rate", "fibre_free", "fibre_friction", "fibre_slip")
LOAD_DTYPE = np.dtype([(name, np.float64) for name in _COLUMNS])
"""Of one axis, as in core/twin: kg m, Nm/rad, rad, Nm, rad."""
LOADING = [_COLUMNS.index(name) for name in ("moment_x", "moment_y", "fibre_rate", "fibre_friction")]
"""Columns of those that pull."""

MOMENT_SD = 0.1
"""Of a unit's moment along its arm and across, over the moment: assumed."""
FIBRE_SD = 0.2
"""Of slope and friction of a unit's bundle, relative: assumed."""
FREE_DEG = ((180.0, 20.0), (90.0, 10.0))
"""By axis, where a bundle does not pull, mean and rms from unit to unit: assumed, the middle of the range."""
SLIP_DEG = 2.0
"""Turn after which a bundle pulls back by all of its friction: assumed; an approach is 0.8 deg."""
_STREAM = 0xE222
_KG_M_PER_G_MM = 1e-6
_NM_PER_MNM = 1e-3
_MOST = 1e4


@dataclass(frozen=True)
class LoadSizes:
    """Of alpha and of beta."""

    moment_g_mm: tuple[float, float] = (148.0, 12.0)
    """Mass times distance of its centre from the axis, along the arm."""
    torque_mNm_rad: tuple[float, float] = (0.1, 0.01)
    """Of the bundle of fibres, by the angle turned."""
    torque_friction_mNm: tuple[float, float] = (0.05, 0.01)
    """Of the bundle of fibres: half of its hysteresis."""

    def times(self, gravity: float, torque: float) -> LoadSizes:
        """With factors on gravity's moments, and on the pull of the bundle."""
        return LoadSizes(
            _times(self.moment_g_mm, gravity),
            _times(self.torque_mNm_rad, torque),
            _times(self.torque_friction_mNm, torque),
        )

    def any(self) -> bool:
        """Whether anything pulls."""
        return any((*self.moment_g_mm, *self.torque_mNm_rad, *self.torque_friction_mNm))

    def drawn_of(self, number: int, seed: int) -> Records:
        """(2,) LOAD_DTYPE of the unit `number`, by the `seed` and its number alone."""
        rng = np.random.default_rng([seed, number, _STREAM])
        load = np.zeros(2, LOAD_DTYPE)
        for axis in (0, 1):
            along, across, rate, friction, free = np.clip(rng.standard_normal(5), -3.0, 3.0)
            moment = self.moment_g_mm[axis] * _KG_M_PER_G_MM
            free_deg, sd_deg = FREE_DEG[axis]
            load[axis] = (
                moment * (1.0 + MOMENT_SD * along),
                moment * MOMENT_SD * across,
                self.torque_mNm_rad[axis] * _NM_PER_MNM * (1.0 + FIBRE_SD * rate),
                (free_deg + sd_deg * free) * RAD_PER_DEG,
                self.torque_friction_mNm[axis] * _NM_PER_MNM * (1.0 + FIBRE_SD * friction),
                SLIP_DEG * RAD_PER_DEG,
            )
        return load

    def told(self) -> dict[str, str]:
        """For `put_in`: each size, and that it is assumed."""
        moment, rate, friction = self.moment_g_mm, self.torque_mNm_rad, self.torque_friction_mNm
        return {
            "gravity": f"{moment[0]:g} / {moment[1]:g} g mm (alpha / beta) on gears of 337 / 25 mNm/deg "
            f"(Fig. 13), unit to unit {100 * MOMENT_SD:g} % along and across (assumed); none in the zenith",
            "bundle of fibres": f"{rate[0]:g} / {rate[1]:g} mNm/rad, friction {friction[0]:g} / "
            f"{friction[1]:g} mNm, unit to unit {100 * FIBRE_SD:g} % (assumed)",
        }


LOAD_KEYS = tuple(one.name for one in fields(LoadSizes))
"""Of `[twin.errors]`."""
NO_LOADS = LoadSizes((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
"""Nothing pulls."""


def told_loads(asked: Mapping[str, object], where: str) -> LoadSizes:
    """What `[twin.errors]` says of them, `asked`; `where`: of that table, for errors."""
    usual = LoadSizes()
    return LoadSizes(*(_pair(asked.get(key, getattr(usual, key)), f"{where}.{key}") for key in LOAD_KEYS))


def spring_left_Nm(plant: Records, load: Records, axis: int, zenith_deg: float) -> Floats:
    """(M,) what is left at least of the springs that hold the flanks of an `axis`, with gravity against them.

    `plant` and `load`: of M units and both axes, (M, 2); `zenith_deg`: of the telescope. Over the whole turn,
    whatever the rotator; beta's moment pulls at alpha too.
    """
    gravity = Pointing(zenith_deg).gravity_m_s2()
    own, pull = plant[:, axis], load[:, axis]
    ends = np.stack([own["stop_min"], own["stop_max"]])
    spring = own["spring_rate"] * (own["spring_free"] - ends)
    bundle = -pull["fibre_rate"] * (ends - pull["fibre_free"]) - pull["fibre_friction"]
    carried = [load[:, other] for other in range(axis, 2)]
    moment = sum(np.hypot(one["moment_x"], one["moment_y"]) for one in carried)
    left: Floats = (spring + bundle).min(axis=0) - moment * np.hypot(*gravity)
    return left


def _pair(value: object, where: str) -> tuple[float, float]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise InputError(f"{where} = {value!r}: must be two numbers")
    for one in value:
        if isinstance(one, bool) or not isinstance(one, int | float) or not 0.0 <= one <= _MOST:
            raise InputError(f"{where} = {value!r}: must be two numbers, 0 to {_MOST:g}")
    return float(value[0]), float(value[1])


def _times(pair: tuple[float, float], factor: float) -> tuple[float, float]:
    return pair[0] * factor, pair[1] * factor
