"""From RA and Dec to millimetres in the focal plane, and back."""

from typing import TYPE_CHECKING

from fiberloom.lazy import on_use

if TYPE_CHECKING:
    from fiberloom.sky.chain import Chain, SkyPlaces, SkyPointing
    from fiberloom.sky.earth import SkyTime
    from fiberloom.sky.site import SkySite, Weather
    from fiberloom.sky.sky_targets import SkyTargets

__all__ = ["Chain", "SkyPlaces", "SkyPointing", "SkySite", "SkyTargets", "SkyTime", "Weather"]

__getattr__ = on_use(__name__)
