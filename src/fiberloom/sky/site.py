"""Where a telescope is, and the air above it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fiberloom.errors import InputError
from fiberloom.instruments.model import Instrument, SkyTable, TelescopeSite
from fiberloom.units import RAD_PER_DEG

_SEA_LEVEL_HPA, _STANDARD_K = 1013.25, 288.16
_GRAVITY_M_S2, _AIR_KG, _GAS_J_K = 9.80665, 0.02896968, 8.314462618
"""Mass of a mole of air in kg, and the gas constant in J/(mol K): sdss/coordio 1.18.1, `site.py`."""


def sky_of(instrument: Instrument) -> SkyTable:
    """The `[sky]` table; InputError for an instrument without one."""
    if instrument.sky is None:
        raise InputError(f"{instrument.name}: has no [sky] table; give targets as x_mm, y_mm")
    return instrument.sky


@dataclass(frozen=True)
class SkySite:
    """A place on Earth, and the telescope there."""

    name: str
    longitude_deg: float
    """East of Greenwich."""
    latitude_deg: float
    height_m: float
    telescope: TelescopeSite
    """Optics and scale; the usual weather."""

    @classmethod
    def of(cls, instrument: Instrument, name: str | None = None) -> SkySite:
        """A site of an instrument by name; its first where none is given."""
        sites = sky_of(instrument).sites
        name = next(iter(sites)) if name is None else name.lower()
        if name not in sites:
            raise InputError(f"site '{name}': {instrument.name} is at {', '.join(sites)}")
        table = sites[name]
        return cls(name, table.longitude_deg, table.latitude_deg, table.height_m, table)

    def elsewhere(self, longitude_deg: float, latitude_deg: float, height_m: float) -> SkySite:
        """The same telescope at another place: deg east, deg, m. Its weather is that of a standard
        atmosphere."""
        telescope = self.telescope.model_copy(update={"weather": None})
        return SkySite("own", longitude_deg, latitude_deg, height_m, telescope)

    @property
    def longitude_rad(self) -> float:
        """East of Greenwich."""
        return self.longitude_deg * RAD_PER_DEG

    @property
    def latitude_rad(self) -> float:
        """Geodetic."""
        return self.latitude_deg * RAD_PER_DEG


Site = SkySite
"""Within `fiberloom.sky`; elsewhere a site is a file that says how an array is reached."""


@dataclass(frozen=True)
class Weather:
    """Air at the telescope, as refraction takes it."""

    pressure_hPa: float
    temperature_C: float = 10.0
    humidity: float = 0.5
    """Relative, 0 to 1."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("pressure_hPa", 0.0, 1200.0),
            ("temperature_C", -80.0, 60.0),
            ("humidity", 0.0, 1.0),
        ):
            if not low <= getattr(self, name) <= high:
                raise InputError(f"weather {name} = {getattr(self, name):g}: must be {low:g} to {high:g}")

    @classmethod
    def standard(cls, height_m: float) -> Weather:
        """10 deg C, half saturated, and the pressure of a standard atmosphere at a height in m."""
        exponent = _GRAVITY_M_S2 * height_m * _AIR_KG / (_STANDARD_K * _GAS_J_K)
        return cls(_SEA_LEVEL_HPA * math.exp(-exponent))

    @classmethod
    def usual(cls, site: SkySite) -> Weather:
        """What is computed with at a site where nothing was measured."""
        telescope: TelescopeSite = site.telescope
        air = telescope.weather
        if air is None:
            return cls.standard(site.height_m)
        return cls(air.pressure_hPa, air.temperature_C, air.humidity)
