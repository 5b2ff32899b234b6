"""The optics of a site, made from the instrument's table."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from fiberloom.instruments.model import (
    PolynomialOptics,
    RadialOptics,
    RaytraceOptics,
    SphereOptics,
    SubaruOptics,
    TelescopeSite,
)
from fiberloom.sky.optics.radial import RoundOptics, polynomial, scaled, sphere
from fiberloom.sky.optics.subaru import PrimeFocus
from fiberloom.sky.optics.view import FieldOptics

Fit = tuple[FieldOptics, float]
"""Optics, and to which field angle in deg they hold."""


def _sphere(table: SphereOptics) -> Fit:
    return RoundOptics(sphere(table.radius_mm, table.terms)), table.limit_deg


def _polynomial(table: PolynomialOptics) -> Fit:
    return RoundOptics(polynomial(table.terms_mm)), table.limit_deg


def _radial(table: RadialOptics) -> Fit:
    law = scaled(table.focal_length_mm, table.projection, table.terms)
    return RoundOptics(law), table.limit_deg


def _raytrace(table: RaytraceOptics) -> Fit:
    from fiberloom.sky.optics.raytrace import PrismOptics  # scipy

    return PrismOptics.read(table.file), table.limit_deg


def _subaru(table: SubaruOptics) -> Fit:
    return PrimeFocus(), table.limit_deg


_MAKERS: dict[type[Any], Callable[[Any], Fit]] = {
    SphereOptics: _sphere,
    PolynomialOptics: _polynomial,
    RadialOptics: _radial,
    RaytraceOptics: _raytrace,
    SubaruOptics: _subaru,
}


@cache
def _made(table: Any) -> Fit:
    return _MAKERS[type(table)](table)


def _apart_A(table: SphereOptics, wavelength_A: float) -> float:
    return abs(table.wavelength_A - wavelength_A)


def optics_at(site: TelescopeSite, wavelength_A: float) -> Fit:
    """Optics of a site for the nearest wavelength (A), and to which field angle in deg they hold."""
    if len(site.optics) == 1:
        return _made(site.optics[0])
    several = [one for one in site.optics if isinstance(one, SphereOptics)]
    return _made(min(several, key=lambda one: _apart_A(one, wavelength_A)))
