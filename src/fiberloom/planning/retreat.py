"""The way of one positioner out of the bodies that it overlaps, all others at rest.

Its two angles are laid out as a square grid around where it is. A step between neighbours of the grid is
allowed if the gap to each body that it overlaps grows by at least a given slope, and the gap to every other
body stays. Whether a step is allowed does not depend on the way to it, so the shortest way is found by a
flood from the start.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fiberloom.planning.overlaps import TOUCHING_MM, Surroundings
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import MM_PER_UM, deg_to_rad, rad_to_deg

CLEAR_MM = 0.003
"""Kept to bodies that are not overlapped: more than a gap can fall within a step of the grid."""

DIRECTIONS = np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b])
_SAMPLES = 8
"""In a step, when a way that was found is looked at again."""
_LOOKS = 12
_GAIN_DEG = 2.0
_ROOM_MM, _ROOM_GAIN_MM = 5.0, 0.1
"""Of one that makes room: what is enough, and what is worth a motion."""
_FALL_MM = 0.5 * MM_PER_UM
"""Half of what the verifier lets a gap fall that shall only grow."""


@dataclass(frozen=True)
class SearchWindow:
    """Where a way is looked for."""

    step_deg: float
    half_deg: float
    slope_mm_deg: float
    """By how much each gap must grow, at least, in a degree of the grid."""


@dataclass(frozen=True)
class Retreat:
    """A way of one positioner, and what it is good for."""

    row: int
    points_deg: Floats
    """(m, 2) from where it is; neighbours differ by at most `step_deg` on each axis."""
    step_deg: float
    free: bool
    """It overlaps nothing at the end."""

    @property
    def steps(self) -> int:
        """How many steps of the grid."""
        return len(self.points_deg) - 1

    @property
    def travel_deg(self) -> float:
        """The larger of the ways of the two axes."""
        return float(np.abs(np.diff(self.points_deg, axis=0)).sum(axis=0).max())


def find_retreat(
    around: Surroundings,
    here_rad: Floats,
    row: int,
    travel_rad: Floats,
    window: SearchWindow,
    margin_mm: float,
) -> Retreat | None:
    """The shortest way of a positioner that frees it of all that it overlaps.

    Where there is none, the way that gains most; None if nothing is gained.

    Parameters
    ----------
    around : Surroundings
        The bodies of N positioners.
    here_rad : (N, 2)
        Where they are, rad.
    row : int
        The one that moves.
    travel_rad : (2, 2)
        [[alpha_min, alpha_max], [beta_min, beta_max]], rad.
    window : SearchWindow
        Step and half width, deg; least slope of the gaps, mm per deg.
    margin_mm : float
        Kept at the end to what was overlapped.
    """
    return _Flood(around, here_rad, row, travel_rad, window).way(margin_mm)


def find_way_towards(
    around: Surroundings,
    here_rad: Floats,
    row: int,
    goal_rad: Floats,
    travel_rad: Floats,
    window: SearchWindow,
) -> Retreat | None:
    """The way of a positioner that overlaps nothing to the place nearest to a goal.

    For knots that are too narrow for the grid of `plan`. None if it gets no nearer by 2 deg.

    Parameters
    ----------
    around : Surroundings
        The bodies of N positioners.
    here_rad : (N, 2)
        Where they are, rad.
    row : int
        The one that moves, all others at rest.
    goal_rad : (2,)
        Where it shall go, rad.
    travel_rad : (2, 2)
        [[alpha_min, alpha_max], [beta_min, beta_max]], rad.
    window : SearchWindow
        Step and half width, deg.
    """
    return _Flood(around, here_rad, row, travel_rad, window).towards(goal_rad)


def find_room(
    around: Surroundings,
    here_rad: Floats,
    row: int,
    tangled: Ints,
    travel_rad: Floats,
    window: SearchWindow,
) -> Retreat | None:
    """The way of a positioner that overlaps nothing out of the way of others that do.

    To the place nearest to where it is at which the least of its gaps to them is 5 mm, or else as large as it
    can be. None if that gap grows by less than 0.1 mm.

    Parameters
    ----------
    around : Surroundings
        The bodies of N positioners.
    here_rad : (N, 2)
        Where they are, rad.
    row : int
        The one that moves, all others at rest.
    tangled : (k,)
        Rows of those that need room.
    travel_rad : (2, 2)
        [[alpha_min, alpha_max], [beta_min, beta_max]], rad.
    window : SearchWindow
        Step and half width, deg.
    """
    return _Flood(around, here_rad, row, travel_rad, window).away_from(tangled)


class _Flood:
    def __init__(
        self,
        around: Surroundings,
        here_rad: Floats,
        row: int,
        travel_rad: Floats,
        window: SearchWindow,
    ) -> None:
        self.around, self.here, self.row, self.window = around, here_rad, row, window
        self.start = here_rad[row]
        reach = round(window.half_deg / window.step_deg)
        self.offsets = window.step_deg * np.arange(-reach, reach + 1)
        self.middle = (reach, reach)
        self.others, now = self._bodies_within_reach()
        self.overlapped = now < -TOUCHING_MM
        self.need = np.where(self.overlapped, -np.inf, np.minimum(now, CLEAR_MM))
        self.gaps = self._gap_map()
        self.possible = (self.gaps >= self.need - 1e-12).all(axis=2) & self._within(travel_rad)
        self.allowed = self._steps_allowed()

    def _bodies_within_reach(self) -> tuple[Ints, Floats]:
        others = self.around.near[self.row]
        now = self.around.gaps_mm(self.row, self.start[None], self.here, others)[0]
        plane, far = self.around.plane, self.around.far_mm
        sweep = deg_to_rad(self.window.half_deg) * (plane.l_alpha_mm[self.row] + 2.0 * far)
        near = now < float(sweep) + CLEAR_MM
        return others[near], now[near]

    def _angles(self, offsets_deg: Floats) -> Floats:
        return np.ascontiguousarray(self.start + deg_to_rad(offsets_deg))

    def _gap_map(self) -> Floats:
        """(A, B, k) gaps at every point of the grid."""
        a, b = np.meshgrid(self.offsets, self.offsets, indexing="ij")
        angles = self._angles(np.column_stack([a.ravel(), b.ravel()]))
        flat = self.around.gaps_mm(self.row, angles, self.here, self.others)
        return flat.reshape(len(self.offsets), len(self.offsets), -1)

    def _within(self, travel_rad: Floats) -> Flags:
        """(A, B): one that is beyond the travel may come back."""
        low = np.minimum(travel_rad[:, 0], self.start)
        high = np.maximum(travel_rad[:, 1], self.start)
        axes = self.start[:, None] + deg_to_rad(self.offsets)
        good = (axes >= low[:, None] - 1e-12) & (axes <= high[:, None] + 1e-12)
        within: Flags = np.logical_and.outer(good[0], good[1])
        return within

    def _steps_allowed(self) -> Flags:
        """(8, A, B): may it go from here in this direction?"""
        rise = self.window.slope_mm_deg * self.window.step_deg
        gaps = self.gaps[:, :, self.overlapped]
        out = np.zeros((len(DIRECTIONS), *self.possible.shape), dtype=bool)
        for k, direction in enumerate(DIRECTIONS):
            there = np.roll(gaps, -direction, axis=(0, 1))
            grows = (there >= gaps + rise) | ((gaps >= CLEAR_MM) & (there >= CLEAR_MM))
            out[k] = self.possible & np.roll(self.possible, -direction, axis=(0, 1)) & grows.all(axis=2)
            _close_border(out[k], direction)
        return out

    def way(self, margin_mm: float) -> Retreat | None:
        return self._way_to(lambda steps: self._goal(steps, margin_mm))

    def towards(self, goal_rad: Floats) -> Retreat | None:
        far = rad_to_deg(goal_rad - self.start)
        off = [np.abs(self.offsets - way) for way in far]
        return self._way_to(lambda steps: self._nearest(steps, np.maximum.outer(*off)))

    def away_from(self, rows: Ints) -> Retreat | None:
        gaps = self.gaps[:, :, np.isin(self.others, rows)]
        room = gaps.min(axis=2, initial=_ROOM_MM)
        return self._way_to(lambda steps: self._roomiest(steps, room))

    def _roomiest(self, steps: Ints, room_mm: Floats) -> tuple[tuple[int, int] | None, bool]:
        most = room_mm[steps >= 0].max()
        gained = most - room_mm[self.middle] > _ROOM_GAIN_MM
        there = (steps >= 0) & (room_mm >= most - 1e-9)
        best = int(np.where(there, steps, np.iinfo(np.int64).max).argmin())
        return (_first(best, steps.shape) if gained else None), True

    def _nearest(self, steps: Ints, off_deg: Floats) -> tuple[tuple[int, int] | None, bool]:
        best = int(np.where(steps >= 0, off_deg, np.inf).argmin())
        gained = off_deg[self.middle] - off_deg.flat[best] > _GAIN_DEG
        return (_first(best, steps.shape) if gained else None), True

    def _way_to(self, choose: Callable[[Ints], tuple[tuple[int, int] | None, bool]]) -> Retreat | None:
        for _ in range(_LOOKS):
            goal, free = choose(steps := self._flood())
            if goal is None:
                return None
            nodes = self._back(steps, goal)
            bad = self._first_bad_step(nodes)
            if bad is None:
                points = np.array([[self.offsets[i] for i in node] for node in nodes])
                return Retreat(self.row, rad_to_deg(self.start) + points, self.window.step_deg, free)
            direction = _index_of(np.subtract(nodes[bad + 1], nodes[bad]))
            self.allowed[(direction, *nodes[bad])] = False
        return None

    def _flood(self) -> Ints:
        """(A, B) steps from the middle; -1 where there is no way."""
        steps = np.full(self.possible.shape, -1, dtype=np.int64)
        steps[self.middle] = 0
        front = steps == 0
        count = 0
        while front.any():
            count += 1
            reached = np.zeros_like(front)
            for k, direction in enumerate(DIRECTIONS):
                reached |= np.roll(front & self.allowed[k], direction, axis=(0, 1))
            front = reached & (steps < 0)
            steps[front] = count
        return steps

    def _goal(self, steps: Ints, margin_mm: float) -> tuple[tuple[int, int] | None, bool]:
        gaps = self.gaps[:, :, self.overlapped]
        for margin in (margin_mm, CLEAR_MM):
            good = (steps > 0) & (gaps >= margin).all(axis=2)
            if good.any():
                return _first(np.where(good, steps, np.iinfo(np.int64).max).argmin(), steps.shape), True
        worth = np.minimum(gaps, margin_mm).sum(axis=2)
        worth = np.where(steps > 0, worth - worth[self.middle], 0.0)
        best = int(worth.argmax())
        gained = worth.flat[best] > 0.02
        return (_first(best, steps.shape) if gained else None), False

    def _back(self, steps: Ints, goal: tuple[int, int]) -> list[tuple[int, int]]:
        """The way to a point, straight on where that is as short."""
        nodes, last = [goal], 0
        while nodes[-1] != self.middle:
            for k in [last, *range(len(DIRECTIONS))]:
                before = (nodes[-1][0] - int(DIRECTIONS[k][0]), nodes[-1][1] - int(DIRECTIONS[k][1]))
                if min(before) < 0 or max(before) >= len(self.offsets):
                    continue
                if steps[before] == steps[nodes[-1]] - 1 and self.allowed[(k, *before)]:
                    nodes.append(before)
                    last = k
                    break
        return nodes[::-1]

    def _first_bad_step(self, nodes: list[tuple[int, int]]) -> int | None:
        """The first step within which a gap falls, seen finely."""
        corners = np.array([[self.offsets[i] for i in node] for node in nodes])
        places = np.arange(0, len(nodes) - 1 + 0.5 / _SAMPLES, 1.0 / _SAMPLES)
        fine = np.column_stack([np.interp(places, np.arange(len(nodes)), c) for c in corners.T])
        gaps = self.around.gaps_mm(self.row, self._angles(fine), self.here, self.others)
        highest = np.maximum.accumulate(gaps, axis=0)
        falls = self.overlapped & (gaps < np.where(highest < 0.0, highest - _FALL_MM, 0.0))
        near = ~self.overlapped & (gaps < np.minimum(self.need - 1e-9, 0.5 * CLEAR_MM))
        bad = np.flatnonzero((falls | near).any(axis=1))
        return int(bad[0] - 1) // _SAMPLES if len(bad) else None


def _close_border(allowed: Flags, direction: Ints) -> None:
    """No step leaves the grid, nor comes in on its other side."""
    for axis, way in enumerate(direction):
        if way:
            edge: list[slice | int] = [slice(None), slice(None)]
            edge[axis] = -1 if way > 0 else 0
            allowed[tuple(edge)] = False


def _index_of(direction: Ints) -> int:
    return int(np.flatnonzero((direction == DIRECTIONS).all(axis=1))[0])


def _first(flat: int | np.intp, shape: tuple[int, ...]) -> tuple[int, int]:
    a, b = np.unravel_index(flat, shape)
    return int(a), int(b)
