"""How a telescope points off, and how well its guide cameras see stars.

An instrument says its own:

    [twin.errors.pointing]
    offset_arcsec = 1.0        # of the field's centre, rms per coordinate
    rotation_arcsec = 20.0     # of the rotator, rms
    scale_ppm = 50.0           # of the plate scale, rms
    star_arcsec = 0.1          # of a star in one image of a guide camera, per axis

All are assumed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.typing import Floats

_STREAM = 0x601D
_FARTHEST = 2.5
"""In units of the rms: no telescope points farther off."""
_MOST = 1000.0
_UNITS = np.array([1.0 / 3600.0, 1.0 / 3600.0, 1.0 / 3600.0, 1e-6])
"""Of what is drawn: arcsec in deg, ppm as a ratio."""


@dataclass(frozen=True)
class PointingSizes:
    """Rms of what is drawn; 0: none."""

    offset_arcsec: float = 1.0
    """Of the field's centre, per coordinate."""
    rotation_arcsec: float = 20.0
    scale_ppm: float = 50.0
    star_arcsec: float = 0.1
    """Of a star in one image, per axis."""

    @classmethod
    def of(cls, told: Mapping[str, Any], where: str) -> PointingSizes:
        """Those of a table `told` in an instrument's file; `where`: its name there.

        InputError for a key that there is not, or what is no number or out of range.
        """
        known = [one.name for one in fields(cls)]
        for key, value in told.items():
            if key not in known:
                raise InputError(f"{where}.{key}: no such key; known are {', '.join(known)}")
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= _MOST:
                raise InputError(f"{where}.{key} = {value!r}: must be a number, 0 to {_MOST:g}")
        made = cls(**{key: float(value) for key, value in told.items()})
        if made.star_arcsec <= 0.0:
            raise InputError(f"{where}.star_arcsec = {made.star_arcsec:g}: must be above 0")
        return made

    def times(self, factor: float) -> PointingSizes:
        """With a `factor` (a ratio) on what the telescope is off; stars are seen as well as before."""
        return replace(
            self,
            offset_arcsec=self.offset_arcsec * factor,
            rotation_arcsec=self.rotation_arcsec * factor,
            scale_ppm=self.scale_ppm * factor,
        )

    def any(self) -> bool:
        """Whether the telescope points off."""
        return any((self.offset_arcsec, self.rotation_arcsec, self.scale_ppm))

    def drawn(self, seed: int) -> Floats:
        """(4,) x, y and rotation in deg, scale less 1, by the `seed`."""
        drawn = np.random.default_rng([seed, _STREAM]).standard_normal(4)
        sizes = np.array([self.offset_arcsec, self.offset_arcsec, self.rotation_arcsec, self.scale_ppm])
        off: Floats = sizes * np.clip(drawn, -_FARTHEST, _FARTHEST) * _UNITS
        return off

    def told(self) -> str:
        """For `put_in`."""
        if not self.any():
            return "true"
        return (
            f"offset {self.offset_arcsec:g} arcsec rms per coordinate, rotation {self.rotation_arcsec:g} "
            f"arcsec, scale {self.scale_ppm:g} ppm; a guide star {self.star_arcsec:g} arcsec in an image "
            "(assumed; of fields on the sky)"
        )


NO_POINTING = PointingSizes(0.0, 0.0, 0.0)
"""A telescope that points where it should."""
