"""How many fibres reach each point of a focal plane, where holes are, and what fills them.

Of an endless lattice; and of a whole array, with its edge, obstacles and units that are broken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from fiberloom.design.lattice import EVERY, Lattice, Pattern
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints

POINTS = 100_000
TRIED = 4000
"""Points on which patterns are compared before the best is counted with all."""
MOST_PERIOD = 12
STEPS_PER_PITCH = 12
MOST_POINTS = 400_000


@dataclass(frozen=True)
class Coverage:
    """Of an endless lattice of equal positioners."""

    at_least: Floats
    """(5,) share of the plane that at least 0, 1, 2, 3, 4 fibres reach, within the ranges of the axes."""
    mean: float
    """Fibres at a point, within the ranges."""
    mean_exact: float
    """By areas, axes without limits."""
    least: int
    """Fewest fibres at any point, found exactly (holes of micrometres too), axes without limits."""
    most: int
    """Most in a region, likewise; more may meet in a point."""
    hole_um: float
    """How far the worst point lies out of reach of every arm, units all with a fibre; 0: no hole."""
    standard_error: float
    """Of the shares, at most."""


def coverage(lattice: Lattice, pattern: Pattern = EVERY, n: int = POINTS, seed: int = 0) -> Coverage:
    """Counts on `n` random points drawn by `seed`, and exactly on the corners of the `lattice`.

    A `pattern` of every unit has least and most by exact search; another one by the same points, in all cells
    of its period.
    """
    cells = 2 * pattern.period
    number = lattice.count(lattice.random_points_mm(n, seed, cells), pattern, free=False)
    faces = lattice.face_points_mm()
    at_corners = lattice.count(_in_all_cells(lattice, faces, pattern), pattern).reshape(-1, len(faces))
    return Coverage(
        at_least=np.array([(number >= k).mean() for k in range(5)]),
        mean=float(number.mean()),
        mean_exact=lattice.mean * pattern.share,
        least=int(at_corners.min()),
        most=int(at_corners[:, 3:].max(initial=1)),  # no corner: units that share nothing
        hole_um=1e3 * float(lattice.gap_mm(lattice.symmetric_points_mm()).max()),
        standard_error=0.5 / n**0.5,
    )


def _in_all_cells(lattice: Lattice, xy_mm: Floats, pattern: Pattern) -> Floats:
    """Points of one cell, again in each cell of the pattern."""
    steps = np.arange(2 * pattern.period if pattern.period > 1 else 1)
    q, r = (a.ravel() for a in np.meshgrid(steps, steps))
    shifted: Floats = (xy_mm[None] + lattice.centres_mm(q, r)[:, None]).reshape(-1, 2)
    return shifted


def covers(lattice: Lattice) -> bool:
    """Does a fibre reach every point of the `lattice`, to the last micrometre, if all units have one?"""
    return bool(lattice.count(lattice.face_points_mm()).min() > 0)


@dataclass(frozen=True)
class Filling:
    """A change of one length that closes all holes."""

    length: str
    """Which one, as a field of `Lattice`."""
    from_mm: float
    to_mm: float


def fillings(lattice: Lattice) -> list[Filling]:
    """What closes the holes of a `lattice`: a smaller pitch, or a longer arm; the least change of each
    that does.

    Empty where there is no hole. Changes of more than a quarter are not looked for.
    """
    if covers(lattice):
        return []
    found = []
    for length, sense in (("pitch_mm", -1.0), ("l_alpha_mm", 1.0), ("l_beta_mm", 1.0)):
        start = getattr(lattice, length)
        change = _least_change(partial(_closes, lattice, length, sense))
        if change is not None:
            found.append(Filling(length, start, start * (1.0 + sense * change)))
    return found


def _closes(lattice: Lattice, length: str, sense: float, share: float) -> bool:
    """Whether there is no hole when one length is changed by a share."""
    return covers(lattice.changed(**{length: getattr(lattice, length) * (1.0 + sense * share)}))


def _least_change(holds: Callable[[float], bool]) -> float | None:
    """The least share up to 0.25 from which something holds, to 1e-6; None: it does not."""
    shares = np.geomspace(1e-5, 0.25, 12)
    first = next((k for k, share in enumerate(shares) if holds(float(share))), None)
    if first is None:
        return None
    low, high = (0.0 if first == 0 else float(shares[first - 1])), float(shares[first])
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def patterns(carried: int, period: int) -> Iterator[Pattern]:
    """All patterns in which `carried` of `period` units have a fibre, the same from row to row or staggered.

    Raises
    ------
    InputError
        Shares that are none, or a period above 12.
    """
    if not 1 <= carried <= period <= MOST_PERIOD:
        raise InputError(
            f"--share {carried}/{period}: so many of so many units, at most {MOST_PERIOD}, as in 3/5"
        )
    for others in combinations(range(1, period), carried - 1):
        for slope in range(period):
            yield Pattern(period, slope, (0, *others))
        yield Pattern(period, 1, (0, *others), staggered=True)


def best_pattern(lattice: Lattice, carried: int, period: int, seed: int = 0) -> Pattern:
    """The pattern that leaves the least of the plane without a fibre, then the least with only one.

    `carried` of `period` units of the `lattice` have a fibre; `seed` of the points that are counted.
    """
    all_patterns = list(patterns(carried, period))
    points = lattice.random_points_mm(TRIED, seed, 2 * period)
    counts = [lattice.count(points, pattern) for pattern in all_patterns]
    score = [((c >= 1).mean(), (c >= 2).mean()) for c in counts]
    return all_patterns[max(range(len(score)), key=lambda k: score[k])]


# a whole array


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
