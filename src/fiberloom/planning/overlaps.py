"""Which bodies of a field overlap, and how their gaps change as one positioner moves."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fiberloom._core import geometry
from fiberloom.instruments import FocalPlane
from fiberloom.planning.bodies import CollisionBodies
from fiberloom.planning.obstacles import BETA, LAYERS, RADIUS, meet, obstacle_name, part_lines_mm
from fiberloom.typing import Floats, Ints

TOUCHING_MM = 1e-6
"""Gaps above minus this are none of the verifier's business."""

_FAR_MM = 1e9
"""The gap of bodies on different layers."""


def signed_distance_mm(first_mm: Floats, second_mm: Floats) -> Floats:
    """(n,) distance of segments (n, 4); where they cross, minus the shortest shift that parts them."""
    apart = np.array(geometry.segment_distance(first_mm, second_mm))
    crossed = np.flatnonzero(apart <= 0.0)
    if len(crossed):
        apart[crossed] = -_shortest_shift_mm(first_mm[crossed], second_mm[crossed])
    return apart


def _shortest_shift_mm(p: Floats, q: Floats) -> Floats:
    """(n,): one of the four ends comes out of the other segment sideways."""
    ways = [_off_line_mm(p, q[:, :2]), _off_line_mm(p, q[:, 2:])]
    ways += [_off_line_mm(q, p[:, :2]), _off_line_mm(q, p[:, 2:])]
    return np.asarray(np.min(ways, axis=0), dtype=np.float64)


def _off_line_mm(line: Floats, point: Floats) -> Floats:
    along, way = line[:, 2:] - line[:, :2], point - line[:, :2]
    length = np.hypot(*along.T)
    across = np.abs(along[:, 0] * way[:, 1] - along[:, 1] * way[:, 0])
    return np.where(length > 0.0, across / np.maximum(length, 1e-300), 0.0)


@dataclass(frozen=True)
class Surroundings:
    """The bodies of a field. Body k < n is the arm in row k; body n + k is obstacle k."""

    plane: FocalPlane
    bodies: CollisionBodies

    @cached_property
    def near(self) -> list[Ints]:
        """For each row the bodies that its arm can touch."""
        n = self.plane.n
        pairs = self.plane.neighbour_pairs(2.0 * self.bodies.radius_mm)
        both = np.vstack([pairs, pairs[:, ::-1]])
        obstacles = [self._obstacles_near(row) for row in range(n)]
        arms = [np.sort(both[both[:, 0] == row, 1]) for row in range(n)]
        return [np.concatenate([a, n + o]) for a, o in zip(arms, obstacles, strict=True)]

    def _obstacles_near(self, row: int) -> Ints:
        lines = self.bodies.obstacles[:, :4]
        centre = np.tile(self.plane.centres_mm[row], (len(lines), 2))
        gaps = geometry.segment_distance(centre, np.ascontiguousarray(lines))
        reach = self.plane.body_reach_mm[row] + self.bodies.radius_mm + self.bodies.obstacles[:, 4]
        return np.flatnonzero((gaps < reach) & (self.bodies.obstacles[:, 6] != row))

    @cached_property
    def far_mm(self) -> float:
        """How far from its axis a point of an arm is at most: of centre lines, of either arm."""
        return float(np.hypot(self.bodies.parts[:, 2:6:2], self.bodies.parts[:, 3:7:2]).max())

    @cached_property
    def _parts(self) -> list[Floats]:
        """(p, 8) of each row."""
        rows = self.bodies.parts[:, 0].astype(np.int64)
        order = np.argsort(rows, kind="stable")
        return np.split(self.bodies.parts[order], np.cumsum(np.bincount(rows, minlength=self.plane.n))[:-1])

    def gaps_mm(self, row: int, angles_rad: Floats, here_rad: Floats, others: Ints) -> Floats:
        """(n, k) signed gaps in mm of an arm to other bodies.

        `row`: whose arm; `angles_rad` (n, 2): its places; `here_rad` (N, 2): where all other arms are;
        `others` (k,): the bodies.
        """
        n, k = len(angles_rad), len(others)
        out = np.full((n, k), _FAR_MM)
        if k == 0:
            return out
        theirs, rest, begins = self._pieces(others, here_rad)
        for part in self._parts[row]:
            mine = part_lines_mm(self.plane.arms[[row]], part, angles_rad)
            apart = signed_distance_mm(np.repeat(mine, len(theirs), axis=0), np.tile(theirs, (n, 1)))
            gaps = apart.reshape(n, len(theirs)) - (part[RADIUS] + rest[:, 0])
            gaps[:, ~meet(part[[1, LAYERS]], rest[:, 1:])] = _FAR_MM
            out = np.minimum(out, np.minimum.reduceat(gaps, begins, axis=1))
        return out

    def _pieces(self, bodies: Ints, here_rad: Floats) -> tuple[Floats, Floats, Ints]:
        """Lines (q, 4), and radius, arm, layers (q, 3), of all parts of k bodies; (k,) where each begins."""
        lines: list[Floats] = []
        rest: list[Floats] = []
        begins: list[int] = []
        for body in map(int, bodies):
            begins.append(len(lines))
            if body >= self.plane.n:
                fixed = self.bodies.obstacles[[body - self.plane.n]]
                lines.append(fixed[:, :4])
                rest.append(np.insert(fixed[:, 4:6], 1, BETA, axis=1))
                continue
            for part in self._parts[body]:
                lines.append(part_lines_mm(self.plane.arms[[body]], part, here_rad[[body]]))
                rest.append(part[None, [RADIUS, 1, LAYERS]])
        return np.vstack(lines), np.vstack(rest), np.array(begins, dtype=np.int64)

    @cached_property
    def _pairs(self) -> tuple[Ints, Ints]:
        """Rows, and bodies after them that their arms can touch."""
        later = [near[near > row] for row, near in enumerate(self.near)]
        rows = np.repeat(np.arange(self.plane.n), [len(k) for k in later])
        return rows, np.concatenate([np.zeros(0, dtype=np.int64), *later])

    @cached_property
    def _pieces_of_pairs(self) -> tuple[Ints, Ints, Ints]:
        """Index of the pair, part of its row, part of the other or P + obstacle, if layers are shared."""
        rows, others = self._pairs
        n, count = self.plane.n, len(self.bodies.parts)
        of_row = [np.flatnonzero(self.bodies.parts[:, 0] == row) for row in range(n)]
        found = []
        for pair, (row, other) in enumerate(zip(rows, others, strict=True)):
            theirs = of_row[other] if other < n else np.array([count + other - n])
            found += [(pair, a, b) for a in of_row[row] for b in theirs]
        pairs, mine, theirs = np.array(found, dtype=np.int64).reshape(-1, 3).T
        fixed = np.insert(self.bodies.obstacles[:, 5:6], 0, BETA, axis=1)
        kinds = np.vstack([self.bodies.parts[:, [1, LAYERS]], fixed])
        can = meet(kinds[mine], kinds[theirs])
        return pairs[can], mine[can], theirs[can]

    def gaps_of_pairs_mm(self, here_rad: Floats) -> tuple[Ints, Ints, Floats]:
        """Rows (P,), bodies after them that their arms can touch, and their signed gaps in mm.

        `here_rad` (N, 2): where all arms are.
        """
        rows, others = self._pairs
        pairs, mine, theirs = self._pieces_of_pairs
        lines = np.vstack([self.all_lines_mm(here_rad), self.bodies.obstacles[:, :4]])
        radii = np.concatenate([self.bodies.parts[:, RADIUS], self.bodies.obstacles[:, 4]])
        apart = signed_distance_mm(lines[mine], lines[theirs]) - (radii[mine] + radii[theirs])
        gaps = np.full(len(rows), _FAR_MM)
        np.minimum.at(gaps, pairs, apart)
        return rows, others, gaps

    def all_lines_mm(self, here_rad: Floats) -> Floats:
        """(P, 4) mm: centre lines of all parts of `bodies`, in their order; the arms at (N, 2) rad."""
        parts = self.bodies.parts
        lines = np.empty((len(parts), 4))
        kinds, which = np.unique(parts[:, 1:6], axis=0, return_inverse=True)
        for k in range(len(kinds)):
            of_kind = np.flatnonzero(which.ravel() == k)
            rows = parts[of_kind, 0].astype(np.int64)
            lines[of_kind] = part_lines_mm(self.plane.arms[rows], parts[of_kind[0]], here_rad[rows])
        return lines

    def overlapping(self, here_rad: Floats) -> dict[tuple[int, int], float]:
        """Pairs (row, body) that overlap, row < body, and by how much in mm."""
        rows, others, gaps = self.gaps_of_pairs_mm(here_rad)
        found = np.flatnonzero(gaps < -TOUCHING_MM)
        return {(int(rows[k]), int(others[k])): -float(gaps[k]) for k in found}

    def name(self, body: int) -> str:
        """As in a sentence."""
        n = self.plane.n
        if body >= n:
            return obstacle_name(self.plane, body - n)
        return f"positioner {self.plane.positioner_id[body]}"
