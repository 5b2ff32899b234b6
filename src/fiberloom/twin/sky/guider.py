"""The guide cameras of a twin: stars that are seen where a telescope that points off has them."""

from __future__ import annotations

import numpy as np

from fiberloom.sky.chain import Chain
from fiberloom.sky.drift import guide_stars
from fiberloom.sky.guiding import FieldOffset
from fiberloom.sky.pointed import plate_um_arcsec
from fiberloom.sky.sky_targets import SkyTargets
from fiberloom.twin.errors.pointing import PointingSizes
from fiberloom.typing import Floats
from fiberloom.units import MM_PER_UM

_STREAM = 0x601E
_CAMERAS_AT = 0.94
"""Of the field's radius: all stars of a camera are within the field."""


class TwinGuider:
    """Implements `fiberloom.hardware.Guider`. The telescope stays as far off as it is while it is there."""

    def __init__(self, sizes: PointingSizes, seed: int) -> None:
        """`sizes`: of what it is off and of the noise; `seed`: of both."""
        self.sizes = sizes
        self._off = sizes.drawn(seed)
        self._rng = np.random.default_rng([seed, _STREAM])

    def stars(self, chain: Chain) -> SkyTargets | None:
        """Four on each of six cameras at the edge of the field; none where the telescope is not off."""
        return guide_stars(chain, _CAMERAS_AT) if self.sizes.any() else None

    def look(self, stars: SkyTargets, chain: Chain) -> Floats:
        """(n, 2) mm with noise; NaN outside of the field or below the horizon.

        `stars`: n of them; `chain`: for which they are predicted.
        """
        found = chain.place(stars)
        noise_mm = MM_PER_UM * self.star_um(chain) * self._rng.standard_normal((len(stars), 2))
        there = ~found.outside & (found.altitude_deg > 0.0)
        return np.where(there[:, None], self.truth(chain).applied(found.xy_mm) + noise_mm, np.nan)

    def star_um(self, chain: Chain) -> float:
        """Error of one star in one image, um per axis; `chain`: of the field."""
        return self.sizes.star_arcsec * plate_um_arcsec(chain)

    def truth(self, chain: Chain) -> FieldOffset:
        """How the telescope points off; `chain`: of the field."""
        x_deg, y_deg, rotation_deg, larger = self._off.tolist()
        offset_mm = MM_PER_UM * plate_um_arcsec(chain) * 3600.0 * np.array([x_deg, y_deg])
        return FieldOffset(offset_mm, rotation_deg, 1.0 + larger)
