"""Ways of single arms against arms that stand: which of two neighbours has to go first."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fiberloom._core.geometry import segment_distance
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints

STEP_DEG = 2.0
"""Of a way, between the poses that are looked at."""
SPARE_MM = 0.01
"""Kept between arms beside what they go between two poses."""


@dataclass(frozen=True, eq=False)
class ArmWays:
    """N arms of a plane and their neighbours."""

    plane: FocalPlane

    @cached_property
    def pairs(self) -> Ints:
        """(P, 2) rows of neighbours, each pair both ways."""
        near = self.plane.neighbour_pairs(SPARE_MM)
        return np.vstack([near, near[:, ::-1]])

    @cached_property
    def neighbours(self) -> list[Ints]:
        """Rows of the neighbours of each."""
        order = np.argsort(self.pairs[:, 0], kind="stable")
        counts = np.bincount(self.pairs[:, 0], minlength=len(self.plane))
        return np.split(self.pairs[order, 1], np.cumsum(counts)[:-1])

    @cached_property
    def radius_mm(self) -> Floats:
        """(N,) of the arms, with what is not known of them."""
        wider = 0.0 if self.plane.handicaps is None else self.plane.handicaps.wider_mm
        return np.broadcast_to(self.plane.collision_buffer_mm + wider, (len(self.plane),))

    def hits(self, rows: Ints, corners_deg: Floats, others: Ints, others_deg: Floats) -> Flags:
        """(M,) whether arms `rows` (M,) touch `others` (M,) on ways through `corners_deg` (M, C, 2).

        The others stand at `others_deg` (M, 2).
        """
        out = np.zeros(len(rows), dtype=bool)
        standing = self.plane.beta_segments(others_deg[:, 0], others_deg[:, 1], index=others)
        need = self.radius_mm[rows] + self.radius_mm[others] + SPARE_MM
        for first, second in zip(
            corners_deg[:, :-1].swapaxes(0, 1), corners_deg[:, 1:].swapaxes(0, 1), strict=True
        ):
            out |= self._leg_hits(rows, first, second, standing, need)
        return out

    def _leg_hits(
        self, rows: Ints, first_deg: Floats, second_deg: Floats, standing: Floats, need: Floats
    ) -> Flags:
        turn = np.abs(second_deg - first_deg)
        poses = max(int(np.ceil(turn.max(initial=0.0) / STEP_DEG)), 1)
        # between two poses no point of the arm goes farther than half of that from the nearer one
        alpha_mm = self.plane.l_alpha_mm[rows] + np.abs(self.plane.beta_segment_mm).max()
        between = np.deg2rad(turn[:, 0]) * alpha_mm
        between += np.deg2rad(turn[:, 1]) * np.abs(self.plane.beta_segment_mm).max()
        limit = need + 0.5 * between / poses
        out = np.zeros(len(rows), dtype=bool)
        for share in np.linspace(0.0, 1.0, poses + 1):
            alpha, beta = (first_deg + share * (second_deg - first_deg)).T
            lines = self.plane.beta_segments(alpha, beta, index=rows)
            out |= segment_distance(lines, standing) < limit
        return out

    def apart(self, rows: Ints) -> list[Ints]:
        """These in groups, none with two neighbours."""
        left, groups = rows.tolist(), []
        while left:
            taken: set[int] = set()
            for row in left:
                if taken.isdisjoint(self.neighbours[row].tolist()):
                    taken.add(row)
            groups.append(np.array(sorted(taken), dtype=np.int64))
            left = [row for row in left if row not in taken]
        return groups
