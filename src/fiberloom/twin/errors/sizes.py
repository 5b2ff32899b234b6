"""Sizes of what a real array has wrong that a twin need not have; each can be switched off or made larger.

`[twin.errors]` of an instrument says its own; without one they are those of SDSS-V, measured between two
calibrations of the same robots in the same holes (sdss/fps_calibrations, apo, 2024-04-01 and 2025-12-04,
461 units: `python -m benchmarks.tables`):

    [twin.errors]
    arm_um = [10.9, 13.3]                              # alpha arm; metrology fibre on the beta arm
    fibre_um = { BOSS = [9.0, 8.3], APOGEE = [16.1, 5.1] }  # science fibre against it: along, across the arm
    fiducial_um = 8.0                                  # of the fiducials' table, per coordinate
    air_um = 1.5                                       # turbulence before the camera, per coordinate
    power_share = 0.05                                 # positioners off by motor turns after power-up
    power_turns = 5                                    # at most so many

The air is assumed: DESI's camera sees 3 to 8 um through 12 m of it (Silber et al. 2023, AJ 165, 9); of
SDSS-V's, which is nearer, nothing is published. What pulls at the arms: `fiberloom.twin.errors.loads`; what a
colder night does: `fiberloom.twin.errors.temperature`; how a telescope points off:
`fiberloom.twin.errors.pointing`.
Share and number of motor turns are assumed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments import METROLOGY, FocalPlane, Instrument
from fiberloom.twin.errors.loads import LOAD_KEYS, NO_LOADS, LoadSizes, told_loads
from fiberloom.twin.errors.pointing import NO_POINTING, PointingSizes
from fiberloom.twin.errors.switches import GearSpectrum, factors_of, gears_of, night_C_of
from fiberloom.twin.errors.temperature import NO_DIFFERENCE, NightTemperature
from fiberloom.typing import Floats, Ints
from fiberloom.units import MM_PER_UM

Rng = np.random.Generator

FREEDOM = 5.0
"""Of Student's t that they are drawn from: half of the units are within 0.56 of the rms. In the tables it is
0.51 to 0.63, and 0.29 for APOGEE across the arm; of a Gaussian half would be within 0.67."""
AIR_LENGTH_MM = 50.0
"""Of the correlation of what air shifts: DESI's kernel."""
_FARTHEST = 6.0
"""In units of the rms: a fibre that is farther off was never glued so."""
_STREAM = 0xE220
_POWER_STREAM = 0xE221


@dataclass(frozen=True)
class TwinErrors:
    """Rms in um; 0: none."""

    arm_um: tuple[float, float] = (10.9, 13.3)
    """Length of the alpha arm; distance of the beta arm's fibres, all alike, from its axis."""
    fibre_um: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """By science fibre: along and across the beta arm, against the metrology fibre."""
    other_fibre_um: tuple[float, float] = (9.0, 8.3)
    """Of a science fibre that is not named."""
    fiducial_um: float = 8.0
    """Of the fiducials' table, per coordinate."""
    air_um: float = 1.5
    """Of what turbulence shifts in one image, per coordinate; the same over some `AIR_LENGTH_MM`."""
    power_share: float = 0.05
    """Share of positioners whose counters are off by whole motor turns after power-up (assumed); 0: power
    stays on, and every datum is on record."""
    power_turns: int = 5
    """Motor turns by which a counter is off at most (assumed); of two neighbouring numbers the larger is half
    as likely."""
    gears: GearSpectrum = "stages"
    """Spectrum of the gears' deviations."""
    loads: LoadSizes = field(default_factory=LoadSizes)
    """What pulls at the arms: gravity, and the bundle of fibres."""
    temperature: NightTemperature = field(default_factory=NightTemperature)
    """Of the night, against the calibration."""
    pointing: PointingSizes = field(default_factory=PointingSizes)
    """Of the telescope, and how well guide stars are seen."""

    @classmethod
    def of(cls, instrument: Instrument, switches: str = "all") -> TwinErrors:
        """Those of an `instrument`, by the text `switches`: "all", "none", "fibre,arm=2,gears=family".

        The numbers are factors on the sizes. InputError for a term or a key that there is not.
        """
        factors = factors_of(switches)
        told = _told(instrument)
        return cls(
            arm_um=_times(told.arm_um, factors["arm"]),
            fibre_um={name: _times(um, factors["fibre"]) for name, um in told.fibre_um.items()},
            other_fibre_um=_times(told.other_fibre_um, factors["fibre"]),
            fiducial_um=told.fiducial_um * factors["fiducial"],
            air_um=told.air_um * factors["air"],
            power_share=min(told.power_share * factors["power"], 1.0),
            power_turns=told.power_turns,
            gears=gears_of(switches),
            loads=told.loads.times(factors["gravity"], factors["torque"]),
            temperature=told.temperature.switched(factors["temperature"], night_C_of(switches)),
            pointing=told.pointing.times(factors["pointing"]),
        )

    def at_calibration(self) -> TwinErrors:
        """The same at the temperature of the calibration: what a bench has."""
        return replace(self, temperature=self.temperature.switched(0.0, None))

    def any(self) -> bool:
        """Whether tables or air are wrong; power-up spoils neither."""
        of_fibres = [um for pair in (*self.fibre_um.values(), self.other_fibre_um) for um in pair]
        sizes = (*self.arm_um, *of_fibres, self.fiducial_um, self.air_um)
        return any(sizes) or self.loads.any() or self.temperature.on

    def told(self, plane: FocalPlane) -> dict[str, str]:
        """For `put_in`: each size and its source."""
        measured = "SDSS-V's tables of 2024 and 2025"
        alpha_um, beta_um = self.arm_um
        off = [f"{name} {um[0]:g} along and {um[1]:g} um across" for name, um in self._named(plane)]
        return {
            "arms as built": f"{alpha_um:g} / {beta_um:g} um rms (alpha / beta), from {measured}",
            "science fibres against the metrology fibre": f"rms, the beta arm's frame: {', '.join(off)}, "
            f"from {measured}",
            "fiducials against their table": f"{self.fiducial_um:g} um rms per coordinate, {measured}",
            "air before the camera": f"{self.air_um:g} um rms per coordinate in each image, the same over "
            f"{AIR_LENGTH_MM:g} mm (assumed)",
            **self.loads.told(),
            "temperature": self.temperature.told(),
            "pointing of the telescope": self.pointing.told(),
            "power-up": self._told_power(),
        }

    def _told_power(self) -> str:
        if not self.power_share:
            return "every datum is on record"
        return (
            f"no datum is on record; {100.0 * self.power_share:g} % of the positioners have counters "
            f"that are off by 1 to {self.power_turns} whole motor turns (assumed)"
        )

    def _named(self, plane: FocalPlane) -> list[tuple[str, tuple[float, float]]]:
        names = [name for name in plane.points if name != METROLOGY]
        return [(name, self.fibre_um.get(name, self.other_fibre_um)) for name in names]

    def of_fibre(self, name: str) -> Floats:
        """(2,) mm rms along and across the beta arm."""
        rms_mm: Floats = MM_PER_UM * np.array(self.fibre_um.get(name, self.other_fibre_um))
        return rms_mm

    def drawn_of(self, number: int, seed: int, fibres: list[str]) -> UnitErrors:
        """The errors of the unit `number` with these `fibres`, by the `seed` and its number alone."""
        rng = np.random.default_rng([seed, number, _STREAM])
        arm = np.array(self.arm_um) * MM_PER_UM * heavy(rng, 2)
        # drawn in the order of the names, whatever else a plane has
        fibre_mm = {name: self.of_fibre(name) * heavy(rng, 2) for name in sorted(fibres)}
        return UnitErrors(float(arm[0]), float(arm[1]), fibre_mm)

    def turns_lost(self, number: int, seed: int) -> tuple[int, int]:
        """Motor turns of alpha and beta that the counters of the unit `number` are off by, by the `seed`.

        Of those that are off one axis is, either one; both are in a quarter of them.
        """
        rng = np.random.default_rng([seed, number, _POWER_STREAM])
        if rng.random() >= self.power_share:
            return 0, 0
        which = rng.choice(3, p=(0.375, 0.375, 0.25))
        size = 1 + np.minimum(rng.geometric(0.5, 2) - 1, self.power_turns - 1)
        alpha, beta = size * rng.choice((-1, 1), 2)
        return int(alpha * (which != 1)), int(beta * (which != 0))

    def fiducials_mm(self, plane: FocalPlane, seed: int) -> Floats:
        """(F, 2) mm: where the fiducials of a `plane` really are, by the `seed`."""
        table_mm: Floats = plane.fiducials[:, :2]
        off_mm = np.array([self._fiducial_mm(place, seed) for place in table_mm]).reshape(-1, 2)
        true_mm: Floats = table_mm + off_mm
        return true_mm

    def _fiducial_mm(self, place_mm: Floats, seed: int) -> Floats:
        """By its place: a part of a plane has the same fiducials."""
        where: Ints = np.rint(np.asarray(place_mm) / MM_PER_UM).astype(np.int64) + 2**31
        rng = np.random.default_rng([seed, _STREAM, *where.tolist()])
        off_mm: Floats = self.fiducial_um * MM_PER_UM * rng.standard_normal(2)
        return off_mm


NO_ERRORS = TwinErrors(
    (0.0, 0.0),
    {},
    (0.0, 0.0),
    0.0,
    0.0,
    0.0,
    loads=NO_LOADS,
    temperature=NO_DIFFERENCE,
    pointing=NO_POINTING,
)
"""A twin whose host has true tables, in still air, as warm as the calibration was, that nothing pulls at."""


@dataclass(frozen=True)
class UnitErrors:
    """Truth less table of one unit, mm."""

    l_alpha_mm: float
    beta_longer_mm: float
    fibre_mm: dict[str, Floats]
    """By science fibre, (2,) along and across the beta arm."""


def heavy(rng: Rng, *shape: int) -> Floats:
    """Numbers of this `shape` from `rng`: ratios to their rms, with the tails of real tables."""
    t = rng.standard_t(FREEDOM, shape) / np.sqrt(FREEDOM / (FREEDOM - 2.0))
    held: Floats = np.clip(t, -_FARTHEST, _FARTHEST)
    return held


def _told(instrument: Instrument) -> TwinErrors:
    """What `[twin.errors]` of an instrument says."""
    where = f"{instrument.name}: twin.errors"
    asked: dict[str, Any] = dict(instrument.twin.get("errors", {}))
    usual = TwinErrors()
    fibres = asked.pop("fibre_um", {})
    known = replace(
        usual,
        arm_um=_pair(asked.pop("arm_um", usual.arm_um), f"{where}.arm_um"),
        fiducial_um=_size(asked.pop("fiducial_um", usual.fiducial_um), f"{where}.fiducial_um"),
        air_um=_size(asked.pop("air_um", usual.air_um), f"{where}.air_um"),
        fibre_um={name: _pair(um, f"{where}.fibre_um.{name}") for name, um in fibres.items()},
        power_share=_share(asked.pop("power_share", usual.power_share), f"{where}.power_share"),
        power_turns=_turns(asked.pop("power_turns", usual.power_turns), f"{where}.power_turns"),
        loads=told_loads({key: asked.pop(key) for key in LOAD_KEYS if key in asked}, where),
        temperature=NightTemperature.of(asked.pop("temperature", {}), f"{where}.temperature"),
        pointing=PointingSizes.of(asked.pop("pointing", {}), f"{where}.pointing"),
    )
    if asked:
        own_keys = (
            "arm_um",
            "fibre_um",
            "fiducial_um",
            "air_um",
            "power_share",
            "power_turns",
            "temperature",
            "pointing",
        )
        known_keys = ", ".join((*own_keys, *LOAD_KEYS))
        raise InputError(f"{where}.{next(iter(asked))}: no such key; known are {known_keys}")
    return known


def _pair(value: Any, where: str) -> tuple[float, float]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise InputError(f"{where} = {value!r}: must be two numbers in um")
    return _size(value[0], where), _size(value[1], where)


def _size(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1000.0:
        raise InputError(f"{where} = {value!r}: must be 0 to 1000 um")
    return float(value)


def _share(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        raise InputError(f"{where} = {value!r}: must be 0 to 1, a share of the positioners")
    return float(value)


def _turns(value: Any, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 5:
        raise InputError(f"{where} = {value!r}: must be 1 to 5 motor turns")
    return value


def _times(um: tuple[float, float], factor: float) -> tuple[float, float]:
    return um[0] * factor, um[1] * factor
