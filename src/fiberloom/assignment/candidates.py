"""Which positioner could take which target with which fibre."""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.planning.bodies import beside
from fiberloom.targets import TargetList
from fiberloom.targets.target_list import FREE
from fiberloom.typing import Flags, Floats, Ints

SLACK_MM = 1.0
"""Units differ from the nominal one by less; the exact test follows."""


class Block(IntEnum):
    """What keeps a candidate from being chosen; the later, the nearer it came."""

    NONE = 0
    OFFLINE = 1
    BUSY = 2
    STOPS = 3
    BODY = 4
    POCKET = 5
    EDGE = 6
    DARK = 7
    ARM = 8


@dataclass(frozen=True)
class Candidates:
    """C choices (positioner, target, fibre), sorted by positioner, and the angles of each."""

    positioner: Ints
    """(C,) row in the focal plane."""
    target: Ints
    """(C,) row in the target list."""
    fibre: NDArray[np.str_]
    goal_deg: Floats
    """(C, 2)."""

    def __len__(self) -> int:
        return len(self.positioner)

    def select(self, rows: Ints | Flags) -> "Candidates":
        """Some of them."""
        return replace(
            self,
            positioner=self.positioner[rows],
            target=self.target[rows],
            fibre=self.fibre[rows],
            goal_deg=self.goal_deg[rows],
        )


class WayRule(Protocol):
    """What the motors of an instrument ask of the targets, beside that arms do not touch there."""

    def blocks(self, positioner: Ints, goal_deg: Floats) -> Ints:
        """(C,) what keeps each candidate from its goal, a `Block`; `Block.NONE`: nothing does.

        `positioner` (C,): rows of the plane; `goal_deg` (C, 2): alpha and beta.
        """
        ...

    def crossing(self, positioner: Ints, goal_deg: Floats, first: Ints, second: Ints) -> Flags:
        """(p,) pairs of candidates of which one bars the other's way.

        `positioner` (C,): rows of the plane; `goal_deg` (C, 2): alpha and beta; `first`, `second` (p,): rows
        of the candidates.
        """
        ...


def check_targets(plane: FocalPlane, targets: TargetList) -> None:
    """Raise InputError where the list asks for a fibre or a positioner that does not exist."""
    known = ("", *plane.science_fibres)
    for row in np.flatnonzero(~np.isin(targets.fibre, known))[:1]:
        raise InputError(
            f"target {targets.target_id[row]}: fibre '{targets.fibre[row]}' is unknown; "
            f"{plane.instrument.name} has {', '.join(plane.science_fibres)}"
        )
    demanded = targets.positioner_id[targets.positioner_id != FREE]
    ids, count = np.unique(demanded, return_counts=True)
    if len(ids):
        plane.index_of(ids)
    for positioner in ids[count > 1][:1]:
        both = targets.target_id[targets.positioner_id == positioner][:2]
        raise InputError(f"targets {' and '.join(both)}: both demand positioner {positioner}")


def find_candidates(plane: FocalPlane, targets: TargetList) -> Candidates:
    """Every choice that kinematics and axis limits allow, by exact inverse kinematics. Kronig 2020,
    Eq. 2. Both elbows, and turns of alpha, count where the limits have them. Offline positioners included:
    they are told apart later, with a reason."""
    near_positioner, near_target = _within_reach(plane, targets)
    parts = [_by_fibre(plane, targets, f, near_positioner, near_target) for f in plane.science_fibres]
    positioner, target, fibre, goal = (np.concatenate(x) for x in zip(*parts, strict=True))
    order = np.lexsort((target, positioner))
    return Candidates(positioner, target, fibre, goal).select(order)


def _within_reach(plane: FocalPlane, targets: TargetList) -> tuple[Ints, Ints]:
    reach = plane.instrument.reach_mm[1] + SLACK_MM
    lists = cKDTree(targets.xy_mm).query_ball_point(plane.centres_mm, reach, return_sorted=True)
    positioner = np.repeat(np.arange(plane.n), [len(x) for x in lists])
    target = np.concatenate([np.asarray(x, dtype=np.int64) for x in lists])
    wanted = targets.positioner_id[target]
    allowed = (wanted == FREE) | (wanted == plane.positioner_id[positioner])
    return positioner[allowed], target[allowed]


def _by_fibre(
    plane: FocalPlane, targets: TargetList, fibre: str, positioner: Ints, target: Ints
) -> tuple[Ints, Ints, NDArray[np.str_], Floats]:
    asked = targets.fibre[target]
    fits = ((asked == "") | (asked == fibre)) & plane.carries(fibre)[positioner]
    positioner, target = positioner[fits], target[fits]
    found = plane.solutions(targets.place_mm(fibre)[target], fibre, positioner)
    pair, which = np.nonzero(found.holds)
    goal = found.angles_deg[pair, which]
    return positioner[pair], target[pair], np.full(len(goal), fibre), goal


def inside_stops(
    plane: FocalPlane, positioner: Ints, goal_deg: Floats, approach_deg: float | Floats
) -> Flags:
    """(C,) do goals and starts of the approach lie between the hard stops?

    `positioner` (C,): rows of the `plane`; `goal_deg` (C, 2); `approach_deg`: overshoot, one number or (C,).
    """
    low, high = np.moveaxis(plane.stops_of(positioner), -1, 0)
    start = goal_deg + beside(plane, np.broadcast_to(approach_deg, len(goal_deg)))
    inside: Flags = ((np.minimum(goal_deg, start) >= low) & (np.maximum(goal_deg, start) <= high)).all(axis=1)
    return inside
