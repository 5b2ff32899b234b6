"""Proof that a plan keeps what a supply gives: by another way of counting than the planner's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.planning.trajectories import Plan, Trajectory
from fiberloom.typing import Floats

ROUNDING_A = 1e-9
_MOST_TERMS = 500_000
"""Positioners times moments, for a bound on memory."""


@dataclass(frozen=True)
class SupplyVerification:
    """What the motors of a plan take at most. `ok`: no limit is exceeded at any time."""

    peak_A: float
    """Of all motors, by the instrument's `[care]`; 0 where it does not say what motors take."""
    peak_s: float
    """When that is first so."""
    most_at_once: int
    """Positioners of which an axis turns at the same time."""
    most_s: float
    supply_A: float | None
    """What was to be kept; None: no limit."""
    at_once: int | None

    @property
    def ok(self) -> bool:
        """Are all limits kept?"""
        fed = self.supply_A is None or self.peak_A <= self.supply_A + ROUNDING_A
        return fed and (self.at_once is None or self.most_at_once <= self.at_once)

    def __str__(self) -> str:
        said = []
        if self.supply_A is not None and self.peak_A > self.supply_A + ROUNDING_A:
            has = f"the supply has {self.supply_A:.4g} A"
            said.append(f"the motors take {self.peak_A:.4g} A at {self.peak_s:.3f} s; {has}")
        if self.at_once is not None and self.most_at_once > self.at_once:
            said.append(
                f"{self.most_at_once} positioners move at {self.most_s:.3f} s, not {self.at_once} at most"
            )
        return "; ".join(said) or f"ok, {self.most_at_once} positioners at once, {self.peak_A:.4g} A at most"


def verify_supply(
    plane: FocalPlane, plan: Plan, *, supply_A: float | None = None, at_once: int | None = None
) -> SupplyVerification:
    """Count the motors that turn, and what they take, in every stretch between two points of any trajectory.

    The current is that of the instrument's `[care]`: friction of each motor that turns, and its speed's share
    of `speed_deg_s`. Between two points every axis has one speed, so that nothing is left out.

    Parameters
    ----------
    plane : FocalPlane
        Whose instrument says what motors take.
    plan : Plan
        What is to be proven.
    supply_A : float, optional
        Current for all motors, A; the instrument's when left out; None there: no limit.
    at_once : int, optional
        Positioners that may move at the same time.

    Returns
    -------
    SupplyVerification
        Peaks, and whether they are within the limits.

    Examples
    --------
    >>> import fiberloom as fl
    >>> from fiberloom.planning import verify_supply
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> made = fl.plan(plane, plane.park_deg, plane.park_deg - [0.0, 30.0])
    >>> verify_supply(plane, made).most_at_once
    7
    """
    care = plane.instrument.care
    edges = np.unique(np.concatenate([np.zeros(1), *(robot.time_s for robot in plan.robots)]))
    middle = 0.5 * (edges[:-1] + edges[1:])
    own_deg_s = np.array([axis.speed_deg_s for axis in plane.instrument.axes])
    current_A, at_a_time = np.zeros(len(middle)), np.zeros(len(middle), dtype=np.int64)
    for robots in _of_one_clock(plan, max(1, _MOST_TERMS // max(1, len(middle)))):
        share = _speeds_deg_s(robots, middle) / own_deg_s
        turns = share > 0.0
        current_A += (turns * care.motor_friction_A + share * care.motor_speed_A).sum(axis=(0, 2))
        at_a_time += turns.any(axis=2).sum(axis=0)
    worst, most = (int(np.argmax(x)) if len(middle) else -1 for x in (current_A, at_a_time))
    return SupplyVerification(
        peak_A=float(current_A[worst]) if worst >= 0 else 0.0,
        peak_s=float(edges[worst]) if worst >= 0 else 0.0,
        most_at_once=int(at_a_time[most]) if most >= 0 else 0,
        most_s=float(edges[most]) if most >= 0 else 0.0,
        supply_A=care.supply_A if supply_A is None else supply_A,
        at_once=at_once,
    )


def _of_one_clock(plan: Plan, most: int) -> Iterator[list[Trajectory]]:
    """Those that move, in groups of `most` at most with points at the same times. Small moves of a field have
    two such groups: with an approach, and without.
    """
    groups: dict[bytes, list[Trajectory]] = {}
    for robot in plan.robots:
        if robot.moves:
            groups.setdefault(robot.time_s.tobytes(), []).append(robot)
    for robots in groups.values():
        for first in range(0, len(robots), most):
            yield robots[first : first + most]


def _speeds_deg_s(robots: Sequence[Trajectory], at_s: Floats) -> Floats:
    """(R, M, 2) speeds of alpha and beta at moments (M,), of robots with common times; 0 after the end."""
    time_s = robots[0].time_s
    piece = np.searchsorted(time_s, at_s, side="right") - 1
    ways_deg = np.diff([robot.points_deg for robot in robots], axis=1)
    each = np.abs(ways_deg) / np.diff(time_s)[:, None]
    speeds: Floats = np.concatenate([each, np.zeros((len(robots), 1, 2))], axis=1)[:, piece]
    return speeds
