"""Can a positioner get from here to there at all? A flood of its two angles, without the planner's code.

The square of alpha and beta between the hard stops is cut into cells. In a cell no point of the arm is
farther than w = h (l_alpha + 2 far) from where it is in the cell's middle, h half a cell in rad. A cell is
shut if the arm in its middle overlaps a body by more than w: then it overlaps it everywhere in the cell. If
no chain of other cells, corners included, leads from the start to the goal, there is no way: a pocket,
proven. A cell is open if the arm in its middle is farther than w from all bodies. If a chain of open cells,
edge to edge, leads there, there is a way. Between both the cells are made smaller; only those that can be
come to and are not open are looked at again. At last they are made smaller still around one end alone: what
cannot leave its start is in a pocket; what cannot come to its goal from outside may be anywhere but there.

Where no pocket is shown so, the same is asked within the travel that a motion may use, which keeps
`STOP_ROOM_DEG` to the hard stops: nearer the firmware may refuse it, since it limits the angle of the motor.

Bodies are those that rest for good: fiducials and guide cameras. All positioners that can move are absent.
A positioner that is in a pocket itself can move within the pocket alone; it shuts a cell of another where
both overlap wherever in its pocket it is. Its places are halved again and again (`Places`): how near the
middle one is tells of those around it, and single places are looked at only where that is not enough.

At the end of a plan, one in a pocket is somewhere in it and all that arrive are at their goals. If it
overlaps one of these goals wherever in its pocket it is, they cannot all arrive (`meets_one`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.ndimage import label

from fiberloom.planning.bodies import STOP_ROOM_DEG
from fiberloom.typing import Flags, Floats, Ints

from .bodies import Bodies, between, to_segment

CELLS_DEG = (0.5, 0.25, 0.125)
"""The planner's own grid is nowhere finer than 1.46 deg."""
FINER_DEG = (1 / 16, 1 / 32, 1 / 64)
"""Around one end alone."""
AROUND_DEG = 10.0
"""So far around what is open there."""
MOST_AROUND = 1_000_000
"""Where that are more cells of the last of `CELLS_DEG` it is no pocket, and would take too much room."""
AT_ONCE = 100_000
"""So many cells at once."""
FEW = 16
"""So many places of one in a pocket are looked at one by one."""
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
    room_deg: float = 0.0
    """Kept to the hard stops."""


@dataclass(frozen=True)
class Found:
    """The answer for one positioner."""

    way: Way
    cell_deg: float
    pocket: Pocket | None = None
    room_deg: float = 0.0
    """Kept to the hard stops."""


def flood(
    bodies: Bodies,
    row: int,
    ends_deg: tuple[Floats, Floats],
    buffer_mm: float,
    pockets: Mapping[int, Pocket] | None = None,
) -> Found:
    """Whether a positioner gets from start to goal (2,) deg, all others absent but those in `pockets`.

    Between the hard stops; where that shows no pocket, as near to them as a motion may come.
    """
    for room_deg in (0.0, STOP_ROOM_DEG):
        found = _flood(bodies, row, ends_deg, buffer_mm, pockets or {}, room_deg)
        if found.way == Way.NONE:
            break
    return found


def _flood(
    bodies: Bodies,
    row: int,
    ends_deg: tuple[Floats, Floats],
    buffer_mm: float,
    pockets: Mapping[int, Pocket],
    room_deg: float,
) -> Found:
    limits_deg = bodies.stops_deg + np.array([room_deg, -room_deg])
    area = open_ = np.zeros((0, 0), dtype=bool)
    for cell_deg in CELLS_DEG:
        grid = _Grid(bodies, row, cell_deg, limits_deg)
        shut, open_ = grid.cells(buffer_mm, area, open_)
        first, last = (grid.cell_of(end) for end in ends_deg)
        near = [other for other in pockets.values() if grid.near(other, buffer_mm)]
        area = _area(~shut, first, CORNERS)
        for other in near:
            area = _area(grid.less(area, other, buffer_mm), first, CORNERS)
        if not area[last]:
            return Found(Way.NONE, cell_deg, grid.pocket(area, room_deg), room_deg)
        # where it meets none of the places of another is not asked: beside pockets only proofs count
        if not near and _area(open_, first, EDGES)[last]:
            return Found(Way.THERE, cell_deg, None, room_deg)
    start, goal = ends_deg
    if shut_in := _Window(grid, start, area, open_).found(goal, buffer_mm, room_deg):
        return shut_in
    if shut_in := _Window(grid, goal, area, open_).found(start, buffer_mm, room_deg):
        return replace(shut_in, pocket=None)  # it cannot come there, and may be anywhere else
    return Found(Way.UNKNOWN, CELLS_DEG[-1], None, room_deg)


def meets_one(pocket: Pocket, arms: tuple[Floats, Floats], buffer_mm: float) -> bool:
    """Whether one in a pocket, wherever there, overlaps one of these arms at rest (ends (n,) complex, mm)."""
    here = (end[:, None] for end in pocket.ends)
    return bool((between(*here, *arms).min(axis=1) < 2.0 * buffer_mm - pocket.within_mm).all())


def _area(free: Flags, first: tuple[int, int], structure: Ints) -> Flags:
    """The free cells that hang together with the first; none if that is not free."""
    areas, _ = label(free, structure=structure)
    return free & (areas == areas[first]) if free[first] else np.zeros_like(free)


class Places:
    """Places of a centre line, in halves down to a few, with how far all are from the middle one."""

    def __init__(self, r: Floats, s: Floats) -> None:
        middle = int(np.argmin(np.abs(r - r.mean()) + np.abs(s - s.mean())))
        self.r, self.s, self.at = r, s, (r[middle], s[middle])
        self.within_mm = float(np.maximum(np.abs(r - r[middle]), np.abs(s - s[middle])).max())
        self._halves: list[Places] = []

    @property
    def halves(self) -> list[Places]:
        """Of the places, along the coordinate in which they differ most; made when first asked for."""
        if not self._halves:
            coordinates = [part for end in (self.r, self.s) for part in (end.real, end.imag)]
            order = np.argsort(max(coordinates, key=np.ptp), kind="stable")
            self._halves = [Places(self.r[k], self.s[k]) for k in np.array_split(order, 2)]
        return self._halves

    def all_met(self, p: Floats, q: Floats, below_mm: float) -> Flags:
        """Which of the lines p to q (n,) are nearer than this to every place; below 0: none."""
        if len(self.r) <= FEW:
            return (between(p[:, None], q[:, None], self.r, self.s) < below_mm).all(axis=1)
        gap = between(p, q, *(np.array(end) for end in self.at))
        met = gap < below_mm
        doubtful = np.flatnonzero(met & (gap >= below_mm - self.within_mm))
        for half in self.halves if len(doubtful) else []:
            sure = half.all_met(p[doubtful], q[doubtful], below_mm)
            met[doubtful[~sure]] = False
            doubtful = doubtful[sure]
        return met


class _Grid:
    """Cells of alpha and beta of one positioner."""

    def __init__(self, bodies: Bodies, row: int, cell_deg: float, limits_deg: Floats) -> None:
        self.bodies, self.row, self.cell_deg = bodies, row, cell_deg
        self.low_deg = limits_deg[:, 0]
        numbers = np.ceil((limits_deg[:, 1] - self.low_deg) / cell_deg - 1e-9).astype(int)
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

    def cells(self, buffer_mm: float, area: Flags, open_: Flags) -> tuple[Flags, Flags]:
        """Which are shut by bodies at rest, and which are open to them.

        Of cells twice as wide `area` can be come to, and `open_` are open: what is not in the one is shut,
        what is in both is open. Empty: nothing is known.
        """
        shape = len(self.middles[0]), len(self.middles[1])
        asked, out = np.ones(shape, dtype=bool), np.zeros(shape, dtype=bool)
        if area.size:
            asked, out = self._halved(area), self._halved(area & open_)
        shut, places = ~asked, np.nonzero(asked & ~out)
        for k in range(0, len(places[0]), AT_ONCE):
            some = places[0][k : k + AT_ONCE], places[1][k : k + AT_ONCE]
            shut[some], out[some] = self._seen(*some, buffer_mm)
        return shut, out

    def _halved(self, cells: Flags) -> Flags:
        """In cells half as wide; the last ones may lie beyond the stops."""
        first, second = (len(middle) for middle in self.middles)
        return cells.repeat(2, axis=0).repeat(2, axis=1)[:first, :second]

    def _seen(self, first: Ints, second: Ints, buffer_mm: float) -> tuple[Flags, Flags]:
        p, q = self.bodies.lines(self.row, self.middles[0][first], self.middles[1][second])
        shut, open_ = np.zeros(p.shape, dtype=bool), np.ones(p.shape, dtype=bool)
        for k in self.bodies.near_obstacles(self.row, buffer_mm):
            x0, y0, x1, y1, radius = self.bodies.obstacles[k]
            r, s = np.array(complex(x0, y0)), np.array(complex(x1, y1))
            gap = (to_segment(r, p, q) if r == s else between(p, q, r, s)) - radius - buffer_mm
            shut |= gap < -self.within_mm
            open_ &= gap > self.within_mm
        return shut, open_

    def near(self, other: Pocket, buffer_mm: float) -> bool:
        """Can it touch the other at all?"""
        centres = self.bodies.centre[self.row], self.bodies.centre[other.row]
        reach = self.bodies.reach(self.row) + self.bodies.reach(other.row)
        return other.row != self.row and abs(centres[0] - centres[1]) < reach + 2.0 * buffer_mm

    def less(self, cells: Flags, other: Pocket, buffer_mm: float) -> Flags:
        """Without those in which it overlaps the other wherever that one is."""
        left, places = cells.copy(), Places(*other.ends)
        below_mm = 2.0 * buffer_mm - self.within_mm - other.within_mm
        found = np.nonzero(cells)
        for k in range(0, len(found[0]), AT_ONCE):
            first, second = (part[k : k + AT_ONCE] for part in found)
            p, q = self.bodies.lines(self.row, self.middles[0][first], self.middles[1][second])
            left[first, second] = ~places.all_met(p, q, below_mm)
        return left

    def pocket(self, cells: Flags, room_deg: float) -> Pocket | None:
        """Where it can be: these cells; None where there are none, as it overlaps a body from the start."""
        if not cells.any():
            return None
        first, second = np.nonzero(cells)
        ends = self.bodies.lines(self.row, self.middles[0][first], self.middles[1][second])
        return Pocket(self.row, ends, self.within_mm, room_deg)


class _Window:
    """A part of a grid: what is open around one end, and some cells around that."""

    def __init__(self, grid: _Grid, end_deg: Floats, area: Flags, open_: Flags) -> None:
        self.grid, self.end_deg = grid, end_deg
        here = grid.cell_of(end_deg)
        inside = _area(open_, here, EDGES)
        inside[here] = True
        cells = np.argwhere(inside)
        low, end = cells.min(axis=0), cells.max(axis=0) + 1
        around = round(AROUND_DEG / grid.cell_deg)
        low, end = np.maximum(low - around, 0), np.minimum(end + around, area.shape)
        box = tuple(slice(*both) for both in zip(low, end, strict=True))
        self.area, self.open_ = area[box], open_[box]
        self.limits_deg = (grid.low_deg + grid.cell_deg * np.array([low, end])).T
        self.leads_out = np.array([low > 0, end < area.shape])

    def found(self, other_deg: Floats, buffer_mm: float, room_deg: float) -> Found | None:
        """That nothing leads from its end out of it, or to the other one; None: that is not shown."""
        area, open_ = self.area, self.open_
        for cell_deg in FINER_DEG if area.size <= MOST_AROUND else ():
            fine = _Grid(self.grid.bodies, self.grid.row, cell_deg, self.limits_deg)
            shut, open_ = fine.cells(buffer_mm, area, open_)
            area = _area(~shut, fine.cell_of(self.end_deg), CORNERS)
            # of another end outside it is the nearest cell
            if not self._leaves(area) and not area[fine.cell_of(other_deg)]:
                return Found(Way.NONE, cell_deg, self._pocket(area, room_deg), room_deg)
        return None

    def _leaves(self, area: Flags) -> bool:
        """Whether a border of it that is none of the whole grid is reached."""
        borders = np.array([[area[0].any(), area[:, 0].any()], [area[-1].any(), area[:, -1].any()]])
        return bool((borders & self.leads_out).any())

    def _pocket(self, area: Flags, room_deg: float) -> Pocket | None:
        """In the wider cells of the grid."""
        n = len(area) // len(self.area)
        wide = area.reshape(len(self.area), n, -1, n).any(axis=(1, 3))
        cells = _Grid(self.grid.bodies, self.grid.row, self.grid.cell_deg, self.limits_deg)
        return cells.pocket(wide, room_deg)
