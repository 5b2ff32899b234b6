"""Which bodies of a field overlap, and how their gaps change as one positioner moves."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fiberloom._core import geometry
from fiberloom.instruments import FocalPlane
from fiberloom.planning.bodies import CollisionBodies
from fiberloom.typing import Floats, Ints

TOUCHING_MM = 1e-6
"""Gaps above minus this are none of the verifier's business."""


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
        return np.flatnonzero(gaps < reach)

    def lines_mm(self, row: int, angles_rad: Floats) -> Floats:
        """(n, 4) centre lines of one positioner's arm at n pairs of angles."""
        arms = np.repeat(self.plane.arms[[row]], len(angles_rad), axis=0)
        return geometry.beta_segment(arms, *self.bodies.segment_mm, np.ascontiguousarray(angles_rad))

    def gaps_mm(self, row: int, angles_rad: Floats, here_rad: Floats, others: Ints) -> Floats:
        """(n, k) signed gaps in mm of an arm to other bodies.

        `row`: whose arm; `angles_rad` (n, 2): its places; `here_rad` (N, 2): where all other arms are;
        `others` (k,): the bodies.
        """
        mine, count = self.lines_mm(row, angles_rad), len(others)
        theirs, radii = self._bodies(others, here_rad)
        apart = signed_distance_mm(np.repeat(mine, count, axis=0), np.tile(theirs, (len(mine), 1)))
        return apart.reshape(len(mine), count) - radii

    def _bodies(self, others: Ints, here_rad: Floats) -> tuple[Floats, Floats]:
        """(k, 4) centre lines, and (k,) how near the centre line of an arm may come."""
        n, radius = self.plane.n, self.bodies.radius_mm
        lines, radii = np.empty((len(others), 4)), np.full(len(others), 2.0 * radius)
        arms = others < n
        lines[arms] = self._arms_mm(others[arms], here_rad)
        lines[~arms] = self.bodies.obstacles[others[~arms] - n, :4]
        radii[~arms] = radius + self.bodies.obstacles[others[~arms] - n, 4]
        return lines, radii

    def _arms_mm(self, rows: Ints, here_rad: Floats) -> Floats:
        return geometry.beta_segment(self.plane.arms[rows], *self.bodies.segment_mm, here_rad[rows])

    @cached_property
    def _pairs(self) -> tuple[Ints, Ints]:
        """Rows, and bodies after them that their arms can touch."""
        later = [near[near > row] for row, near in enumerate(self.near)]
        rows = np.repeat(np.arange(self.plane.n), [len(k) for k in later])
        return rows, np.concatenate([np.zeros(0, dtype=np.int64), *later])

    def gaps_of_pairs_mm(self, here_rad: Floats) -> tuple[Ints, Ints, Floats]:
        """Rows (P,), bodies after them that their arms can touch, and their signed gaps in mm.

        `here_rad` (N, 2): where all arms are.
        """
        rows, others = self._pairs
        theirs, radii = self._bodies(others, here_rad)
        return rows, others, signed_distance_mm(self._arms_mm(rows, here_rad), theirs) - radii

    def overlapping(self, here_rad: Floats) -> dict[tuple[int, int], float]:
        """Pairs (row, body) that overlap, row < body, and by how much in mm."""
        rows, others, gaps = self.gaps_of_pairs_mm(here_rad)
        found = np.flatnonzero(gaps < -TOUCHING_MM)
        return {(int(rows[k]), int(others[k])): -float(gaps[k]) for k in found}

    def name(self, body: int) -> str:
        """As in a sentence."""
        fiducials = self.plane.n + len(self.plane.fiducials)
        if body < self.plane.n:
            return f"positioner {self.plane.positioner_id[body]}"
        if body < fiducials:
            return f"fiducial {body - self.plane.n}"
        return f"guide camera {body - fiducials}"
