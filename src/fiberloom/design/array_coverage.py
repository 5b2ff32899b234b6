"""Coverage of a whole focal plane: its edge, obstacles and units that are broken."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints

STEPS_PER_PITCH = 12
MOST_POINTS = 400_000


@dataclass(frozen=True)
class ArrayCoverage:
    """Fibres that reach the points of a grid between the outermost positioners."""

    xy_mm: Floats
    """(n, 2) of the grid."""
    number: Ints
    """(n,) fibres that reach each."""
    blocked: Flags
    """(n,) no fibre can be there: a fiducial or a guide camera is in the way of every arm."""
    step_mm: float

    @property
    def covered(self) -> float:
        """Share of the points that a fibre reaches, 0 to 1."""
        return float((self.number > 0).mean())

    @property
    def hole_mm2(self) -> float:
        """Area without a fibre, obstacles included."""
        return float((self.number == 0).sum()) * self.step_mm**2


def broken_plane(plane: FocalPlane, n: int, seed: int) -> FocalPlane:
    """The same with `n` more units offline, drawn by `seed`; their bodies stay where they are."""
    working = np.flatnonzero(~plane.offline)
    if not 0 <= n < len(working):
        raise InputError(f"--broken {n}: 0 to {len(working) - 1} of the {len(working)} that work")
    offline = plane.offline.copy()
    offline[np.random.default_rng(seed).choice(working, n, replace=False)] = True
    return replace(plane, offline=offline)


def array_coverage(plane: FocalPlane, fibre: str) -> ArrayCoverage:
    """Counts, within the ranges of the axes, on a grid of a twelfth of the pitch or as fine as is affordable.

    Raises
    ------
    InputError
        Fewer than three positioners, which enclose no area.
    """
    centres = plane.centres_mm
    if len(centres) < 3:
        raise InputError(f"coverage of an array: {len(centres)} positioners enclose no area; 3 at least")
    xy_mm, step_mm = _grid(centres, plane.instrument.layout.pitch_mm / STEPS_PER_PITCH)
    blocked = _blocked(plane, xy_mm)
    number = _count(plane, fibre, xy_mm)
    number[blocked] = 0
    return ArrayCoverage(xy_mm, number, blocked, step_mm)


def _grid(centres: Floats, step_mm: float) -> tuple[Floats, float]:
    low, high = centres.min(axis=0), centres.max(axis=0)
    step_mm = max(step_mm, float(np.sqrt(np.prod(high - low) / MOST_POINTS)))
    x, y = (np.arange(a, b, step_mm) for a, b in zip(low, high, strict=True))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return grid[Delaunay(centres).find_simplex(grid) >= 0], step_mm


def _count(plane: FocalPlane, fibre: str, xy_mm: Floats) -> Ints:
    tip = plane.points[fibre]
    reach_mm = plane.l_alpha_mm + np.hypot(*tip.T)
    working = np.flatnonzero(~plane.offline & np.isfinite(reach_mm))
    number = np.zeros(len(xy_mm), dtype=np.int64)
    near = cKDTree(xy_mm).query_ball_point(plane.centres_mm[working], reach_mm[working])
    for row, points in zip(working, near, strict=True):
        rows = np.asarray(points, dtype=np.int64)
        number[rows] += plane.inverse(xy_mm[rows], fibre, np.full(len(rows), row)).reachable
    return number


def _blocked(plane: FocalPlane, xy_mm: Floats) -> Flags:
    """Points whose fibre would have its arm in a fiducial or a guide camera, wherever it came from."""
    buffer_mm = plane.instrument.bodies.collision_buffer_mm
    blocked = np.zeros(len(xy_mm), dtype=bool)
    for x, y, radius in plane.fiducials:
        blocked |= np.hypot(xy_mm[:, 0] - x, xy_mm[:, 1] - y) < radius + buffer_mm
    for camera in plane.guide_cameras:
        blocked |= _from_segment_mm(xy_mm, camera[:2], camera[2:4]) < camera[4] + buffer_mm
    return blocked


def _from_segment_mm(xy_mm: Floats, start: Floats, end: Floats) -> Floats:
    way = end - start
    along = ((xy_mm - start) @ way / max(float(way @ way), 1e-12)).clip(0.0, 1.0)
    distance: Floats = np.linalg.norm(xy_mm - start - along[:, None] * way, axis=1)
    return distance
