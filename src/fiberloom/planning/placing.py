"""Configurations that are good for each positioner and free of collisions for all."""

import numpy as np

from fiberloom._core import planning as core
from fiberloom.instruments import FocalPlane
from fiberloom.planning.bodies import CollisionBodies, approach_rad, beside
from fiberloom.timing import part
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad, rad_to_deg

_TRIES, _AT_ONCE = 48, 8
"""Candidates that keep clear of obstacles and are tried at most, and those that are looked at together."""


@part("placing")
def place_by_worth(
    plane: FocalPlane,
    candidates_deg: Floats,
    worth: Floats,
    seed: int,
    *,
    margin_mm: float = 0.2,
    rounds: int = 2,
) -> Floats:
    """(N, 2) deg: for each positioner the best of its candidates that is free.

    `candidates_deg` (N, C, 2) for the N positioners of `plane`; `worth` (N, C): the higher the better,
    a relative weight. All begin folded, where none touches another, and take turns in random order
    (`seed`), `rounds` times; so the result is always free of collisions. Places and approaches keep
    `margin_mm`. Offline positioners stay.
    """
    placing = _Placing(plane, candidates_deg, margin_mm)
    rng = np.random.default_rng(seed)
    order = np.argsort(-worth, axis=1, kind="stable")
    movable = np.flatnonzero(~plane.offline)
    for turn in range(rounds):
        for row in rng.permutation(movable):
            # a positioner with a good place stays in later rounds
            placing.place(int(row), order[row], better_than=turn > 0)
    return rad_to_deg(placing.angles)


class _Placing:
    def __init__(self, plane: FocalPlane, candidates_deg: Floats, margin_mm: float) -> None:
        self.plane = plane
        self.goals = deg_to_rad(candidates_deg)
        bodies = CollisionBodies.of(plane)
        # half of the margin between two arms is each one's own; an obstacle has none
        self.pairs, self.alone = bodies.wider(margin_mm / 2).compiled, bodies.wider(margin_mm).compiled
        self.approach = beside(plane, approach_rad(plane, None).max(initial=0.0)).tolist()
        park = deg_to_rad(plane.park_deg)
        still = deg_to_rad(plane.offline_position_deg)
        self.angles = np.where(plane.offline[:, None], still, park)
        self.rank = np.full(plane.n, candidates_deg.shape[1])
        self.near = self._neighbours()

    def _clear_of_obstacles(self, row: int, goals: Floats) -> Flags:
        ok = core.static_ok(self.alone, np.full(len(goals), row), goals, self.approach)
        return np.asarray(ok, dtype=bool)

    def _neighbours(self) -> list[Ints]:
        pairs = self.plane.neighbour_pairs(1.0)
        both = np.vstack([pairs, pairs[:, ::-1]])
        both = both[np.argsort(both[:, 0], kind="stable")]
        return np.split(both[:, 1], np.searchsorted(both[:, 0], np.arange(1, self.plane.n)))

    def place(self, row: int, order: Ints, better_than: bool) -> None:
        """Puts one on its best free candidate; where none is free it stays where it is."""
        limit, left = int(self.rank[row]) if better_than else len(order), _TRIES
        for first in range(0, limit, _AT_ONCE):
            tried = np.arange(first, min(first + _AT_ONCE, limit))
            tried = tried[self._clear_of_obstacles(row, self.goals[row, order[tried]])][:left]
            free = tried[self._free(row, self.goals[row, order[tried]])]
            if len(free):
                self.angles[row], self.rank[row] = self.goals[row, order[free[0]]], free[0]
                return
            if (left := left - len(tried)) == 0:
                return

    def _free(self, row: int, goals: Floats) -> Flags:
        near, count = self.near[row], len(goals)
        if len(near) == 0 or count == 0:
            return np.ones(count, dtype=bool)
        rows, places = np.full(count * len(near), row), np.repeat(goals, len(near), axis=0)
        others, there = np.tile(near, count), np.tile(self.angles[near], (count, 1))
        clear = core.pairs_clear(self.pairs, rows, places, others, there, self.approach)
        return np.asarray(np.reshape(clear, (count, -1)).all(axis=1), dtype=np.bool_)
