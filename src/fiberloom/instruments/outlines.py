"""Bodies of several parts: capsules and convex polygons on layers, and keep-outs that do not move."""

import math
from collections.abc import Callable
from functools import cache
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial import ConvexHull

from fiberloom.instruments.table import Finite, NotNegative, Positive, Table
from fiberloom.typing import Array, Floats

_TURNS = np.linspace(0.0, math.pi, 12, endpoint=False)
"""Directions of capsules and cuts that are tried, rad."""
_ALONG = np.array([(math.cos(turn), math.sin(turn)) for turn in _TURNS])
_ACROSS = _ALONG[:, ::-1] * [-1.0, 1.0]
_PARTS = np.linspace(0.1, 0.9, 7)
_WIDTHS = 12
_MOST_CAPSULES = 16

Layer = Annotated[int, Field(ge=1, le=32)]
Corner = tuple[Finite, Finite]


def layer_bits(layers: tuple[int, ...]) -> int:
    """A bit for each layer, the first one the lowest."""
    return sum(1 << (layer - 1) for layer in set(layers))


class Outline(Table):
    """A part of a positioner: a capsule or the convex hull of a polygon, fixed to one of the arms."""

    arm: Literal["alpha", "beta"]
    """x runs along the beta arm from the beta axis, or along the alpha arm from the alpha axis."""
    capsule_mm: tuple[Finite, Finite, Finite, Finite] | None = None
    """x and y of both ends of its centre line."""
    radius_mm: NotNegative = 0.0
    """Of the capsule; of a polygon: it is so much wider on all sides."""
    polygon_mm: tuple[Corner, ...] | None = None
    """x and y of its corners; the convex hull counts."""
    layers: Annotated[tuple[Layer, ...], Field(min_length=1)] = (1,)
    """Heights that it takes up, 1 to 32. Bodies without a common one cannot touch."""
    excess_mm: Positive = 0.1
    """So far the capsules that cover a polygon may stick out."""

    @model_validator(mode="after")
    def _one_of_two(self) -> Self:
        if (self.capsule_mm is None) == (self.polygon_mm is None):
            raise ValueError("a part needs capsule_mm or polygon_mm, one of the two")
        if self.capsule_mm is not None and self.radius_mm == 0.0:
            raise ValueError("radius_mm: a capsule needs one above 0")
        if self.polygon_mm is not None and _area_mm2(np.array(self.polygon_mm)) <= 0.0:
            raise ValueError("polygon_mm: at least three corners that do not lie on one line")
        return self

    @property
    def capsules_mm(self) -> Floats:
        """(k, 5) x0, y0, x1, y1, radius: what collides."""
        if self.capsule_mm is not None:
            return np.array([[*self.capsule_mm, self.radius_mm]])
        covers = _covered_once(self.polygon_mm or (), self.excess_mm).copy()
        covers[:, 4] += self.radius_mm
        return covers

    @property
    def far_mm(self) -> float:
        """The farthest point of the outline from the axis."""
        capsule = self.capsule_mm or ()
        corners = self.polygon_mm or (capsule[:2], capsule[2:])
        return max(math.hypot(*corner) for corner in corners) + self.radius_mm

    @property
    def reach_mm(self) -> float:
        """The farthest point of what covers it."""
        return self.far_mm + (self.excess_mm if self.polygon_mm is not None else 0.0)


class KeepOut(Table):
    """Where no arm may be: a line or a polygon's edge, as wide as a radius, and copies around the field."""

    line_mm: Annotated[tuple[Corner, ...], Field(min_length=1)] | None = None
    """x and y in the focal plane; one point: a disc."""
    polygon_mm: Annotated[tuple[Corner, ...], Field(min_length=3)] | None = None
    """x and y of its corners, one after the other; it need not be convex. What collides is its edge: an arm
    that begins outside cannot come in without it."""
    radius_mm: Positive
    copies: Annotated[int, Field(ge=1, le=1000)] = 1
    """By equal turns around the centre of the field, this one included."""
    layers: Annotated[tuple[Layer, ...], Field(min_length=1)] = tuple(range(1, 33))

    @model_validator(mode="after")
    def _one_of_two(self) -> Self:
        if (self.line_mm is None) == (self.polygon_mm is None):
            raise ValueError("a keep-out needs line_mm or polygon_mm, one of the two")
        return self

    @property
    def _points_mm(self) -> Array:
        return np.array([complex(*xy) for xy in self.line_mm or self.polygon_mm or ()])

    def turned(self, turn_rad: float) -> "KeepOut":
        """The same, turned about the centre of the field by `turn_rad`."""
        return self.moved(lambda points: points * np.exp(1j * turn_rad))

    def moved(self, to: Callable[[Array], Array]) -> "KeepOut":
        """The same with its points elsewhere: `to` takes them as complex numbers (n,) in mm."""
        name = "line_mm" if self.line_mm is not None else "polygon_mm"
        return self.model_copy(update={name: tuple((p.real, p.imag) for p in to(self._points_mm).tolist())})

    def _ends_mm(self) -> tuple[Array, Array]:
        """(k,) first and second ends of the lines of all copies, complex."""
        points = self._points_mm
        second = np.roll(points, -1) if self.polygon_mm is not None or len(points) == 1 else points[1:]
        turns = np.exp(2j * math.pi * np.arange(self.copies) / self.copies)[:, None]
        return (turns * points[: len(second)]).ravel(), (turns * second).ravel()

    def distance_mm(self, xy_mm: Floats) -> Floats:
        """(n,) mm from places (n, 2) in mm to the nearest copy; of a polygon 0 inside of it."""
        first, second = self._ends_mm()
        places = (xy_mm @ [1.0, 1.0j])[:, None]
        step, off = second - first, places - first
        length2 = np.maximum(np.abs(step) ** 2, 1e-12)
        along = np.clip(np.real(off * np.conj(step)) / length2, 0.0, 1.0)
        apart = np.abs(off - along * step).min(axis=1) - self.radius_mm
        if self.polygon_mm is None:
            return np.asarray(np.maximum(apart, 0.0))
        turns = np.angle((second - places) / np.where(off == 0.0, 1.0, -off))
        inside = np.abs(turns.reshape(len(places), self.copies, -1).sum(axis=2)).max(axis=1) > math.pi
        return np.asarray(np.where(inside, 0.0, np.maximum(apart, 0.0)))

    @property
    def capsules_mm(self) -> Floats:
        """(k, 5) x0, y0, x1, y1, radius of all copies."""
        first, second = self._ends_mm()
        radius = np.full(len(first), self.radius_mm)
        return np.column_stack([first.real, first.imag, second.real, second.imag, radius])


@cache
def _covered_once(polygon_mm: tuple[tuple[float, float], ...], excess_mm: float) -> Floats:
    """As `covered`: all arms of a plane have the same outlines, and they are asked for often."""
    return covered(np.array(polygon_mm), excess_mm)


def covered(polygon_mm: Floats, excess_mm: float) -> Floats:
    """(k, 5) capsules x0, y0, x1, y1, radius in mm that cover the convex hull of a polygon (n, 2) in mm.

    They stick out by no more than `excess_mm`. The hull is cut in two, and the worse piece again, where that
    helps most; each piece gets the capsule that sticks out least. What is inside is covered too, so what
    does not touch a capsule does not touch the hull.
    """
    return _covered(tuple(map(tuple, polygon_mm)), excess_mm).copy()


@cache
def _covered(corners: tuple[Corner, ...], excess_mm: float) -> Floats:
    points = np.array(corners)
    hull = points[ConvexHull(points).vertices]
    edges = np.roll(hull, -1, axis=0) - hull
    outwards = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.hypot(*edges.T)[:, None]
    sides = np.column_stack([outwards, (outwards * hull).sum(axis=1)])
    pieces = [(*_around(hull, sides), hull)]
    while max(piece[0] for piece in pieces) > excess_mm:
        if len(pieces) == _MOST_CAPSULES:
            raise ValueError(f"polygon_mm: {_MOST_CAPSULES} capsules stick out by more than {excess_mm} mm")
        worst = pieces.pop(max(range(len(pieces)), key=lambda k: pieces[k][0]))
        cuts = (_halves(worst[2], turn, part) for turn in _TURNS for part in _PARTS)
        tried = [[(*_around(half, sides), half) for half in both] for both in cuts]
        pieces += min(tried, key=lambda both: max(piece[0] for piece in both))
    return np.array([capsule for _, capsule, _ in pieces])


def _area_mm2(corners: Floats) -> float:
    if len(corners) < 3:
        return 0.0
    spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
    return float(spread[-1]) if spread[-1] > 1e-6 else 0.0


def _halves(hull: Floats, turn_rad: float, part: float) -> tuple[Floats, Floats]:
    """Both sides of a cut across a direction, so far along its width."""
    along = hull @ [math.cos(turn_rad), math.sin(turn_rad)]
    at = along.min() + part * np.ptp(along)
    ends = zip(hull, np.roll(hull, -1, axis=0), along, np.roll(along, -1), strict=True)
    cut = [[p + (q - p) * (at - a) / (b - a)] for p, q, a, b in ends if (a - at) * (b - at) < 0.0]
    return _in_turn(np.vstack([hull[along <= at], *cut])), _in_turn(np.vstack([hull[along >= at], *cut]))


def _in_turn(corners: Floats) -> Floats:
    """Corners of a convex polygon, one after the other around it."""
    off = corners - corners.mean(axis=0)
    return corners[np.argsort(np.arctan2(off[:, 1], off[:, 0]))]


def _around(corners: Floats, sides: Floats) -> tuple[float, Floats]:
    """By how much the capsule around corners sticks out that does so least, and the capsule.

    `sides` (m, 3): of the polygon, outward normals and how far the sides are from the origin. Tried are
    capsules in all of _TURNS, of many widths, with both ends of the line in the polygon: then no point is
    farther out than where an end is nearest to a side.
    """
    x, y = ((corners @ axes[..., None])[..., 0] for axes in (_ALONG, _ACROSS))
    middle = 0.5 * (y.min(axis=1) + y.max(axis=1))
    off = np.abs(y - middle[:, None])
    most = np.hypot(np.ptp(x, axis=1) / 2.0, off.max(axis=1))
    radii = np.linspace(off.max(axis=1), most + 1e-9, _WIDTHS, axis=1)
    reach = np.sqrt(np.maximum(radii[..., None] ** 2 - off[:, None] ** 2, 0.0))
    first, last = (x[:, None] + reach).min(axis=2), (x[:, None] - reach).max(axis=2)
    both = np.where(first <= last, 0.0, 0.5 * (last - first))
    beside = middle[:, None, None] * _ACROSS[:, None]
    ends = [at[..., None] * _ALONG[:, None] + beside for at in (first + both, last - both)]
    out = (np.maximum(*(end @ sides[:, :2].T for end in ends)) - sides[:, 2]).max(axis=2)
    excess = np.where(out <= 1e-9, out + radii, np.inf)
    best = np.unravel_index(excess.argmin(), excess.shape)
    return float(excess[best]), np.array([*ends[0][best], *ends[1][best], radii[best]])
