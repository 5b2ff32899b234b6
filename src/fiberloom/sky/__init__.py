"""From RA and Dec to millimetres in the focal plane, and back.

Within this package `Site` and `Pointing` are other names of `SkySite` and `SkyPointing`.
"""

from typing import TYPE_CHECKING

from fiberloom.lazy import on_use

if TYPE_CHECKING:
    from fiberloom.sky.chain import Chain, Pointing, SkyPlaces, SkyPointing
    from fiberloom.sky.earth import SkyTime
    from fiberloom.sky.site import Site, SkySite, Weather
    from fiberloom.sky.sky_targets import SkyTargets

__all__ = [
    "Chain",
    "Pointing",
    "Site",
    "SkyPlaces",
    "SkyPointing",
    "SkySite",
    "SkyTargets",
    "SkyTime",
    "Weather",
]

__getattr__ = on_use(__name__)
