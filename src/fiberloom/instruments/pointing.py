"""Where the telescope points: how gravity lies in the focal plane, at the image and while light is collected.

The focal plane is tilted by the zenith distance and turns with the rotator. At rotator 0 gravity pulls along
-y; a rotator angle of +90 deg turns the plane counter-clockwise, seen from the camera, so that it pulls
along -x.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import isfinite

import numpy as np

from fiberloom.errors import InputError
from fiberloom.typing import Floats
from fiberloom.units import RAD_PER_DEG

STANDARD_GRAVITY_M_S2 = 9.80665
"""CGPM 1901; at observatories it is within 0.3 % of it."""
HORIZON_DEG = 90.0


@dataclass(frozen=True)
class Pointing:
    """Of a telescope, deg."""

    zenith_deg: float = 0.0
    """Distance from the zenith."""
    rotator_deg: float = 0.0
    """By which the focal plane is turned."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.zenith_deg <= HORIZON_DEG:
            raise InputError(f"zenith distance {self.zenith_deg:g} deg: must be 0 to {HORIZON_DEG:g}")
        if not (isfinite(self.rotator_deg) and abs(self.rotator_deg) <= 720.0):
            raise InputError(f"rotator {self.rotator_deg:g} deg: must be -720 to 720")

    def gravity_m_s2(self) -> Floats:
        """(2,) acceleration along x and y of the focal plane."""
        turned = self.rotator_deg * RAD_PER_DEG
        along = STANDARD_GRAVITY_M_S2 * np.sin(self.zenith_deg * RAD_PER_DEG)
        down: Floats = -along * np.array([np.sin(turned), np.cos(turned)])
        return down


@dataclass(frozen=True)
class ExposurePointing:
    """The image by which fibres are placed, and the exposure after it."""

    image: Pointing = Pointing()
    turn_deg: float = 0.0
    """By which the rotator has turned from the image to the middle of the exposure."""
    fall_deg: float = 0.0
    """By which the zenith distance has grown by then; negative: the field rises."""
    swing_deg: float = 0.0
    """By which the rotator turns during the exposure, from its begin to its end."""

    def __post_init__(self) -> None:
        self.along()  # each of them is refused where it cannot be

    @property
    def middle(self) -> Pointing:
        """In the middle of the exposure."""
        return self._at(0.0)

    def along(self) -> tuple[Pointing, Pointing, Pointing]:
        """At begin, middle and end of the exposure."""
        return self._at(-0.5), self.middle, self._at(0.5)

    def _at(self, share: float) -> Pointing:
        turned = self.image.rotator_deg + self.turn_deg + share * self.swing_deg
        return Pointing(self.image.zenith_deg + self.fall_deg, turned)

    @classmethod
    def of(cls, told: Mapping[str, float]) -> ExposurePointing:
        """Of what `about` has `told`, deg."""
        known = dict(told)
        return cls(Pointing(known.pop("zenith_deg"), known.pop("rotator_deg")), **known)

    def about(self) -> dict[str, float]:
        """For files: numbers by name, deg."""
        own = {key: value for key, value in asdict(self).items() if key != "image"}
        return asdict(self.image) | own


OVERHEAD = ExposurePointing()
"""Image and exposure in the zenith: gravity moves nothing."""
