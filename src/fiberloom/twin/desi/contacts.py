"""Contacts in the twin's own truth: convex outlines along the true paths, without the planner's code.

A pair is looked at where it may meet. Within an interval no point of an arm moves farther than its way, so
the gap is never below (g0 + g1 - ways) / 2; intervals in which that does not rule out a contact are halved,
until the arms move less than 0.05 mm in one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.arms import CENTRE, L_ALPHA
from fiberloom.instruments.outlines import layer_bits
from fiberloom.twin.desi.units import DesiUnits
from fiberloom.typing import Flags, Floats, Ints

FINEST_MM = 0.05
"""Arms move less between the moments that are looked at, where they are near."""
SLOPE = 1.1
"""An arm turns at most so much for its gear: waves of the gear's error."""


@dataclass(frozen=True)
class Touching:
    """Two bodies overlap: when first, which row, and the other's; of an obstacle -1 - its number."""

    time_s: float
    unit: int
    other: int


@dataclass(frozen=True)
class Outlined:
    """A convex outline, fixed to one arm."""

    arm: int
    """0 theta, 1 phi."""
    corners_mm: Floats
    """(k, 2) in turn, in the frame of the arm."""
    radius_mm: float
    layers: int

    def placed(self, pivot: Floats, turn_rad: Floats) -> Floats:
        """(M, k) corners as complex numbers, mm, of arms that turn round pivots."""
        z = self.corners_mm[:, 0] + 1j * self.corners_mm[:, 1]
        out = pivot[:, None] + np.exp(1j * turn_rad)[:, None] * z
        return np.asarray(out)


def parts_of(plane: FocalPlane) -> list[Outlined]:
    """The polygons of the plane's arms; InputError where it has none."""
    outlines = plane.instrument.bodies.parts
    if any(part.polygon_mm is None for part in outlines) or not outlines:
        raise InputError(f"{plane.instrument.name}: bodies.parts must be polygons for this twin")
    return [
        Outlined(
            int(part.arm == "beta"), _hull(np.array(part.polygon_mm)), part.radius_mm, layer_bits(part.layers)
        )
        for part in outlines
    ]


def _hull(points: Floats) -> Floats:
    corners: Floats = points[ConvexHull(points).vertices]
    return corners


def separation_mm(first: Floats, second: Floats) -> Floats:
    """(M,) mm: largest gap between convex polygons (M, k) and (M, l), complex mm, along edges' normals.

    Above 0: they are apart, by so much at least; below: they overlap. Corners in counter-clockwise turn.
    """
    return np.asarray(np.maximum(_along_normals(first, second), _along_normals(second, first)))


def _along_normals(first: Floats, second: Floats) -> Floats:
    edges = np.roll(first, -1, axis=1) - first
    normal = -1j * edges / np.abs(edges)
    off = second[:, None, :] - first[:, :, None]
    gaps = np.real(off * np.conj(normal)[:, :, None]).min(axis=2)
    return np.asarray(gaps.max(axis=1))


def line_gap_mm(polygon: Floats, first: Floats, second: Floats) -> Floats:
    """(M,) mm from polygons (M, k) to lines between two points (M,), complex mm; below 0 where they meet."""
    ends = np.stack([first, second], axis=1)
    to_line = _to_segments(polygon, first[:, None], second[:, None]).min(axis=1)
    to_edge = _to_segments(ends[:, :, None], polygon[:, None], np.roll(polygon, -1, axis=1)[:, None])
    apart = np.minimum(to_line, to_edge.min(axis=(1, 2)))
    line = np.stack([first, second + 1e-9 * (first == second)], axis=1)
    return np.asarray(np.where(separation_mm(polygon, line) < 0.0, -apart, apart))


def _to_segments(point: Floats, start: Floats, end: Floats) -> Floats:
    along = end - start
    share = np.real((point - start) * np.conj(along)) / np.maximum(np.abs(along) ** 2, 1e-18)
    return np.asarray(np.abs(point - start - np.clip(share, 0.0, 1.0) * along))


class Motion(Protocol):
    """True motion: angles (M, 2) in deg of units at times in s, and the ways of their gears, (M, 2) deg."""

    @property
    def end_s(self) -> float:
        """When the last one has arrived."""
        ...

    def output_deg(self, unit: Ints, time_s: Floats) -> tuple[Floats, Floats]:
        """Of units (M,) at times (M,) in s."""
        ...


class ContactFinder:
    """Which bodies of a plane touch while its arms move."""

    def __init__(self, plane: FocalPlane, units: DesiUnits) -> None:
        self.parts, self._arms = parts_of(plane), units.arms
        self._centre = units.arms[:, CENTRE] @ np.array([1.0, 1.0j])
        own = [np.hypot(*part.corners_mm.T).max() + part.radius_mm for part in self.parts]
        far = [size for part, size in zip(self.parts, own, strict=True) if part.arm == 1]
        self._far_mm, self._phi_mm = max(own), max(far)
        """Of any part from its axis, and of those on phi."""
        self._reach_mm = float(units.arms[:, L_ALPHA].max() + self._phi_mm)
        self.obstacles = _obstacles(plane)
        tree = cKDTree(units.arms[:, :2])
        self.pairs = tree.query_pairs(2.0 * self._reach_mm, output_type="ndarray").astype(np.int64)
        self.fixed = self._near_obstacles()

    def find(self, motion: Motion) -> list[Touching]:
        """Pairs that come to overlap during a motion, each once, with the first moment found.

        Those that overlap before it begins are none: that was told when it came about.
        """
        units = [self._search(motion, self.pairs, self._pair_gap)]
        if len(self.fixed):
            units.append(self._search(motion, self.fixed, self._fixed_gap))
        found = [Touching(t, int(i), int(j)) for part in units for t, i, j in part]
        return sorted(found, key=lambda touch: touch.time_s)

    def _near_obstacles(self) -> Ints:
        """(Q, 2) rows, and -1 - index of obstacles that an arm may reach."""
        lines = self.obstacles
        first, second = lines[:, 0] + 1j * lines[:, 1], lines[:, 2] + 1j * lines[:, 3]
        far = _to_segments(self._centre[:, None], first[None], second[None]) - lines[:, 4]
        unit, obstacle = np.nonzero(far < max(self._reach_mm, self._far_mm))
        return np.column_stack([unit, -1 - obstacle])

    def _search(self, motion: Motion, pairs: Ints, gap) -> list[tuple[float, int, int]]:  # type: ignore[no-untyped-def]
        """First moments of contact by halving; `gap` of pairs (M, 2) at times (M,)."""
        first = np.full(len(pairs), np.inf)
        index = np.arange(len(pairs))
        early, late = np.zeros(len(pairs)), np.full(len(pairs), motion.end_s)
        before, after = gap(motion, pairs, early), gap(motion, pairs, late)
        apart = before[0] >= 0.0
        index, early, late = index[apart], early[apart], late[apart]
        before, after = (tuple(x[apart] for x in side) for side in (before, after))
        _note(first, index, late, after[0])
        while len(index):
            way = after[1] - before[1]
            open_ = (way > FINEST_MM) & (before[0] + after[0] < way) & (early < first[index])
            index, early, late = index[open_], early[open_], late[open_]
            before, after = (tuple(x[open_] for x in side) for side in (before, after))
            middle = 0.5 * (early + late)
            between = gap(motion, pairs[index], middle)
            _note(first, index, middle, between[0])
            index = np.concatenate([index, index])
            early, late = np.concatenate([early, middle]), np.concatenate([middle, late])
            before, after = (
                tuple(np.concatenate([a, b]) for a, b in zip(*sides, strict=True))
                for sides in ((before, between), (between, after))
            )
        hit = np.flatnonzero(np.isfinite(first))
        return [(float(first[k]), int(pairs[k, 0]), int(pairs[k, 1])) for k in hit]

    def _pose(self, motion: Motion, unit: Ints, time_s: Floats) -> tuple[list[Floats], Floats]:
        """Corners of all parts, and the way in mm that no point of the arm has exceeded."""
        angle, travelled = motion.output_deg(unit, time_s)
        arm, turn = self._arms[unit], np.deg2rad(angle)
        alpha = turn[:, 0] + arm[:, 3]
        beta = alpha + turn[:, 1] + arm[:, 4]
        elbow = self._centre[unit] + arm[:, 2] * np.exp(1j * alpha)
        placed = [
            part.placed(elbow, beta) if part.arm else part.placed(self._centre[unit], alpha)
            for part in self.parts
        ]
        turned = SLOPE * np.deg2rad(travelled)
        way = turned[:, 0] * max(self._reach_mm, self._far_mm) + turned[:, 1] * self._phi_mm
        return placed, way

    def _pair_gap(self, motion: Motion, pairs: Ints, time_s: Floats) -> tuple[Floats, Floats]:
        first, way = self._pose(motion, pairs[:, 0], time_s)
        second, other = self._pose(motion, pairs[:, 1], time_s)
        gap = np.full(len(pairs), np.inf)
        for a, one in zip(self.parts, first, strict=True):
            for b, two in zip(self.parts, second, strict=True):
                if a.layers & b.layers and (a.arm or b.arm):
                    gap = np.minimum(gap, separation_mm(one, two) - a.radius_mm - b.radius_mm)
        return gap, way + other

    def _fixed_gap(self, motion: Motion, pairs: Ints, time_s: Floats) -> tuple[Floats, Floats]:
        placed, way = self._pose(motion, pairs[:, 0], time_s)
        line = self.obstacles[-1 - pairs[:, 1]]
        first, second = line[:, 0] + 1j * line[:, 1], line[:, 2] + 1j * line[:, 3]
        gap = np.full(len(pairs), np.inf)
        for part, corners in zip(self.parts, placed, strict=True):
            meets = (line[:, 5].astype(np.int64) & part.layers) != 0
            apart = line_gap_mm(corners, first, second) - part.radius_mm - line[:, 4]
            gap = np.where(meets, np.minimum(gap, apart), gap)
        return gap, way


def _note(first: Floats, index: Ints, time_s: Floats, gap: Floats) -> None:
    hit: Flags = gap < 0.0
    np.minimum.at(first, index[hit], time_s[hit])


def _obstacles(plane: FocalPlane) -> Floats:
    """(K, 6) x0, y0, x1, y1, radius in mm, layers: fiducials, guide cameras, keep-outs."""
    every = float(layer_bits(tuple(range(1, 33))))
    discs = plane.fiducials[plane.fiducials[:, 2] > 0.0][:, [0, 1, 0, 1, 2]]  # no radius: at another height
    plain = np.vstack([discs, plane.guide_cameras.reshape(-1, 5)])
    rows = [np.column_stack([plain, np.full(len(plain), every)])]
    for keep_out in plane.instrument.bodies.keep_outs:
        lines = keep_out.capsules_mm
        rows.append(np.column_stack([lines, np.full(len(lines), float(layer_bits(keep_out.layers)))]))
    return np.vstack(rows)
