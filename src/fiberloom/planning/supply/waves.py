"""A plan in waves: at most so many positioners move at once, all others stand where they are."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.planning.bodies import angles_rad, approach_rad
from fiberloom.planning.planner import PlanSettings, plan
from fiberloom.planning.trajectories import Approach, Plan, Trajectory
from fiberloom.planning.verification import MotionLimits, verify
from fiberloom.typing import Floats
from fiberloom.units import rad_to_deg

PAUSE_S = 0.4
"""Between two waves. Motors follow smoothed: on the twin the last rotor turns until 0.3 s after the end."""

_UNVERIFIED = "the waves together did not pass the verifier; please report this"


def plan_in_waves(
    plane: FocalPlane,
    start_deg: ArrayLike,
    goal_deg: ArrayLike,
    *,
    most: int,
    make: Callable[..., Plan] = plan,
    **how: Any,
) -> Plan:
    """Trajectories of which at most `most` positioners move at any time, one wave after the other.

    Within a wave positioners move together, as `make` plans it; all others are obstacles that stand. Waves
    are of similar ways. One whose way is barred by others that stand comes in a later wave, or they step
    aside for it, as far as so many may move at once; where none of those that are left can go, they fold
    first. The whole is verified before it leaves.

    Parameters
    ----------
    plane : FocalPlane
        N positioners.
    start_deg, goal_deg : array_like
        (N, 2) alpha and beta, deg, as in `plan`.
    most : int
        Positioners at once, 1 or more.
    make : callable
        `plan`, or `plan_corrections`, with which none folds.
    **how
        `seed`, `approach_deg`, `settings` as in `plan`. `settings.late_s` holds within a wave only:
        `Plan.late_s` is 0.

    Returns
    -------
    Plan
        As of `plan`; `statistics["waves"]` says how many there are.

    Raises
    ------
    InputError
        `most` below 1; or as `plan`.

    Examples
    --------
    >>> import fiberloom as fl
    >>> from fiberloom.planning import plan_in_waves, verify_supply
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> made = plan_in_waves(plane, plane.park_deg, plane.park_deg - [0.0, 30.0], most=3)
    >>> verify_supply(plane, made).most_at_once
    3
    """
    if most < 1:
        raise InputError(f"{most} positioners at once: none can move; give 1 or more")
    start, goal = (
        np.where(
            plane.offline[:, None], plane.offline_position_deg, rad_to_deg(angles_rad(name, angles, plane))
        )
        for name, angles in (("start_deg", start_deg), ("goal_deg", goal_deg))
    )
    settings = (how.pop("settings", None) or PlanSettings()).of(plane)
    waves = _Waves(plane, make, how, settings, most, start, goal)
    made = waves.run(folds=make is plan)
    checked = verify(
        plane,
        made,
        start_deg=start_deg,
        goal_deg=goal_deg,
        approach_deg=rad_to_deg(approach_rad(plane, how.get("approach_deg"))),
        limits=MotionLimits(
            settings.speed_deg_s,
            settings.acceleration_deg_s2,
            least_approach_deg=settings.least_approach_deg,
        ),
    )
    return made if checked.ok else made.unmoved(_UNVERIFIED)


@dataclass(eq=False)
class _Waves:
    """Waves so far."""

    plane: FocalPlane
    make: Callable[..., Plan]
    how: dict[str, Any]
    settings: PlanSettings
    most: int
    here_deg: Floats
    """(N, 2) where all are after the waves so far."""
    goal_deg: Floats
    end_s: float = 0.0
    n_waves: int = 0
    cpu_s: float = 0.0
    buffer_mm: float = 0.0
    legs: dict[int, list[tuple[float, Trajectory]]] = field(default_factory=dict)
    """By row when its trajectories begin, and they."""
    why: dict[int, str] = field(default_factory=dict)

    def run(self, folds: bool) -> Plan:
        """Passes through those that are left, until none is or none gets on."""
        left = self._pass()
        if left and folds:
            for group in self._groups(left):
                self._wave(group, self.plane.park_deg)
            left = self._pass()
        return self._whole(left)

    def _pass(self) -> list[int]:
        """As many waves as get somewhere; rows that are left."""
        left = self._left()
        while left:
            for group in self._groups(left):
                self._wave(group, self.goal_deg)
            before, left = left, self._left()
            if left == before:
                # one by one, and those that stand in the way step aside, as far as so many may move at once
                for row in left:
                    self._wave([row], self.goal_deg, aside=True)
                left = self._left()
                if left == before:
                    break
        return left

    def _left(self) -> list[int]:
        away = np.abs(self.here_deg - self.goal_deg).max(axis=1) > 1e-8
        return [int(row) for row in np.flatnonzero(away & ~self.plane.offline)]

    def _groups(self, rows: list[int]) -> list[list[int]]:
        """Of equal size, the longest ways first: a wave lasts as long as its longest."""
        way = np.abs(self.here_deg - self.goal_deg).max(axis=1)
        order = sorted(rows, key=lambda row: (-way[row], row))
        size = math.ceil(len(order) / math.ceil(len(order) / self.most))
        return [order[k : k + size] for k in range(0, len(order), size)]

    def _wave(self, group: Sequence[int], goal_deg: Floats, aside: bool = False) -> None:
        """Moves those of the group that can get there; nothing where none can, or where too many would move.

        `aside`: others may step aside, and back.
        """
        plane = self.plane if aside else self._others_still(group)
        goal = self.here_deg.copy()
        goal[group] = goal_deg[group]
        self.settings.progress(f"wave {self.n_waves + 1}", self.n_waves, self.n_waves + 1)
        made = self.make(plane, self.here_deg, goal, settings=self._settings(), **self.how)
        self.cpu_s, self.buffer_mm = self.cpu_s + made.cpu_s, made.collision_buffer_mm
        told = {int(self.plane.index_of([number])[0]): text for number, text in made.refused.items()}
        self.why |= {row: text for row, text in told.items() if row in group}
        n_moving = sum(robot.moves for robot in made.robots)
        if 0 < n_moving <= self.most and any(row not in told for row in group):
            self._append(made)

    def _others_still(self, group: Sequence[int]) -> FocalPlane:
        """The plane with all others where they are, offline."""
        still = ~self.plane.offline
        still[group] = False
        names = self.plane.positioner_id
        return self.plane.with_offline(names[still], self.here_deg[still]) if still.any() else self.plane

    def _settings(self) -> PlanSettings:
        """Of one wave, whose stages are not told; with what is left of the budget."""
        budget_s = self.settings.budget_s
        left_s = None if budget_s is None else max(0.01, budget_s - self.cpu_s)
        return replace(self.settings, progress=PlanSettings().progress, budget_s=left_s)

    def _append(self, made: Plan) -> None:
        begin_s = round(self.end_s + PAUSE_S, 6) if self.n_waves else 0.0
        for row, robot in enumerate(made.robots):
            if robot.moves:
                self.legs.setdefault(row, []).append((begin_s, robot))
                self.here_deg[row] = robot.points_deg[-1]
        self.end_s, self.n_waves = begin_s + made.duration_s, self.n_waves + 1

    def _whole(self, left: list[int]) -> Plan:
        names = self.plane.positioner_id
        robots = tuple(self._joined(row, int(number)) for row, number in enumerate(names))
        refused = {int(names[row]): self.why[row] for row in left if row in self.why}
        return Plan(
            instrument=self.plane.instrument.name,
            collision_buffer_mm=self.buffer_mm or self.settings.collision_buffer_mm or 0.0,
            robots=robots,
            refused=refused,
            cpu_s=self.cpu_s,
            statistics={"waves": self.n_waves},
        )

    def _joined(self, row: int, number: int) -> Trajectory:
        """All legs of a positioner; it stands between them."""
        legs = self.legs.get(row)
        if legs is None:
            alpha_deg, beta_deg = self.here_deg[[row]].T
            return Trajectory(number, np.zeros(1), alpha_deg, beta_deg)
        times, angles = [np.zeros(0)], [np.zeros((0, 2))]
        for begin_s, robot in legs:
            if begin_s > 0.0 and len(times) == 1:
                times.append(np.zeros(1))
                angles.append(robot.points_deg[:1])
            times.append(np.round(begin_s + robot.time_s, 6))
            angles.append(robot.points_deg)
        alpha_deg, beta_deg = np.concatenate(angles).T
        own = legs[-1][1].approach
        approach = None if own is None else _later(own, legs[-1][0])
        return Trajectory(number, np.concatenate(times), alpha_deg, beta_deg, approach)


def _later(own: Approach, by_s: float) -> Approach:
    begin, end = ((first + by_s, second + by_s) for first, second in (own.begin_s, own.end_s))
    return Approach(own.height_deg, begin, end)
