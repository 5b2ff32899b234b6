"""A list that is larger than one field of the array, cut into fields: hexagons that the array covers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats, Ints

ARCSEC = math.pi / 648000.0
"""rad"""
WIDEST_RAD = math.radians(60.0)
"""From the middle of a list on the sky: an equal-area chart stretches by 1/cos(30 deg) there, 15 %."""
FEWEST = 7
"""Positioners whose hull is a field; of fewer it is the reach of one."""
_TURNED = np.radians(np.arange(0.0, 60.0))


@dataclass(frozen=True)
class FieldHexagon:
    """The largest regular hexagon about the middle of an array within the hull of its centres."""

    circumradius_mm: float
    turned_rad: float
    """Of one of its corners against +x."""


@dataclass(frozen=True, eq=False)
class FieldTargets:
    """The targets of one field."""

    rows: Ints
    """(m,) in the list."""
    xy_mm: Floats
    """(m, 2) from the middle of the array."""


def hexagon_of(plane: FocalPlane) -> FieldHexagon:
    """Of the `plane`; of fewer than seven positioners the one in the reach of an arm."""
    if len(plane) < FEWEST:
        return FieldHexagon(float(plane.body_reach_mm.min()), 0.0)
    hull = ConvexHull(plane.centres_mm - plane.centres_mm.mean(axis=0))
    normals, far = hull.equations[:, :2], -hull.equations[:, 2]
    corners = _TURNED[:, None] + math.radians(60.0) * np.arange(6)
    towards = np.stack([np.cos(corners), np.sin(corners)], axis=-1) @ normals.T
    with np.errstate(divide="ignore"):
        fits = np.where(towards > 1e-12, far / np.where(towards > 1e-12, towards, 1.0), np.inf).min(
            axis=(1, 2)
        )
    best = int(np.argmax(fits))
    return FieldHexagon(float(fits[best]), float(_TURNED[best]))


def fields_in_mm(
    xy_mm: Floats, hexagon: FieldHexagon, angle_rad: float, phase: Floats
) -> Iterator[FieldTargets]:
    """Fields of a list in the plane: `xy_mm` (n, 2), turned by `angle_rad`, none of them empty.

    `hexagon`: of the array; `phase` (2,): where the lattice begins, shares of its cell.
    """
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    turned = xy_mm @ np.array([[c, s], [-s, c]])
    centre, cell = _cells(turned, hexagon.circumradius_mm, hexagon.turned_rad, phase)
    for rows in _by_cell(cell):
        yield FieldTargets(rows, turned[rows] - centre[rows])


def fields_on_sky(
    radec_deg: Floats, scale_um_arcsec: float, hexagon: FieldHexagon, angle_rad: float, phase: Floats
) -> Iterator[FieldTargets]:
    """Fields of a list on the sky: `radec_deg` (n, 2); each target by the tangent of its field.

    `scale_um_arcsec`: of the focal plane, um per arcsec, the same everywhere; `hexagon`, `phase` as in
    `fields_in_mm`; the chart is turned by `angle_rad`. Hexagons are cut in an equal-area chart about the
    middle of the list, smaller by as much as the chart stretches.

    Raises
    ------
    InputError
        A list that goes further than 60 deg from its middle.
    """
    points = _unit(*np.radians(radec_deg).T)
    middle = points.mean(axis=0)
    length = float(np.linalg.norm(middle))
    middle = middle / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    far = float(np.arccos(np.clip(points @ middle, -1.0, 1.0)).max())
    if far > WIDEST_RAD:
        raise InputError(
            f"the list goes {math.degrees(far):.0f} deg from its middle; cut it into parts of at most "
            f"{math.degrees(WIDEST_RAD):.0f} deg"
        )
    axes = _axes(middle, angle_rad)
    size_rad = hexagon.circumradius_mm * 1e3 / scale_um_arcsec * ARCSEC
    centre, cell = _cells(_chart(points, axes), size_rad * math.cos(0.5 * far), hexagon.turned_rad, phase)
    mm = 1e-3 * scale_um_arcsec / ARCSEC
    for rows in _by_cell(cell):
        east, north, towards = _local(centre[rows[0]], axes)
        depth = points[rows] @ towards
        xy = np.column_stack([points[rows] @ east, points[rows] @ north]) / depth[:, None]
        yield FieldTargets(rows, mm * xy)


def _cells(xy: Floats, circumradius: float, turned_rad: float, phase: Floats) -> tuple[Floats, Ints]:
    """(n, 2) middles of the hexagons that hold the points (n, 2), and (n, 2) their numbers."""
    # the lattice of hexagons with a corner at 0 deg: neighbours at 30, 90 deg, sqrt(3) circumradii away
    angles = turned_rad + np.radians([30.0, 90.0])
    basis = math.sqrt(3.0) * circumradius * np.column_stack([np.cos(angles), np.sin(angles)])
    near = np.floor(xy @ np.linalg.inv(basis) - phase).astype(np.int64)
    corners = near[:, None] + np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    middles = (corners + phase) @ basis
    best = np.argmin(np.linalg.norm(middles - xy[:, None], axis=2), axis=1)
    every = np.arange(len(xy))
    return middles[every, best], corners[every, best]


def _by_cell(cell: Ints) -> Iterator[Ints]:
    _, which = np.unique(cell, axis=0, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    ends = np.cumsum(np.bincount(which.ravel()))
    yield from (rows for rows in np.split(order, ends[:-1]) if len(rows))


def _unit(ra: Floats, dec: Floats) -> Floats:
    return np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])


def _axes(middle: Floats, angle_rad: float) -> Floats:
    """(3, 3) two axes across, turned, and the middle itself."""
    aside = np.eye(3)[int(np.argmin(np.abs(middle)))]
    first = np.cross(aside, middle)
    first /= np.linalg.norm(first)
    second = np.cross(middle, first)
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.stack([c * first + s * second, c * second - s * first, middle])


def _chart(points: Floats, axes: Floats) -> Floats:
    """(n, 2) of unit vectors (n, 3), by Lambert's azimuthal chart of equal area, rad."""
    x, y, z = axes @ points.T
    chart: Floats = np.column_stack([x, y]) * np.sqrt(2.0 / (1.0 + z))[:, None]
    return chart


def _on_sky(chart: Floats, axes: Floats) -> Floats:
    """(3,) unit vector of a place (2,) of the chart."""
    quarter = 0.25 * float(chart @ chart)
    across = math.sqrt(1.0 - quarter)
    found: Floats = np.array([*(across * chart), 1.0 - 2.0 * quarter]) @ axes
    return found


def _local(chart: Floats, axes: Floats) -> tuple[Floats, Floats, Floats]:
    """Tangents of the sky along x and y of the chart, and the direction, at a place (2,) of the chart."""
    towards = _on_sky(chart, axes)
    step = _on_sky(chart + np.array([1e-6, 0.0]), axes) - towards
    first = step - (step @ towards) * towards
    first /= np.linalg.norm(first)
    second: Floats = np.cross(towards, first)
    return first, second, towards
