"""How far each positioner of an array can turn while all turn together.

Arms of one length that point the same way are copies of one another, a pitch apart: they do not meet,
whatever the angle. What does not turn with them is in the way: fiducials, guide cameras, positioners that do
not move. One that meets them keeps its beta more folded, by as little as the verifier asks for. One that
cannot turn even then stays where it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.planning import MotionLimits, Plan, Trajectory, verify
from fiberloom.planning.verification import Violation
from fiberloom.typing import Flags, Floats

LEVELS_DEG = tuple(np.arange(15.0, 166.0, 15.0).tolist())
"""Betas below which a positioner with something in its way does not go; the first that is clear is taken."""

SLOW_S = 60.0
"""Time of a step in the way that the verifier is shown: the places count, not the speed."""


@dataclass(frozen=True)
class SweepPass:
    """One axis goes through its points, up and down again; the other one rests."""

    axis: int
    """0 alpha, 1 beta."""
    points_deg: Floats
    """(K,) of the axis that turns, rising."""
    rest_deg: float
    """Of the other axis."""
    run_up_deg: float
    """Before the first point and after the last."""

    def places_deg(self, low_deg: Floats) -> Floats:
        """(K + 2, N, 2) places on the way up, with the run-ups; `low_deg` (N,): lowest beta of each."""
        first, last = self.points_deg[0] - self.run_up_deg, self.points_deg[-1] + self.run_up_deg
        return self.at(np.concatenate([[first], self.points_deg, [last]]), low_deg)

    def at(self, turning: Floats, low_deg: Floats) -> Floats:
        """(M, N, 2) places with the axis that turns at these angles (M,) in deg; `low_deg` (N,)."""
        places = np.empty((len(turning), len(low_deg), 2))
        places[..., self.axis] = turning[:, None]
        places[..., 1 - self.axis] = self.rest_deg
        places[..., 1] = np.maximum(places[..., 1], low_deg)
        return places

    def usable(self, low_deg: Floats) -> Flags:
        """(K, N) points that a positioner reaches, on its way up with the backlash closed."""
        if self.axis == 0:
            return np.ones((len(self.points_deg), len(low_deg)), dtype=bool)
        free = low_deg <= self.points_deg[0]
        return np.asarray(free | (self.points_deg[:, None] > low_deg + 2.0 * self.run_up_deg))


@dataclass(frozen=True)
class ClearWays:
    """Which positioners take part in a pass, and how far. Arrays over N positioners."""

    takes: Flags
    """(N,) turn with the others."""
    low_deg: Floats
    """(N,) lowest beta."""
    why: dict[int, str]
    """By row: what is in the way of those that could not turn even folded."""


def clear_ways(plane: FocalPlane, here_deg: Floats, takes: Flags, swept: SweepPass) -> ClearWays:
    """Which of those that may move can take part in a pass, and how far, so that the verifier finds no fault.

    Parameters
    ----------
    plane : FocalPlane
        N positioners; those that do not follow commands are offline, where they are.
    here_deg : ndarray
        (N, 2) where each is, deg.
    takes : ndarray of bool
        (N,) which may move.
    swept : SweepPass
        The pass.

    Returns
    -------
    ClearWays
        For each whether it takes part, and its lowest beta in deg.
    """
    takes, why = takes.copy(), {}
    start_deg = swept.rest_deg if swept.axis == 0 else swept.points_deg[0] - swept.run_up_deg
    low_deg = np.full(len(plane), start_deg)
    while takes.any():
        places = np.where(takes[:, None], swept.places_deg(low_deg), here_deg)
        met = verify(plane, slow_plan(plane, places, takes), limits=_NO_SPEED).collisions
        if not met:
            break
        for row, other in _to_fold(plane, met, takes, low_deg).items():
            above = [level for level in LEVELS_DEG if level > low_deg[row]]
            low_deg[row] = above[0] if above else low_deg[row]
            if not above:
                takes[row], why[row] = False, f"no room to turn: {other} is in its way"
    return ClearWays(takes, low_deg, why)


_NO_SPEED = MotionLimits(speed_deg_s=360.0, acceleration_deg_s2=1e6)


def _to_fold(plane: FocalPlane, met: tuple[Violation, ...], takes: Flags, low_deg: Floats) -> dict[int, str]:
    """By row what it meets: of every two that meet the one that is folded less, both where they are alike."""
    fold: dict[int, str] = {}
    for found in met:
        names = [str(found.positioner_id), found.other]
        rows = [int(plane.index_of(int(name))) if name.isdigit() else -1 for name in names]
        able = [k for k in range(2) if rows[k] >= 0 and takes[rows[k]]]
        least = min(low_deg[rows[k]] for k in able)
        for k in able:
            if low_deg[rows[k]] == least:
                other = names[1 - k]
                fold[rows[k]] = f"positioner {other}" if other.isdigit() else other
    return fold


def slow_plan(plane: FocalPlane, places_deg: Floats, takes: Flags, step_s: float = SLOW_S) -> Plan:
    """A plan of straight ways from place to place.

    `plane`: N positioners; `places_deg`: (M, N, 2), of all in turn; `takes` (N,): which move, the others
    rest at the first place; `step_s`: from one place to the next, s.
    """
    time_s: Floats = step_s * np.arange(len(places_deg), dtype=np.float64)
    robots = tuple(
        Trajectory(int(p), time_s, *places_deg[:, i].T)
        if takes[i]
        else Trajectory(int(p), time_s[:1], *places_deg[:1, i].T)
        for i, p in enumerate(plane.positioner_id)
    )
    return Plan(plane.instrument.name, plane.collision_buffer_mm, robots)
