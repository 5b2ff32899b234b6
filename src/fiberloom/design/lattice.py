"""An endless hexagonal lattice of equal positioners: how many fibres reach a point."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from fiberloom._core import geometry
from fiberloom.errors import InputError
from fiberloom.instruments import Instrument
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad

SQRT_3_2 = math.sqrt(3.0) / 2.0
MOST_UNITS_AT_POINT = 400
"""Beyond this the arms are too long for the pitch to be meant."""


@dataclass(frozen=True)
class Pattern:
    """Which positioners of a lattice carry a fibre: those with (q + slope r) mod period in `carried`.

    q counts steps along a row, r rows. With `staggered`, r counts pairs of rows: every second along rows
    that are shifted against each other is Pattern(2, 1, (0,), True).
    """

    period: int = 1
    slope: int = 0
    carried: tuple[int, ...] = (0,)
    staggered: bool = False

    @property
    def share(self) -> float:
        """Of the positioners, 0 to 1."""
        return len(self.carried) / self.period

    def carries(self, q: Ints, r: Ints) -> Flags:
        """Do units at lattice steps q and r (any shape, alike) carry a fibre?"""
        rows = r // 2 if self.staggered else r
        found: Flags = np.isin((q + self.slope * rows) % self.period, self.carried)
        return found


EVERY = Pattern()


@dataclass(frozen=True)
class Lattice:
    """Equal positioners in every hole of an endless hexagonal lattice.

    Raises
    ------
    InputError
        A length that is not above 0, or arms so long that more than 400 units reach a point.
    """

    l_alpha_mm: float
    l_beta_mm: float
    """From the beta axis to the fibre."""
    pitch_mm: float
    alpha_range_deg: tuple[float, float] = (0.0, 360.0)
    beta_range_deg: tuple[float, float] = (0.0, 180.0)
    """Of the fibre: 0 is stretched."""

    def __post_init__(self) -> None:
        for name in ("l_alpha_mm", "l_beta_mm", "pitch_mm"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} {getattr(self, name):g}: must be a length above 0")
        if self.mean > MOST_UNITS_AT_POINT:
            raise InputError(
                f"arms of {self.l_alpha_mm:g} and {self.l_beta_mm:g} mm at a pitch of {self.pitch_mm:g} mm: "
                f"{self.mean:.0f} units reach a point; make the arms shorter or the pitch wider"
            )

    @classmethod
    def of(cls, instrument: Instrument, fibre: str) -> Lattice:
        """The lattice of an instrument for one of its fibres; offsets across the arm turn the beta axis."""
        points = instrument.positioner.points
        if fibre not in points:
            raise InputError(f"fibre {fibre}: {instrument.name} has {', '.join(points)}")
        point = points[fibre]
        if point.x_mm == point.y_mm == 0.0:
            raise InputError(
                f"{instrument.name}: fibre {fibre} lies on the beta axis; give its x_mm a length"
            )
        turn_deg = math.degrees(math.atan2(point.y_mm, point.x_mm))
        low, high = instrument.beta.target_range_deg
        return cls(
            instrument.positioner.l_alpha_mm,
            math.hypot(point.x_mm, point.y_mm),
            instrument.layout.pitch_mm,
            instrument.alpha.target_range_deg,
            (low + turn_deg, high + turn_deg),
        )

    @property
    def reach_mm(self) -> float:
        """Of stretched arms."""
        return self.l_alpha_mm + self.l_beta_mm

    @property
    def hole_mm(self) -> float:
        """Of folded arms: nearer to its centre a unit does not reach."""
        return abs(self.l_alpha_mm - self.l_beta_mm)

    @property
    def mean(self) -> float:
        """Mean number of fibres at a point, dimensionless, of areas alone; axes turn freely."""
        annulus_mm2 = math.pi * (self.reach_mm**2 - self.hole_mm**2)
        return annulus_mm2 / (SQRT_3_2 * self.pitch_mm**2)

    def steps(self, beyond_mm: float = 0.0) -> tuple[Ints, Ints]:
        """Lattice steps q and r of all units that may reach a point of the cell at the origin."""
        most = math.ceil((self.reach_mm + beyond_mm) / (SQRT_3_2 * self.pitch_mm)) + 2
        around = np.arange(-most, most + 1)
        q, r = np.repeat(around, len(around)), np.tile(around, len(around))
        far_mm = np.linalg.norm(self.centres_mm(q, r), axis=1)
        near = far_mm <= self.reach_mm + beyond_mm + 2.0 * self.pitch_mm
        return q[near], r[near]

    def centres_mm(self, q: Ints, r: Ints) -> Floats:
        """(n, 2) mm of lattice steps (n,)."""
        return self.pitch_mm * np.column_stack([q + 0.5 * r, SQRT_3_2 * r])

    def in_annulus(self, xy_mm: Floats) -> Flags:
        """(n,) are points (n, 2) about the unit's centre in reach, if both axes turn freely?"""
        far_mm = np.hypot(*xy_mm.T)
        within: Flags = (far_mm <= self.reach_mm) & (far_mm >= self.hole_mm)
        return within

    def in_ranges(self, xy_mm: Floats) -> Flags:
        """(n,) as `in_annulus`, within the ranges of both axes (Kronig 2020, Eq. 2)."""
        n = len(xy_mm)
        arms = np.tile([0.0, 0.0, self.l_alpha_mm, 0.0, 0.0], (n, 1))
        point = np.tile([self.l_beta_mm, 0.0], (n, 1))
        limits = deg_to_rad([self.alpha_range_deg, self.beta_range_deg])
        _, number, _ = geometry.inverse(arms, point, np.ascontiguousarray(xy_mm), limits)
        return np.asarray(number) > 0

    def count(self, xy_mm: Floats, pattern: Pattern = EVERY, free: bool = True) -> Ints:
        """(n,) fibres that reach points (n, 2) of the lattice; `free`: axes turn without limits."""
        row = np.floor(xy_mm[:, 1] / (SQRT_3_2 * self.pitch_mm)).astype(np.int64)
        column = np.floor(xy_mm[:, 0] / self.pitch_mm - 0.5 * row).astype(np.int64)
        local_mm = xy_mm - self.centres_mm(column, row)
        number = np.zeros(len(xy_mm), dtype=np.int64)
        for q, r in zip(*self.steps(), strict=True):
            offset_mm = local_mm - self.centres_mm(np.array([q]), np.array([r]))
            near = np.flatnonzero(self.in_annulus(offset_mm) & pattern.carries(column + q, row + r))
            number[near] += True if free else self.in_ranges(offset_mm[near])
        return number

    def gap_mm(self, xy_mm: Floats) -> Floats:
        """(n,) how far points (n, 2) of the cell at the origin are out of reach of all units; 0: reached."""
        centres = self.centres_mm(*self.steps())
        far_mm = np.linalg.norm(xy_mm[:, None] - centres[None], axis=2)
        gap: Floats = np.maximum(far_mm - self.reach_mm, self.hole_mm - far_mm).min(axis=1).clip(min=0.0)
        return gap

    def random_points_mm(self, n: int, seed: int, cells: int = 1) -> Floats:
        """(n, 2) points, even over `cells` times `cells` cells."""
        u, v = np.random.default_rng(seed).uniform(0.0, cells, (2, n))
        return self.pitch_mm * np.column_stack([u + 0.5 * v, SQRT_3_2 * v])

    def symmetric_points_mm(self) -> Floats:
        """(3, 2) a centre, the middle of two centres, the middle of three: the worst holes are there."""
        p = self.pitch_mm
        return np.array([[0.0, 0.0], [0.5 * p, 0.0], [0.5 * p, p / math.sqrt(12.0)]])

    def face_points_mm(self) -> Floats:
        """(n, 2) points in every region between the edges of all annuli in one cell, however small.

        The symmetric points come first. A region has a corner where two circles meet; a point is taken in
        each of the four directions there.
        """
        centres = self.centres_mm(*self.steps())
        radii = [x for x in (self.reach_mm, self.hole_mm) if x > 1e-9]
        circles = [(c, radius) for c in centres for radius in radii]
        cell_mm = 0.6 * self.pitch_mm  # its farthest point is at 0.58
        near = [(c, rad) for c, rad in circles if abs(np.hypot(*c) - rad) <= cell_mm]
        corners = [p for a, b in combinations(near, 2) for p in _corners(*a, *b)]
        beside = np.array(corners).reshape(-1, 2)
        in_cell = np.linalg.norm(beside, axis=1) <= cell_mm
        return np.concatenate([self.symmetric_points_mm(), beside[in_cell]])

    def changed(self, **lengths: float) -> Lattice:
        """The same with other lengths."""
        changes: dict[str, Any] = dict(lengths)
        return replace(self, **changes)


_BESIDE_MM = 1e-6
"""From a corner to the points in the regions around it."""


def _corners(c1: Floats, r1: float, c2: Floats, r2: float) -> list[Floats]:
    """Points beside the two corners where two circles cross: four each."""
    way = c2 - c1
    d = float(np.hypot(*way))
    if d < 1e-9 or d > r1 + r2 or d < abs(r1 - r2):
        return []
    along = (d * d + r1 * r1 - r2 * r2) / (2.0 * d)
    across = math.sqrt(max(r1 * r1 - along * along, 0.0))
    if across < 1e-3:  # they only touch: no region between them larger than a micrometre
        return []
    normal = np.array([-way[1], way[0]]) / d
    found = []
    for side in (-1.0, 1.0):
        corner = c1 + along * way / d + side * across * normal
        outward = np.array([(corner - c1) / r1, (corner - c2) / r2])
        basis = np.linalg.inv(outward)
        basis /= np.linalg.norm(basis, axis=0).max()
        found += [corner + _BESIDE_MM * (s * basis[:, 0] + t * basis[:, 1]) for s in (-1, 1) for t in (-1, 1)]
    return found
