"""Which arms of the twin touch on their true ways. Knows no plan: only where each arm was when.

A body is the line from elbow to fibre with a radius (cobraOps); an arm that has none is a fixed disc. Between
two moments angles run straight. An interval is free where arms are farther apart at its ends than they
can come together in between; else it is halved.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fiberloom._core.geometry import segment_distance
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad

FINEST_MM = 1e-4
"""Two arms that come this near to touching without touching do not touch."""


@dataclass(frozen=True, eq=False)
class ArmBodies:
    """Arms of n cobras, and fixed discs as arms without length behind them."""

    centre_mm: Floats
    link_mm: Floats
    """(n, 2)."""
    zero_deg: Floats
    """(n, 2) directions at angle 0 of both motors."""
    radius_mm: Floats
    """(n,)."""

    def segments_mm(self, rows: Ints, angle_deg: Floats) -> Floats:
        """(m, 4) in mm of rows (m,) at angles (m, 2) in deg."""
        first, between = deg_to_rad(self.zero_deg[rows] + angle_deg).T
        a, b = self.link_mm[rows].T
        x, y = self.centre_mm[rows, 0] + a * np.cos(first), self.centre_mm[rows, 1] + a * np.sin(first)
        second = first + between
        return np.column_stack([x, y, x + b * np.cos(second), y + b * np.sin(second)])

    def apart_mm(self, pairs: Ints, angle_deg: Floats) -> Floats:
        """(P,) mm between bodies of pairs (P, 2) of rows, all at (n, 2) deg; below 0: they touch."""
        i, j = pairs.T
        lines = (self.segments_mm(rows, angle_deg[rows]) for rows in (i, j))
        return np.asarray(segment_distance(*lines) - (self.radius_mm[i] + self.radius_mm[j]))

    def farthest_mm(self, rows: Ints, from_deg: Floats, to_deg: Floats) -> Floats:
        """(m,) mm that no point of an arm goes farther than, between two angles (m, 2) in deg."""
        turn = np.abs(deg_to_rad(to_deg - from_deg))
        a, b = self.link_mm[rows].T
        farthest: Floats = turn[:, 0] * (a + b) + turn[:, 1] * b
        return farthest


def touching(bodies: ArmBodies, pairs: Ints, angle_deg: Floats) -> Flags:
    """(P,) which pairs (P, 2) of rows touch while angles (K, n, 2) in deg go from moment to moment."""
    hit = np.zeros(len(pairs), dtype=bool)
    moved = np.ptp(angle_deg, axis=0).max(axis=1) > 0.0
    alive = np.flatnonzero(moved[pairs].any(axis=1))
    alive = alive[_near(bodies, pairs[alive], angle_deg)]
    for before, after in pairwise(angle_deg):
        if len(alive) == 0:
            break
        i, j = pairs[alive].T
        ways = np.stack([before[i], after[i], before[j], after[j]], axis=1)
        hit[alive] = _interval(bodies, pairs[alive], ways)
        alive = alive[~hit[alive]]
    return hit


def _near(bodies: ArmBodies, pairs: Ints, angle_deg: Floats) -> Flags:
    """(P,) which may touch at all: their fibres' circles about the centres meet."""
    a, b = bodies.link_mm.T
    far = np.sqrt(a**2 + b**2 + 2 * a * b * np.cos(deg_to_rad(bodies.zero_deg[:, 1] + angle_deg[..., 1])))
    step = np.abs(np.diff(deg_to_rad(angle_deg[..., 1]), axis=0)).max(axis=0, initial=0.0)
    reach = np.maximum(far.max(axis=0) + 0.5 * step * b, a) + bodies.radius_mm
    i, j = pairs.T
    gap = np.hypot(*(bodies.centre_mm[i] - bodies.centre_mm[j]).T)
    near: Flags = gap < reach[i] + reach[j]
    return near


def _interval(bodies: ArmBodies, pairs: Ints, ways: Floats) -> Flags:
    """(P,) which touch in one interval; `ways` (P, 4, 2): of both arms at its start and end."""
    hit = np.zeros(len(pairs), dtype=bool)
    which, left = np.arange(len(pairs)), ways
    while len(which):
        i, j = pairs[which].T
        need = bodies.radius_mm[i] + bodies.radius_mm[j]
        start = segment_distance(bodies.segments_mm(i, left[:, 0]), bodies.segments_mm(j, left[:, 2])) - need
        end = segment_distance(bodies.segments_mm(i, left[:, 1]), bodies.segments_mm(j, left[:, 3])) - need
        go = bodies.farthest_mm(i, left[:, 0], left[:, 1]) + bodies.farthest_mm(j, left[:, 2], left[:, 3])
        hit[which[(start < 0.0) | (end < 0.0)]] = True
        open_ = (start + end < go) & (go > FINEST_MM) & ~hit[which]
        which, left = np.repeat(which[open_], 2), _halved(left[open_])
        keep = ~hit[which]
        which, left = which[keep], left[keep]
    return hit


def _halved(ways: Floats) -> Floats:
    """(2 m, 4, 2): each interval as two."""
    middle = 0.5 * (ways[:, [0, 2]] + ways[:, [1, 3]])
    first = np.stack([ways[:, 0], middle[:, 0], ways[:, 2], middle[:, 1]], axis=1)
    second = np.stack([middle[:, 0], ways[:, 1], middle[:, 1], ways[:, 3]], axis=1)
    return np.stack([first, second], axis=1).reshape(-1, 4, 2)
