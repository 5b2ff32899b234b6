"""Optics that are round: the radius in the focal plane is a function of the field angle alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fiberloom.sky.optics.view import View
from fiberloom.typing import Floats
from fiberloom.units import DEG_PER_RAD, RAD_PER_DEG

_STEPS = 12
"""Of Newton; 3 are enough for SDSS-V."""


@dataclass(frozen=True)
class RadialLaw:
    """r = outer(P(inner(t))) mm of the field angle t in rad; P is an odd polynomial.

    Every step has its inverse, so that a place goes to the sky and back without loss.
    """

    terms: tuple[float, ...]
    """Of s, s^3, s^5, ... with s = inner(t)."""
    inner: Callable[[Any], Any]
    inner_back: Callable[[Any], Any]
    outer: Callable[[Any], Any]
    outer_back: Callable[[Any], Any]

    def radius_mm(self, angle_rad: Floats) -> Floats:
        """Radius of field angles, rad."""
        s = self.inner(angle_rad)
        radius: Floats = self.outer(s * self._ratio(s))
        return radius

    def angle_rad(self, radius_mm: Floats) -> Floats:
        """Field angle of radii, mm; NaN beyond what the surface has."""
        with np.errstate(invalid="ignore"):
            value = self.outer_back(radius_mm)
            s = value / self.terms[0]
            for _ in range(_STEPS):
                s = s - (s * self._ratio(s) - value) / self._slope(s)
            angle: Floats = self.inner_back(s)
        return angle

    def _ratio(self, s: Any) -> Any:
        """P(s) / s, by Horner's rule."""
        total = np.zeros_like(s)
        for term in reversed(self.terms):
            total = total * s**2 + term
        return total

    def _slope(self, s: Any) -> Any:
        total = np.zeros_like(s)
        for power, term in reversed(list(enumerate(self.terms))):
            total = total * s**2 + (2 * power + 1) * term
        return total


@dataclass(frozen=True)
class RoundOptics:
    """A round focal plane, turned by the position angle."""

    law: RadialLaw

    def focal_mm(self, directions: Floats, view: View) -> Floats:
        """(n, 2) mm, x to the east and y to the north, of directions (n, 3), unit vectors.

        `view` is not needed: no telescope of this kind changes with where it looks.
        """
        across = np.hypot(directions[:, 0], directions[:, 1])
        radius = self.law.radius_mm(np.arctan2(across, directions[:, 2]))
        ratio = np.divide(radius, across, out=np.zeros_like(across), where=across > 0)
        focal: Floats = directions[:, :2] * ratio[:, None]
        return focal

    def directions(self, focal_mm: Floats, view: View) -> Floats:
        """(n, 3) unit vectors of places (n, 2) in mm; the reverse of `focal_mm`. `view`: not needed."""
        radius = np.hypot(focal_mm[:, 0], focal_mm[:, 1])
        angle = self.law.angle_rad(radius)
        ratio = np.divide(np.sin(angle), radius, out=np.zeros_like(radius), where=radius > 0)
        return np.column_stack([focal_mm * ratio[:, None], np.cos(angle)])

    def plane_mm(self, focal_mm: Floats, view: View) -> Floats:
        """(n, 2) places in the focal plane, mm, as the `view` is turned."""
        return view.turned(focal_mm) / view.scale

    def from_plane_mm(self, plane_mm: Floats, view: View) -> Floats:
        """(n, 2) places on the image, mm; the reverse of `plane_mm`, for the same `view`."""
        return view.turned_back(plane_mm * view.scale)


def sphere(radius_mm: float, terms: tuple[float, ...]) -> RadialLaw:
    """r = R sin p(t), p and t in deg: `radius_mm` R, `terms` of t, t^3, ... (deg)."""
    return RadialLaw(
        terms,
        lambda t: t * DEG_PER_RAD,
        lambda s: s * RAD_PER_DEG,
        lambda p: radius_mm * np.sin(p * RAD_PER_DEG),
        lambda r: np.arcsin(r / radius_mm) * DEG_PER_RAD,
    )


def polynomial(terms_mm: tuple[float, ...]) -> RadialLaw:
    """r = odd polynomial of t in deg, with `terms_mm` of t, t^3, ..."""
    return RadialLaw(terms_mm, lambda t: t * DEG_PER_RAD, lambda s: s * RAD_PER_DEG, _same, _same)


_PROJECTIONS: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    "linear": (lambda t: t, lambda s: s),
    "sin": (np.sin, np.arcsin),
    "tan": (np.tan, np.arctan),
}


def scaled(focal_length_mm: float, projection: str, terms: tuple[float, ...]) -> RadialLaw:
    """r = F (s + k3 s^3 + ...), s = `projection` of t: `focal_length_mm` F, `terms` k3, k5, ... (ratios)."""
    inner, back = _PROJECTIONS[projection]
    length = focal_length_mm
    return RadialLaw((1.0, *terms), inner, back, lambda p: length * p, lambda r: r / length)


def _same(value: Any) -> Any:
    return value
