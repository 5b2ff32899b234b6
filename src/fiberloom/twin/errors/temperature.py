"""A night that is colder or warmer than the calibration was: from arms and plate to grease and lens.

Positions are told in the frame of the fiducials' table: mm of the plate as it was when the table was
measured. A plate that grows takes fiducials and centres of positioners along, so in that frame they stay
where they are. The camera's scale is fitted on the fiducials, and the telescope's guider takes the scale of
the sky against the plate. What is left in that frame is the growth of the arms against the plate. An
instrument says its own:

    [twin.errors.temperature]
    difference_K = 10.0         # of the night against the calibration, rms
    calibrated_C = 20.0         # at which tables and firmware parameters were found
    arm_per_K = 23e-6           # expansion of the arms: aluminium
    arm_scatter = 0.03          # unit to unit, a share of that
    plate_per_K = 12e-6         # expansion of the plate: steel
    plate_scatter_per_K = 3e-6  # array to array, of the two against each other
    grease_halves_K = 20.0      # so much warmer, and the viscous friction is half
    copper_per_K = 0.0039       # of the resistance of the coils
    magnet_per_K = -0.0015      # of flux linkage and hall amplitudes
    backlash_per_K = 0.002      # of the backlash
    sensor_K = 0.5              # of a positioner's thermometer, rms; it stays
    lens_um_per_K = 0.2         # of a smooth distortion, rms per coordinate

Assumed, all but aluminium, steel and copper (tables of materials). The difference: DESI's focal plane was
measured at 22 deg C and works at 11 (desihub/desimeter, issue 27). Grease twice as stiff in the cold is what
the firmware is made for (docs/firmware.md). NdFeB loses 0.11 % of its flux a kelvin, ferrite 0.2. Which plate
SDSS-V has, we do not know; one of aluminium (DESI's) leaves next to nothing of the arms' growth, one of invar
nearly all.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.instruments.arms import L_ALPHA
from fiberloom.twin.errors.switches import COLDEST_C, WARMEST_C
from fiberloom.twin.units import Units
from fiberloom.typing import Floats, Ints

_STREAM = 0x7E39
_FARTHEST = 2.5
"""In units of the rms: no night is farther from the calibration."""


@dataclass(frozen=True)
class NightTemperature:
    """How far the night is from the calibration, and what that does; see the module for origins."""

    difference_K: float = 10.0
    """Rms of what is drawn; 0: the night is as the calibration was."""
    calibrated_C: float = 20.0
    arm_per_K: float = 23e-6
    arm_scatter: float = 0.03
    plate_per_K: float = 12e-6
    plate_scatter_per_K: float = 3e-6
    grease_halves_K: float = 20.0
    copper_per_K: float = 0.0039
    magnet_per_K: float = -0.0015
    backlash_per_K: float = 0.002
    sensor_K: float = 0.5
    lens_um_per_K: float = 0.2
    at_C: float | None = None
    """Of this night, in place of what the seed draws."""

    @classmethod
    def of(cls, told: Mapping[str, Any], where: str) -> NightTemperature:
        """That of a table `told` in an instrument's file; `where`: its name there.

        InputError for a key that there is not, or what is no number or out of range.
        """
        known = [f.name for f in dataclasses.fields(cls) if f.name != "at_C"]
        for key, value in told.items():
            if key not in known:
                raise InputError(f"{where}.{key}: no such key; known are {', '.join(known)}")
            if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _MOST:
                raise InputError(f"{where}.{key} = {value!r}: must be a number, at most {_MOST:g}")
            if key in _NOT_NEGATIVE and value < 0.0:
                raise InputError(f"{where}.{key} = {value!r}: must be 0 or more")
        made = cls(**{key: float(value) for key, value in told.items()})
        if made.grease_halves_K <= 0.0:
            raise InputError(f"{where}.grease_halves_K = {made.grease_halves_K:g}: must be above 0")
        return made

    def switched(self, factor: float, at_C: float | None) -> NightTemperature:
        """With the difference times `factor`, a ratio (0: none), or the night `at_C`, deg C."""
        return dataclasses.replace(self, difference_K=self.difference_K * factor, at_C=at_C)

    @property
    def on(self) -> bool:
        """Whether a night can differ from the calibration."""
        return self.difference_K > 0.0 or self.at_C is not None

    def night_C(self, seed: int) -> float:
        """The temperature of the night, deg C: as told, else drawn by the `seed`."""
        if self.at_C is not None:
            return self.at_C
        drawn = float(np.random.default_rng([seed, _STREAM]).standard_normal())
        warmer_K = self.difference_K * min(max(drawn, -_FARTHEST), _FARTHEST)
        return min(max(self.calibrated_C + warmer_K, COLDEST_C), WARMEST_C)

    def warmer_K(self, seed: int) -> float:
        """The night less the calibration, K; negative: it is colder. Drawn by the `seed` unless told."""
        return self.night_C(seed) - self.calibrated_C if self.on else 0.0

    def arms_per_K(self, seed: int) -> float:
        """Growth of the arms against the plate, of the mean unit of an array that the `seed` draws."""
        drawn = float(np.random.default_rng([seed, _STREAM, 1]).standard_normal())
        return self.arm_per_K - self.plate_per_K + self.plate_scatter_per_K * drawn

    def growth(self, number: Ints, seed: int) -> Floats:
        """(N, 2) by which alpha and beta arms have grown against the plate, a ratio.

        `number`: (N,) of the units; `seed`: of array and night. A unit is the same in any company.
        """
        own = [np.random.default_rng([seed, int(n), _STREAM]).standard_normal(2) for n in number]
        scatter = self.arm_scatter * self.arm_per_K * np.array(own).reshape(-1, 2)
        growth: Floats = (self.arms_per_K(seed) + scatter) * self.warmer_K(seed)
        return growth

    def applied(self, units: Units, plane: FocalPlane) -> Units:
        """The units of a `plane` as they are in this night; what their firmware believes stays."""
        if not self.on:
            return units
        warmer_K = self.warmer_K(units.seed)
        growth = self.growth(units.number, units.seed)
        arms = units.arms.copy()
        arms[:, L_ALPHA] *= 1.0 + growth[:, 0]
        longer_mm = growth[:, 1] * (plane.points[METROLOGY][:, 0] + units.beta_longer_mm)
        offsets = {
            name: units.points_mm(mm, name) * (1.0 + growth[:, 1:])
            - mm - np.column_stack([units.beta_longer_mm + longer_mm, np.zeros(len(units))])
            for name, mm in plane.points.items()
        }  # fmt: skip
        return dataclasses.replace(
            units,
            arms=arms,
            plant=self._plant(units, warmer_K),
            gear=self._gear(units, warmer_K),
            beta_longer_mm=units.beta_longer_mm + longer_mm,
            fibre_offset_mm=offsets,
        )

    def _plant(self, units: Units, warmer_K: float) -> Any:
        plant = units.plant.copy()
        factors = {
            "viscous_motor": self.grease(warmer_K),
            "viscous_gear": self.grease(warmer_K),
            "coil_resistance": 1.0 + self.copper_per_K * warmer_K,
            "flux_linkage": 1.0 + self.magnet_per_K * warmer_K,
            "hall_amplitude_a": 1.0 + self.magnet_per_K * warmer_K,
            "hall_amplitude_b": 1.0 + self.magnet_per_K * warmer_K,
        }
        for name, factor in factors.items():
            plant[name] *= factor
        return plant

    def _gear(self, units: Units, warmer_K: float) -> Any:
        gear = units.gear.copy()
        for name in ("backlash_rad", "backlash_mean_rad"):
            gear[name] *= 1.0 + self.backlash_per_K * warmer_K
        return gear

    def grease(self, warmer_K: float) -> float:
        """Viscous friction over that of the calibration, where it is so much warmer; a ratio."""
        return float(2.0 ** (-warmer_K / self.grease_halves_K))

    def plate_growth(self, seed: int) -> float:
        """By which the plate has grown in the night of this `seed`, a ratio: the camera alone sees it."""
        return self.plate_per_K * self.warmer_K(seed)

    def sensor_counts(self, plane: FocalPlane, seed: int) -> Ints | None:
        """(N,) what the positioners' thermometers read, by the scale of the instrument's `[care]`.

        `plane`: of the positioners; `seed`: of the night. None where there is no scale, or the night is as
        the calibration was.
        """
        care = plane.instrument.care
        if not self.on or not care.temperature_C_per_count:
            return None
        own_K = [
            np.random.default_rng([seed, int(n), _STREAM, 2]).standard_normal() for n in plane.positioner_id
        ]
        at_C = self.night_C(seed) + self.sensor_K * np.array(own_K)
        counts = (at_C - care.temperature_zero_C) / care.temperature_C_per_count
        return np.maximum(np.rint(counts), 0.0).astype(np.int64)

    def told(self) -> str:
        """For `put_in`: sizes, and their source."""
        if not self.on:
            return "as at the calibration"
        night = f"{self.difference_K:g} K rms" if self.at_C is None else f"{self.at_C:g} deg C"
        parts = [
            f"{night} against {self.calibrated_C:g} deg C at the calibration",
            f"arms {1e6 * self.arm_per_K:g}e-6 a kelvin within {100 * self.arm_scatter:g} %",
            f"plate {1e6 * self.plate_per_K:g}e-6, the two within {1e6 * self.plate_scatter_per_K:g}e-6",
            f"grease half as stiff {self.grease_halves_K:g} K warmer",
            f"coils {100 * self.copper_per_K:+g} %, magnets {100 * self.magnet_per_K:+g} %",
            f"backlash {100 * self.backlash_per_K:+g} %, lens {self.lens_um_per_K:g} um a kelvin (assumed)",
        ]
        return "; ".join(parts)


NO_DIFFERENCE = NightTemperature(difference_K=0.0)
"""A night as the calibration was."""
_MOST = 1000.0
_NOT_NEGATIVE = frozenset(
    ("difference_K", "arm_scatter", "plate_scatter_per_K", "sensor_K", "lens_um_per_K", "grease_halves_K")
)
