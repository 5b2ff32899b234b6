"""The state of an assignment that is being made: the place of each positioner, and the rules for places."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fiberloom.assignment.clearance import (
    dip_mm,
    gaps_mm,
    obstacles,
    places,
    standing,
    too_near,
)
from fiberloom.assignment.escape import Escape
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints

NO_TARGET = -1

Say = Callable[[str], None]
"""Told the name of each step of an assignment."""


def silent(_: str) -> None:
    """No output."""


@dataclass(frozen=True)
class Rules:
    """What a place must keep."""

    approach_deg: float
    margin_mm: float
    pair_mm: float
    """Least gap between two arms at the poses."""
    gap_mm: float
    """Least gap between an arm and a fixed body at the poses."""
    escape: Escape
    """Fixed bodies, and which positioners can get past them."""

    @property
    def bodies(self) -> Floats:
        """(K, 7) mm: capsules that do not move, as of `clearance.obstacles`."""
        return self.escape.bodies

    @classmethod
    def of(cls, plane: FocalPlane, approach_deg: float, margin_mm: float) -> "Rules":
        """Collision buffers, the margin, and the dip between poses."""
        return cls(
            approach_deg=approach_deg,
            margin_mm=margin_mm,
            pair_mm=margin_mm + dip_mm(plane, approach_deg),
            gap_mm=margin_mm / 2 + dip_mm(plane, approach_deg, bodies=1),
            escape=Escape(plane, obstacles(plane, margin_mm)),
        )


@dataclass
class Placement:
    """Arrays over the N positioners. Offline ones are placed from the start."""

    plane: FocalPlane
    approach_deg: Floats
    """(N,) overshoot with which each goal was found free."""
    goal_deg: Floats = field(init=False)
    segments: Floats = field(init=False)
    """(N, POSES, P, 4) mm: centre lines of the parts at the goal and on the way to it."""
    placed: Flags = field(init=False)
    target: Ints = field(init=False)
    fibre: NDArray[np.str_] = field(init=False)
    notes: list[str] = field(default_factory=list)
    neighbours: list[Ints] = field(init=False)
    """Rows of the positioners that each one can touch."""

    def __post_init__(self) -> None:
        plane, n = self.plane, self.plane.n
        self.goal_deg = np.where(plane.offline[:, None], plane.offline_position_deg, 0.0)
        self.segments = standing(plane, self.goal_deg)
        self.placed = plane.offline.copy()
        self.target = np.full(n, NO_TARGET)
        self.fibre = np.full(n, "", dtype=f"<U{max(map(len, plane.points))}")
        pairs = plane.neighbour_pairs(1.0)
        both = np.vstack([pairs, pairs[:, ::-1]])
        both = both[np.lexsort((both[:, 1], both[:, 0]))]
        self.neighbours = np.split(both[:, 1], np.searchsorted(both[:, 0], np.arange(1, n)))

    def put(
        self,
        row: int | Ints,
        goal_deg: Floats,
        segments: Floats,
        approach: float | Floats,
        target: int | Ints = NO_TARGET,
        fibre: str | NDArray[np.str_] = "",
    ) -> None:
        """Place positioners.

        `row`: one, or (n,); `goal_deg` (n, 2); `segments` (n, POSES, P, 4) mm: centre lines at the
        goal and on the approach; `approach`: overshoot in deg, one or (n,); `target`: row of the target
        list, NO_TARGET without one; `fibre`: its name.
        """
        self.goal_deg[row], self.segments[row], self.placed[row] = goal_deg, segments, True
        self.approach_deg[row], self.target[row], self.fibre[row] = approach, target, fibre

    def take_away(self, row: int) -> int:
        """Remove a positioner from its place; the target that it had."""
        target = int(self.target[row])
        self.placed[row], self.target[row], self.fibre[row] = False, NO_TARGET, ""
        return target

    def hits(self, row: int, segments: Floats, limit_mm: float) -> tuple[Ints, Flags]:
        """Placed neighbours of a positioner that can still move, and (places, neighbours) flags: True
        where their gap to a place, `segments` (C, POSES, P, 4) in mm, is below `limit_mm`.
        """
        near = self.neighbours[row]
        near = near[self.placed[near] & ~self.plane.offline[near]]
        mine, theirs = np.indices((len(segments), len(near))).reshape(2, -1)
        wanted = places(self.plane, np.full(len(segments), row), segments)
        bad = too_near(wanted, mine, places(self.plane, near, self.segments[near]), theirs, limit_mm)
        return near, bad.reshape(len(segments), len(near))

    def clearance_mm(self) -> Floats:
        """(N,) gap between each arm and the nearest other one, over all poses."""
        a, b = self.plane.neighbour_pairs(1.0).T
        all_places = places(self.plane, np.arange(self.plane.n), self.segments)
        gap = gaps_mm(all_places, a, all_places, b)
        out = np.full(self.plane.n, np.inf)
        np.minimum.at(out, a, gap)
        np.minimum.at(out, b, gap)
        return out
