"""A corrector with two prisms that turn, by the fit to its ray trace that desimeter keeps in JSON.

desimeter 3ef70cf, `raytracefit.py`: direction cosines over 0.027, turned to the mean angle of the prisms,
Zhao-Burge terms with coefficients by the angle between the prisms, turned back, times 420 mm. The file stays
where its owner has it; its path is in the instrument's TOML file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from fiberloom.errors import InputError
from fiberloom.files import parse_json, read_text
from fiberloom.metrology.zhao_burge import basis
from fiberloom.sky.optics.newton import inverse
from fiberloom.sky.optics.view import View
from fiberloom.typing import Floats
from fiberloom.units import RAD_PER_DEG, rad_to_deg

_UNIT = 0.027
"""Direction cosine at the edge of the unit disc [Q]."""
_RADIUS_MM = 420.0
"""The same in the focal plane [Q]."""
_LOWEST_DEG = 60.0
"""The prisms turn no further at larger zenith distances [Q]."""
_OPENED = (-0.0183, -0.3795, -0.1939)
"""Half the angle of the first prism before the second, rad: of powers of tan(zenith distance) [Q]."""


@dataclass(frozen=True)
class PrismAngles:
    """Of the two prisms, deg."""

    first_deg: float
    second_deg: float

    @classmethod
    def of(cls, view: View) -> PrismAngles:
        """Settings for a field: open by the zenith distance, along the parallactic angle."""
        t = np.tan(min(view.zenith_deg, _LOWEST_DEG) * RAD_PER_DEG)
        half_deg = float(rad_to_deg(np.polynomial.polynomial.polyval(t, _OPENED)))
        along = _parallactic_deg(view)
        return cls(along + half_deg, along - half_deg)

    @property
    def opened_deg(self) -> float:
        """Second less first."""
        return self.second_deg - self.first_deg

    @property
    def mean_deg(self) -> float:
        """Circular mean of first + 90 and second - 90; the first where both are equal."""
        if self.first_deg == self.second_deg:
            return self.first_deg
        both = np.array([self.first_deg + 90.0, self.second_deg - 90.0]) * RAD_PER_DEG
        return float(rad_to_deg(np.arctan2(np.sin(both).sum(), np.cos(both).sum())))


def _parallactic_deg(view: View) -> float:
    ha, dec, lat = np.array([view.hour_angle_deg, view.dec_deg, view.latitude_deg]) * RAD_PER_DEG
    along = np.cos(dec) * np.sin(lat) - np.sin(dec) * np.cos(lat) * np.cos(ha)
    return float(rad_to_deg(np.arctan2(np.sin(ha) * np.cos(lat), along)))


@dataclass(frozen=True)
class PrismOptics:
    """The fit of a file."""

    terms: tuple[int, ...]
    """Zhao-Burge terms."""
    coefficients: Any
    """Of the terms, ratios, by the angle between the prisms in deg: a spline."""
    prisms: PrismAngles | None = None
    """None: as the field asks for."""

    @classmethod
    def read(cls, path: str | Path, prisms: PrismAngles | None = None) -> PrismOptics:
        """The fit of a JSON file at `path`; `prisms`: angles in deg, where they are not the field's."""
        told = parse_json(read_text(Path(path)), str(path))
        try:
            return cls(tuple(told["zbpolids"]), _spline(told), prisms)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}: no ray trace of desimeter's form: {error}") from None

    def focal_mm(self, directions: Floats, view: View) -> Floats:
        """(n, 2) mm, x to the east, y to the north, of directions (n, 3); `view`: sets the prisms."""
        focal: Floats = self._bent(view)(directions[:, :2])
        return focal

    def directions(self, focal_mm: Floats, view: View) -> Floats:
        """(n, 3) unit vectors of places (n, 2) in mm, for the same `view`."""
        xy = inverse(self._bent(view), focal_mm, focal_mm * (_UNIT / _RADIUS_MM))
        return np.column_stack([xy, np.sqrt(1.0 - (xy**2).sum(axis=1))])

    def plane_mm(self, focal_mm: Floats, view: View) -> Floats:
        """(n, 2) mm in the focal plane, of (n, 2) mm on the image, in the `view`."""
        return view.turned(focal_mm) / view.scale

    def from_plane_mm(self, plane_mm: Floats, view: View) -> Floats:
        """(n, 2) mm on the image, of (n, 2) mm in the focal plane, in the `view`."""
        return view.turned_back(plane_mm * view.scale)

    def _bent(self, view: View) -> Any:
        """The fit is of x to the west."""
        prisms = self.prisms or PrismAngles.of(view)
        west = np.array([-1.0, 1.0])

        def bent(xy: Floats) -> Floats:
            mm: Floats = west * self.traced_mm(west * xy, prisms)
            return mm

        return bent

    def traced_mm(self, tangent: Floats, prisms: PrismAngles) -> Floats:
        """(n, 2) mm, x to the west, of direction cosines (n, 2) to the west and north.

        `prisms`: their angles, deg.
        """
        a = prisms.mean_deg * RAD_PER_DEG
        turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
        unit = (tangent / _UNIT) @ turn  # by minus the angle
        added = np.einsum("t,tnk->nk", self.coefficients(prisms.opened_deg), basis(unit, self.terms))
        mm: Floats = _RADIUS_MM * (unit + added) @ turn.T
        return mm


def _spline(told: Mapping[str, Any]) -> CubicSpline:
    opened = np.asarray(told["adc2"], dtype=np.float64) - np.asarray(told["adc1"], dtype=np.float64)
    rows = np.asarray(told["zbcoeffs"], dtype=np.float64).reshape(len(opened), len(told["zbpolids"]))
    return CubicSpline(opened, rows)
