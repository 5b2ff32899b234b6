"""How the telescope looks: what optics know of a field beside its directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fiberloom.typing import Floats
from fiberloom.units import RAD_PER_DEG


@dataclass(frozen=True)
class View:
    """Of one field at one time; angles in deg."""

    pa_deg: float
    """Position angle: from the image's north through east to +y of the focal plane."""
    scale: float
    """Places on the image over places in the focal plane, a ratio."""
    parallactic_deg: float
    """At the centre, from the observed pole to the zenith, positive in the west."""
    zenith_deg: float
    """Zenith distance of the centre without refraction."""
    pole_deg: float
    """At the centre and without refraction, from the zenith through growing azimuth to the pole."""
    hour_angle_deg: float
    """Of the observed centre."""
    dec_deg: float
    """Of the observed centre."""
    latitude_deg: float
    flipped: bool = False
    """x runs to the west at position angle 0."""

    def turned(self, xy: Floats) -> Floats:
        """(n, 2) of the image (east, north) in the axes of the focal plane, in the unit given."""
        x, y = _rotated(xy, self.pa_deg)
        return np.column_stack([-x if self.flipped else x, y])

    def turned_back(self, xy: Floats) -> Floats:
        """(n, 2) of the focal plane in the axes of the image, in the unit given."""
        image = xy * np.array([-1.0, 1.0]) if self.flipped else xy
        return np.column_stack(_rotated(image, -self.pa_deg))

    def horizontal(self, xy: Floats) -> Floats:
        """(n, 2) of the image (east, north) to growing azimuth and altitude, in the unit given."""
        q = self.parallactic_deg * RAD_PER_DEG
        x, y = xy.T
        return np.column_stack([y * np.sin(q) - x * np.cos(q), y * np.cos(q) + x * np.sin(q)])

    def equatorial(self, eu: Floats) -> Floats:
        """(n, 2) of growing azimuth and altitude to east and north on the image, in the unit given."""
        q = self.parallactic_deg * RAD_PER_DEG
        e, u = eu.T
        return np.column_stack([u * np.sin(q) - e * np.cos(q), u * np.cos(q) + e * np.sin(q)])


def _rotated(xy: Floats, pa_deg: float) -> tuple[Floats, Floats]:
    """Axes turned by the position angle, which grows from y to x."""
    c, s = np.cos(pa_deg * RAD_PER_DEG), np.sin(pa_deg * RAD_PER_DEG)
    return xy[:, 0] * c - xy[:, 1] * s, xy[:, 0] * s + xy[:, 1] * c


class FieldOptics(Protocol):
    """From directions to the focal plane and back. Directions are unit vectors (n, 3): x to the east and y to
    the north of the observed field centre, z to the centre; places are (n, 2) in mm.
    """

    def focal_mm(self, directions: Floats, view: View) -> Floats:
        """On the image, x to the east, y to the north, mm."""

    def directions(self, focal_mm: Floats, view: View) -> Floats:
        """The reverse, unit vectors."""

    def plane_mm(self, focal_mm: Floats, view: View) -> Floats:
        """In the focal plane of the positioners, mm."""

    def from_plane_mm(self, plane_mm: Floats, view: View) -> Floats:
        """The reverse, mm."""
