"""What arms may sweep in a move, whenever they do it, and which of it neighbours could meet in.

A motor's way is known to a quarter of it, and when it passes a place is not known at all. So a move is a
set of boxes of angles (theta from, to; phi from, to), and two arms are safe from each other if no pose in a
box of one touches any pose in a box of the other. Boxes are halved until that is proven or a meeting found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom._core.geometry import segment_distance
from fiberloom.drive.piezo.cobras import CobraArms
from fiberloom.instruments.arms import pairs_within
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad

FINEST_MM = 0.04
"""Boxes that move an arm by less are not halved: they count as a meeting."""

MARGIN_MM = 0.06
"""Between territories, for camera and calibration: above what counts as a meeting."""


def box_of(first_deg: Floats, last_deg: Floats) -> Floats:
    """(n, 2, 2) boxes from low to high of theta and phi, of two corners (n, 2) in deg."""
    return np.stack([np.minimum(first_deg, last_deg), np.maximum(first_deg, last_deg)], axis=2)


@dataclass(frozen=True, eq=False)
class SweptCheck:
    """Arms of n cobras, then fixed discs; and the pairs of them that can meet."""

    arms: CobraArms
    cobras: int
    pairs: Ints
    """(P, 2) rows of `arms`; the first is a cobra."""

    @classmethod
    def of(cls, arms: CobraArms, discs_mm: Floats) -> SweptCheck:
        """`discs_mm` (m, 3): x, y, radius in mm of what stands between the cobras."""
        n = len(arms)
        both = arms.with_discs(discs_mm)
        reach = both.link_mm.sum(axis=1) + both.radius_mm
        pairs = pairs_within(both.centre_mm, reach, 0.0)
        return cls(both, n, pairs[pairs[:, 0] < n])

    def territory_mm(self, margin_mm: float = MARGIN_MM) -> Floats:
        """(n,) how far from its centre a fibre may be so that no neighbour in its own is touched.

        `margin_mm`: kept between two territories.
        """
        arms, (i, j) = self.arms, self.pairs.T
        gap = np.hypot(*(arms.centre_mm[i] - arms.centre_mm[j]).T) - arms.radius_mm[i] - arms.radius_mm[j]
        gap -= margin_mm
        room = np.full(len(arms.centre_mm), np.inf)
        np.minimum.at(room, i, np.where(j >= self.cobras, gap, 0.5 * gap))
        np.minimum.at(room, j, 0.5 * gap)
        return room[: self.cobras]

    def meeting(self, first_deg: Floats, second_deg: Floats, which: Ints | None = None) -> Flags:
        """Which pairs could meet.

        `first_deg`, `second_deg` (n, B, 2, 2) deg: B boxes of each cobra, axis, low and high, for the first
        and the second of a pair; `which` (p,): pairs, all of them when left out. Returns (p,).
        """
        pairs = self.pairs if which is None else self.pairs[which]
        i, j = pairs.T
        fixed = np.zeros((len(self.arms) - self.cobras, *second_deg.shape[1:]))
        second_deg = np.concatenate([second_deg, fixed])
        hit = np.zeros(len(pairs), dtype=bool)
        for a in range(first_deg.shape[1]):
            for b in range(second_deg.shape[1]):
                left = np.flatnonzero(~hit)
                boxes = np.stack([first_deg[i[left], a], second_deg[j[left], b]], axis=1)
                hit[left] = self.boxes_meet(pairs[left], boxes)
        return hit

    def boxes_meet(self, pairs: Ints, boxes: Floats) -> Flags:
        """(p,) which `pairs` (p, 2) of rows could meet, by their `boxes` (p, 2 arms, 2 axes, 2) in deg."""
        hit = np.zeros(len(pairs), dtype=bool)
        which = np.arange(len(pairs))
        while len(which):
            gap, extent = self._gaps(pairs[which], boxes)
            hit[which[gap < 0.0]] = True
            total = extent.sum(axis=(1, 2))
            open_ = gap < total
            hit[which[open_ & (total < FINEST_MM)]] = True
            open_ &= ~hit[which]
            which, boxes = np.repeat(which[open_], 2), _halved(boxes[open_], extent[open_])
        return hit

    def _gaps(self, pairs: Ints, boxes: Floats) -> tuple[Floats, Floats]:
        """(p,) mm between arms in the middle of their boxes; (p, 2, 2) mm by which each axis moves them."""
        middle = boxes.mean(axis=3)
        half = deg_to_rad(0.5 * (boxes[..., 1] - boxes[..., 0]))
        i, j = pairs.T
        segments = [self.arms.segments_mm(middle[:, k], rows) for k, rows in enumerate((i, j))]
        gap = segment_distance(*segments) - self.arms.radius_mm[i] - self.arms.radius_mm[j]
        levers = np.stack([self._levers(rows, boxes[:, k]) for k, rows in enumerate((i, j))], axis=1)
        return gap, half * levers

    def _levers(self, rows: Ints, box: Floats) -> Floats:
        """(p, 2) mm: the farthest that any point of an arm in its box (p, 2, 2) is from its axes."""
        a, b = self.arms.link_mm[rows].T
        turn = self.arms.zero_deg[rows, 1, None] + box[:, 1]
        # the most open phi of the box: 0 if that is in it
        near = np.where((turn[:, 0] <= 0.0) & (turn[:, 1] >= 0.0), 0.0, np.abs(turn).min(axis=1))
        far = np.sqrt(a**2 + b**2 + 2.0 * a * b * np.cos(deg_to_rad(near)))
        return np.column_stack([np.maximum(far, a), b])


def _halved(boxes: Floats, extent: Floats) -> Floats:
    """(2 p, 2, 2, 2): each pair of boxes as two, halved along the axis that moves an arm most."""
    flat = boxes.reshape(len(boxes), 4, 2)
    axis = extent.reshape(-1, 4).argmax(axis=1)
    rows = np.arange(len(flat))
    middle = flat[rows, axis].mean(axis=1)
    low, high = flat.copy(), flat.copy()
    low[rows, axis, 1], high[rows, axis, 0] = middle, middle
    return np.stack([low, high], axis=1).reshape(-1, 2, 2, 2)
