"""Can a positioner get from here to there at all? A flood of its two angles, without the planner's code.

The square of alpha and beta between the hard stops is cut into cells. In a cell no point of the arm is
farther than w = h (l_alpha + 2 far) from where it is in the cell's middle, h half a cell in rad. A cell is
shut if the arm in its middle overlaps a body by more than w: then it overlaps it everywhere in the cell. If
no chain of other cells, corners included, leads from the start to the goal, there is no way: a pocket,
proven. A cell is open if the arm in its middle is farther than w from all bodies. If a chain of open cells,
edge to edge, leads there, there is a way. Between both the cells are made smaller.

Bodies are those that rest for good: fiducials and guide cameras. All positioners that can move are absent.
A positioner that is in a pocket itself can move within the pocket alone; it shuts a cell of another where
both overlap wherever in its pocket it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.ndimage import label

from fiberloom.typing import Flags, Floats

from .bodies import Bodies, between, to_segment

CELLS_DEG = (0.5, 0.25, 0.125)
"""The planner's own grid is nowhere finer than 1.46 deg."""
BLOCK = 128
"""So many rows of alpha at once: a gigabyte otherwise."""
CORNERS, EDGES = np.ones((3, 3)), np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]])


class Way(StrEnum):
    """What a flood shows."""

    THERE = "a way"
    NONE = "no way"
    UNKNOWN = "not decided"


@dataclass(frozen=True)
class Pocket:
    """Where a positioner that is in a pocket can be."""

    row: int
    ends: tuple[Floats, Floats]
    """Both ends of its centre line (complex, mm) in the middle of each of its cells."""
    within_mm: float
    """w: so far its arm is at most from there."""


@dataclass(frozen=True)
class Found:
    """The answer for one positioner."""

    way: Way
    cell_deg: float
    pocket: Pocket | None = None


def flood(
    bodies: Bodies,
    row: int,
    ends_deg: tuple[Floats, Floats],
    buffer_mm: float,
    pockets: Mapping[int, Pocket] | None = None,
) -> Found:
    """Whether a positioner gets from start to goal (2,) deg, all others absent but those in `pockets`."""
    for cell_deg in CELLS_DEG:
        grid = _Grid(bodies, row, cell_deg)
        shut, open_ = grid.cells(buffer_mm, pockets or {})
        first, last = (grid.cell_of(end) for end in ends_deg)
        areas, _ = label(~shut, structure=CORNERS)
        if areas[first] != areas[last] or shut[first] or shut[last]:
            return Found(Way.NONE, cell_deg, grid.pocket(areas == areas[first]) if not shut[first] else None)
        areas, _ = label(open_, structure=EDGES)
        if areas[first] and areas[first] == areas[last]:
            return Found(Way.THERE, cell_deg)
    return Found(Way.UNKNOWN, CELLS_DEG[-1])


class _Grid:
    """Cells of alpha and beta of one positioner."""

    def __init__(self, bodies: Bodies, row: int, cell_deg: float) -> None:
        self.bodies, self.row, self.cell_deg = bodies, row, cell_deg
        self.low_deg = bodies.stops_deg[:, 0]
        numbers = np.ceil((bodies.stops_deg[:, 1] - self.low_deg) / cell_deg - 1e-9).astype(int)
        self.middles = [
            np.radians(low + (np.arange(n) + 0.5) * cell_deg)
            for low, n in zip(self.low_deg, numbers, strict=True)
        ]
        half = np.radians(cell_deg / 2)
        self.within_mm = float(half * (bodies.l_alpha[row] + 2.0 * bodies.far))

    def cell_of(self, angles_deg: Floats) -> tuple[int, int]:
        """The cell of alpha and beta; the last one where they lie on the upper stop or beyond."""
        cells = np.floor((np.asarray(angles_deg) - self.low_deg) / self.cell_deg).astype(int)
        first, second = np.clip(cells, 0, [len(middle) - 1 for middle in self.middles])
        return int(first), int(second)

    def cells(self, buffer_mm: float, pockets: Mapping[int, Pocket]) -> tuple[Flags, Flags]:
        """Which are shut, and which are open."""
        alpha, beta = self.middles
        blocks = [alpha[k : k + BLOCK] for k in range(0, len(alpha), BLOCK)]
        found = [self._block(block[:, None], beta[None], buffer_mm, pockets) for block in blocks]
        shut, open_ = (np.concatenate(part) for part in zip(*found, strict=True))
        return shut, open_

    def _block(
        self, alpha: Floats, beta: Floats, buffer_mm: float, pockets: Mapping[int, Pocket]
    ) -> tuple[Flags, Flags]:
        p, q = np.broadcast_arrays(*self.bodies.lines(self.row, alpha, beta))
        shut, open_ = np.zeros(p.shape, dtype=bool), np.ones(p.shape, dtype=bool)
        for k in self.bodies.near_obstacles(self.row, buffer_mm):
            x0, y0, x1, y1, radius = self.bodies.obstacles[k]
            r, s = np.array(complex(x0, y0)), np.array(complex(x1, y1))
            gap = (to_segment(r, p, q) if r == s else between(p, q, r, s)) - radius - buffer_mm
            shut |= gap < -self.within_mm
            open_ &= gap > self.within_mm
        for other in pockets.values():
            if self._near(other, buffer_mm):
                shut |= self._always_met(other, p, q, buffer_mm)
                open_[:] = False  # where it meets none of its places is not asked: only proofs count
        return shut, open_

    def _near(self, other: Pocket, buffer_mm: float) -> bool:
        centres = self.bodies.centre[self.row], self.bodies.centre[other.row]
        reach = self.bodies.reach(self.row) + self.bodies.reach(other.row)
        return other.row != self.row and abs(centres[0] - centres[1]) < reach + 2.0 * buffer_mm

    def _always_met(self, other: Pocket, p: Floats, q: Floats, buffer_mm: float) -> Flags:
        """Cells in which it overlaps the other wherever that one is."""
        p, q, always = p.ravel(), q.ravel(), np.ones(p.shape, dtype=bool).ravel()
        slack = self.within_mm + other.within_mm
        for r, s in zip(*other.ends, strict=True):
            left = np.flatnonzero(always)
            if not len(left):
                break
            gap = between(p[left], q[left], np.array(r), np.array(s)) - 2.0 * buffer_mm
            always[left] = gap < -slack
        return always.reshape(-1, len(self.middles[1]))

    def pocket(self, cells: Flags) -> Pocket:
        """Where it can be: these cells."""
        first, second = np.nonzero(cells)
        ends = self.bodies.lines(self.row, self.middles[0][first], self.middles[1][second])
        return Pocket(self.row, ends, self.within_mm)
