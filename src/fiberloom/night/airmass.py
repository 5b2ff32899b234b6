"""How much air is above a field: enough to choose by, to 0.01 up to an airmass of 3."""

from __future__ import annotations

import math
from datetime import datetime

import erfa

from fiberloom.sky.earth import SkyTime, quiet

BELOW = math.inf
"""Airmass of what has not risen."""


def altitude_deg(
    ra_deg: float, dec_deg: float, longitude_deg: float, latitude_deg: float, utc: datetime
) -> float:
    """Geometric altitude of a direction (ICRS), deg.

    `ra_deg`, `dec_deg`: direction; `longitude_deg` (east), `latitude_deg`: place; `utc`: time. UT1 is taken
    for UTC, and precession since J2000 for all that turns the sky: 0.01 deg.
    """
    when = SkyTime.of(utc.replace(tzinfo=None).isoformat(timespec="seconds"), "utc")
    direction = quiet(erfa.s2c, math.radians(ra_deg), math.radians(dec_deg))
    x, y, z = quiet(erfa.pmat06, *when.tt) @ direction
    turned = quiet(erfa.gmst06, when.day, when.part, *when.tt) + math.radians(longitude_deg)
    hour, latitude = turned - math.atan2(y, x), math.radians(latitude_deg)
    declination = math.atan2(z, math.hypot(x, y))
    sine = math.sin(latitude) * math.sin(declination)
    sine += math.cos(latitude) * math.cos(declination) * math.cos(hour)
    return math.degrees(math.asin(max(-1.0, min(1.0, sine))))


def airmass(ra_deg: float, dec_deg: float, longitude_deg: float, latitude_deg: float, utc: datetime) -> float:
    """Of a direction, a ratio (Pickering 2002, DIO 12, 20); infinite below the horizon.

    `ra_deg`, `dec_deg`: direction; `longitude_deg` (east), `latitude_deg`: place; `utc`: time.
    """
    altitude = altitude_deg(ra_deg, dec_deg, longitude_deg, latitude_deg, utc)
    if altitude <= 0.0:
        return BELOW
    return 1.0 / math.sin(math.radians(altitude + 244.0 / (165.0 + 47.0 * altitude**1.1)))
