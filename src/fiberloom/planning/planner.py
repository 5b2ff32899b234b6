"""Plans whole fields and small corrections; what leaves here has passed the verifier."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fiberloom._core import planning as core
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.planning.bodies import (
    CollisionBodies,
    angles_rad,
    approach_rad,
    beside,
    least_approach_rad,
    paces_rad,
    require_within_stops,
    travel_rad,
    travels_rad,
)
from fiberloom.planning.late import require_late
from fiberloom.planning.obstacles import obstacle_name
from fiberloom.planning.trajectories import Approach, Plan, Trajectory
from fiberloom.planning.verification import MotionLimits, Verification, verify
from fiberloom.timing import part
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad, rad_to_deg

SPEED_SHARE = 0.975
"""Part of the instrument's speed that plans use. The motor must go faster than the output where the
transmission is not linear; 12 deg/s become 11.7, 2000 rpm of the motor."""
GRID_DEG, WIDEST_GRID_DEG = 5.85, 8.0
"""Between these the step of the search is so wide that an axis comes to its speed in it."""

DECIMALS_DEG = 9
"""Angles are rounded to this before they are verified: the JSON form says exactly what was."""

_ANGLE_DEG = 1e-6
"""Angles that differ by less are the same to an operator."""

_RETRIES = 3
_ROUNDS_OF_STAYING = 8
_UNVERIFIED = "its motion did not pass the verifier; please report this"


Progress = Callable[[str, int, int], None]


def _silent(stage: str, done: int, total: int) -> None:
    """Not told to anything that waits."""


@dataclass(frozen=True)
class _Range:
    """From `least` to `most`, both included; `above`: a number above `least` alone."""

    unit: str
    least: float = 0.0
    most: float = math.inf
    above: bool = False

    def holds(self, value: float) -> bool:
        """Whether it is a number, finite and inside."""
        return math.isfinite(value) and (
            value > self.least if self.above else self.least <= value <= self.most
        )

    def __str__(self) -> str:
        unit = self.unit and f" {self.unit}"
        if self.above:
            return f"a finite number above {self.least:g}{unit}"
        if self.most == math.inf:
            return f"a finite number from {self.least:g}{unit} on"
        return f"a finite number from {self.least:g} to {self.most:g}{unit}"


RANGES: Mapping[str, _Range] = {
    "speed_deg_s": _Range("deg/s", above=True),
    "acceleration_deg_s2": _Range("deg/s^2", above=True),
    "collision_buffer_mm": _Range("mm", above=True),
    # a knot gets grids four times as fine, with as many more steps: sixty-four times the cells in time
    "grid_deg": _Range("deg", least=2.0, most=30.0),
    "clearance_mm": _Range("mm"),
    "in_hand_mm": _Range("mm"),
    "first_deadline": _Range("", least=1.0),
    "last_deadline": _Range("", least=1.0),
    "effort": _Range(""),
    "least_approach_deg": _Range("deg"),
    "approach_turns": _Range("turns", least=1),
    "most_points": _Range("points", least=4),
    "budget_s": _Range("s"),
}
"""Numbers of `PlanSettings` with which a plan can be made: others would end it without a word, or never."""


def require_ranges(settings: object) -> None:
    """Raises InputError for the first number that is none, or out of its range; None is the instrument's."""
    for name, allowed in RANGES.items():
        value = getattr(settings, name)
        if value is not None and not allowed.holds(value):
            raise InputError(f"{name} {value:g}: must be {allowed}")


@dataclass(frozen=True)
class PlanSettings:
    """How to plan. The instrument decides what is left out (None)."""

    speed_deg_s: float | None = None
    acceleration_deg_s2: float | None = None
    collision_buffer_mm: float | None = None
    grid_deg: float | None = None
    """Widest step of the search, 2 to 30 deg. None: what an axis needs to come to its speed and stop
    (2 v^2 / a), but 5.85 to 8 deg. Coarse is good: eight times fewer states than half of it."""
    clearance_mm: float = 0.001
    """Kept beyond touching, so that rounding on the bus does not matter."""
    in_hand_mm: float = 0.05
    """Kept beyond the buffer by an arm on its way, more than a step of the grid from its start and its goal.
    So it can go on from a stop although angles are not exact. Where a positioner would not arrive with it, it
    and those around it keep nothing in hand."""
    late_s: float = 0.0
    """Any one positioner may be late by so much, s, while all others are on time, and touches none of them;
    inf: it may stop on its way for good. As far as it can be had: pairs that find no way soon are planned as
    if both were on time (`Plan.not_late`), and no goal is given up for it. `verify_late` proves what a plan
    bears. `plan_corrections` does not look at it where all can move straight."""
    first_deadline: float = 1.05
    """Time allowed at first, over what the longest way needs."""
    last_deadline: float = 2.0
    """Beyond this over the first, a positioner that still meets another is given up."""
    effort: float = 1.0
    """Scales how many repairs are tried before a positioner is given up."""
    least_approach_deg: float | None = None
    """To this an approach may be shortened that would touch something, on one axis or both."""
    approach_turns: int = 4
    """In so many turns positioners may come down to their goals where together they would touch; each one
    that is used lengthens the plan by an approach. 1: in one, or earlier."""
    most_points: int = 40
    """An axis that would get more points over the bus leaves out some, as far as all stay clear."""
    budget_s: float | None = None
    """Processor time that a plan may take, s; None: what it needs. When it is used up, positioners that still
    meet others are given up, and the rest is neither hurried nor straightened: what is there by then is
    verified. A plan that is cut short depends on the machine."""
    progress: Progress = _silent
    """Called while a plan is made: the name of a stage, how many of its parts are done, of how many."""

    def of(self, plane: FocalPlane) -> "PlanSettings":
        """With the instrument's numbers filled in. InputError names a number that is out of its range."""
        axes = plane.instrument.axes
        require_late("late_s", self.late_s)
        require_ranges(self)
        speed_deg_s = self.speed_deg_s or SPEED_SHARE * min(a.speed_deg_s for a in axes)
        acceleration_deg_s2 = self.acceleration_deg_s2 or min(a.acceleration_deg_s2 for a in axes)
        full_speed_deg = 2.0 * speed_deg_s**2 / acceleration_deg_s2
        return replace(
            self,
            speed_deg_s=speed_deg_s,
            acceleration_deg_s2=acceleration_deg_s2,
            grid_deg=self.grid_deg or float(np.clip(full_speed_deg, GRID_DEG, WIDEST_GRID_DEG)),
            collision_buffer_mm=self.collision_buffer_mm or plane.collision_buffer_mm,
            least_approach_deg=plane.instrument.least_approach_deg
            if self.least_approach_deg is None
            else self.least_approach_deg,
        )

    @property
    def dynamics(self) -> dict[str, float]:
        """Arguments of the compiled functions, in rad."""
        return {
            "speed": float(deg_to_rad(self.speed_deg_s or 0.0)),
            "acceleration": float(deg_to_rad(self.acceleration_deg_s2 or 0.0)),
            "grid": float(deg_to_rad(self.grid_deg or GRID_DEG)),
        }


@dataclass(frozen=True)
class _Task:
    """One call, checked and in rad."""

    plane: FocalPlane
    start: Floats
    goal: Floats
    approach: Floats
    settings: PlanSettings
    begin_s: float = field(default_factory=time.thread_time)
    """Processor time of this thread when it was made."""

    @classmethod
    def of(
        cls,
        plane: FocalPlane,
        start_deg: ArrayLike,
        goal_deg: ArrayLike,
        approach_deg: ArrayLike | None,
        settings: PlanSettings | None,
    ) -> "_Task":
        still = deg_to_rad(plane.offline_position_deg)
        start, goal = (
            np.where(plane.offline[:, None], still, angles_rad(name, angles, plane))
            for name, angles in (("start_deg", start_deg), ("goal_deg", goal_deg))
        )
        require_within_stops("start_deg", plane, rad_to_deg(start))
        approach = approach_rad(plane, approach_deg)
        return cls(plane, start, goal, approach, (settings or PlanSettings()).of(plane))

    @property
    def bodies(self) -> CollisionBodies:
        return CollisionBodies.of(self.plane, self.settings.collision_buffer_mm)

    def compiled(self, fixed: Flags) -> core.Task:
        """As the compiled planner takes it; `fixed` (N,) cannot move."""
        asked = core.Task(self.start, self.goal, self.approach, fixed, travel_rad(self.plane))
        asked.set_sides(self.plane.instrument.approach_sides)
        if (own := travels_rad(self.plane)) is not None:
            asked.set_travels(own)
        chosen = self.settings
        asked.set_paces(*paces_rad(self.plane, chosen.speed_deg_s or 0.0, chosen.acceleration_deg_s2 or 0.0))
        return asked

    @property
    def cpu_s(self) -> float:
        """Processor time since then."""
        return time.thread_time() - self.begin_s

    @property
    def moving(self) -> Flags:
        moving: Flags = ~self.plane.offline & (np.abs(self.goal - self.start).sum(axis=1) > 1e-12)
        return moving

    def verify(self, plan: Plan) -> Verification:
        return verify(
            self.plane,
            plan,
            start_deg=rad_to_deg(self.start),
            goal_deg=rad_to_deg(self.goal),
            approach_deg=rad_to_deg(self.approach),
            limits=MotionLimits(
                self.settings.speed_deg_s,
                self.settings.acceleration_deg_s2,
                least_approach_deg=self.settings.least_approach_deg,
            ),
        )


@part("planning")
def plan(
    plane: FocalPlane,
    start_deg: ArrayLike,
    goal_deg: ArrayLike,
    *,
    seed: int = 0,
    approach_deg: ArrayLike | None = None,
    settings: PlanSettings | None = None,
) -> Plan:
    """Trajectories of all positioners at once, direct, free of collisions; verified before they leave.

    Each positioner that moves comes to its goal from approach_deg above on both axes, in the negative
    direction, after all its other motion; from below on an axis whose approach is below 0. One that is at its
    goal already stays, unless it is in the way. Lengths and speeds are the instrument's.

    Parameters
    ----------
    plane : FocalPlane
        N positioners; offline ones are where the plane says.
    start_deg, goal_deg : array_like
        (N, 2) alpha and beta, deg, within the hard stops.
    seed : int
        The same input and seed give the same plan on every platform.
    approach_deg : array_like, optional
        One number or (N,), deg; the instrument's when left out.
    settings : PlanSettings, optional
        How hard to try; speeds and buffer other than the instrument's.

    Returns
    -------
    Plan
        Positioners that cannot arrive are named in `Plan.refused`; they stay or go out of the way, and
        all others are planned round them.

    Raises
    ------
    InputError
        Angles of another shape, or a start where no arm can be: beyond the hard stops. A goal there is
        refused in the plan.

    Examples
    --------
    >>> import fiberloom as fl
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> assigned = fl.assign(plane, fl.read_targets("targets.csv"))
    >>> made = fl.plan(plane, plane.park_deg, assigned.goal_deg)
    >>> made.refused
    {}
    """
    return _plan(_Task.of(plane, start_deg, goal_deg, approach_deg, settings), seed)


def _plan(task: _Task, seed: int) -> Plan:
    fixed = task.plane.offline.copy()
    unsafe: dict[int, str] = {}
    for _ in range(_RETRIES):
        made = _planned(task, fixed, seed, unsafe)
        checked = task.verify(made)
        if checked.ok:
            return replace(made, cpu_s=task.cpu_s)
        # has not been seen; the positioners involved stay, and the rest is planned anew
        for violation in checked.violations:
            for number in {str(violation.positioner_id), violation.other}:
                if number.isdigit():
                    unsafe[int(number)] = f"positioner {number}: {_UNVERIFIED}"
        fixed[task.plane.index_of(list(unsafe))] = True
    return replace(made.unmoved(_UNVERIFIED), cpu_s=task.cpu_s)


def _planned(task: _Task, fixed: Flags, seed: int, unsafe: dict[int, str]) -> Plan:
    chosen = task.settings
    settings = core.Settings(**chosen.dynamics)
    settings.clearance_mm = chosen.clearance_mm
    settings.in_hand_mm = chosen.in_hand_mm
    settings.late_s = chosen.late_s
    settings.first_deadline = chosen.first_deadline
    settings.last_deadline = chosen.last_deadline
    settings.effort = chosen.effort
    settings.approach_turns = chosen.approach_turns
    settings.most_points = chosen.most_points
    settings.seed = seed
    if chosen.progress is not _silent:
        settings.tell(chosen.progress)
    if (budget_s := chosen.budget_s) is not None:
        settings.end_when(lambda: task.cpu_s > budget_s)
    asked = task.compiled(fixed)
    asked.may_shorten(least_approach_rad(task.plane, task.approach, chosen.least_approach_deg))
    motions, refused, statistics, own = core.plan(task.bodies.compiled, asked, settings)
    names = task.plane.positioner_id
    why = {int(names[i]): _reason(task, i, text, *met) for i, text, *met in refused}
    approaches = {row: _approach(alpha, beta) for row, alpha, beta in own}
    if chosen.late_s > 0.0:
        statistics |= _lateness_of(chosen.late_s, names, statistics.get("not_late"))
    return _assembled(task, motions, unsafe | why, statistics, approaches)


def _lateness_of(late_s: float, names: Ints, pairs: Sequence[Sequence[int]] | None) -> dict[str, Any]:
    """What the statistics tell of it; no pairs: it had to be given up for all."""
    if pairs is None:
        return {"late_s": 0.0, "not_late": ()}
    by_id = sorted((min(p), max(p)) for p in ((int(names[i]), int(names[j])) for i, j in pairs))
    return {"late_s": late_s, "not_late": tuple(by_id)}


def _reason(task: _Task, row: int, why: str, other: int, obstacle: int) -> str:
    """The sentence on a positioner, with the name of the body that it meets, or what its axes would need."""
    plane = task.plane
    body = f"positioner {plane.positioner_id[other]}" if other >= 0 else ""
    still = obstacle_name(plane, obstacle) if obstacle >= 0 else f"{body}, which does not move"
    told = why.format(other=body or still, still=still, axes=_beyond_travel(task, row))
    named = told != why or not body
    return f"positioner {plane.positioner_id[row]}: {told}" + ("" if named else f" ({body})")


def _approach(*legs: Sequence[float]) -> Approach:
    """Of the last legs of alpha and beta: height in rad, begin and end in s."""
    alpha, beta = (
        (round(float(rad_to_deg(h)), DECIMALS_DEG), *np.round(times, 6).tolist()) for h, *times in legs
    )
    height, begin, end = zip(alpha, beta, strict=True)
    return Approach(height, begin, end)


def _beyond_travel(task: _Task, row: int) -> str:
    """The axes on which a goal with its shortest approach is out of reach: what they would need, and have."""
    least = least_approach_rad(task.plane, task.approach, task.settings.least_approach_deg)
    ends = np.sort([task.goal[row], task.goal[row] + beside(task.plane, least[row])], axis=0)
    needed, own = rad_to_deg(ends.T), travels_rad(task.plane)
    travel = rad_to_deg(travel_rad(task.plane) if own is None else own[row])
    return "".join(
        f"; {axis} needs {low:g} to {high:g} deg, and has {first:g} to {last:g} deg"
        for axis, (low, high), (first, last) in zip(AXES, needed, travel, strict=True)
        if low < first - _ANGLE_DEG or high > last + _ANGLE_DEG
    )


def _assembled(
    task: _Task,
    motions: list[Floats],
    refused: dict[int, str],
    statistics: dict[str, Any],
    approaches: Mapping[int, Approach] = MappingProxyType({}),
) -> Plan:
    """A plan of motions in rad; `approaches` by row."""
    # rounded together: a positioner has few points, and a call takes longer than they do
    all_points = np.concatenate([np.empty((0, 3)), *motions])
    times = np.round(all_points[:, 0], 6)
    alpha_deg, beta_deg = np.round(rad_to_deg(all_points[:, 1:]), DECIMALS_DEG).T.copy()
    ends = np.cumsum([len(points) for points in motions]).tolist()
    robots = []
    for row, (number, end) in enumerate(zip(task.plane.positioner_id.tolist(), ends, strict=True)):
        own = slice(end - len(motions[row]), end)
        robots.append(Trajectory(number, times[own], alpha_deg[own], beta_deg[own], approaches.get(row)))
    return Plan(
        instrument=task.plane.instrument.name,
        collision_buffer_mm=task.bodies.radius_mm,
        robots=tuple(robots),
        refused=refused,
        statistics=statistics,
    )


@part("planning")
def plan_corrections(
    plane: FocalPlane,
    start_deg: ArrayLike,
    goal_deg: ArrayLike,
    *,
    seed: int = 0,
    approach_deg: ArrayLike | None = None,
    settings: PlanSettings | None = None,
) -> Plan:
    """Small moves, all at once: up to approach_deg above the goal and down again.

    `plane`, `start_deg`, `goal_deg` (N, 2), `seed`, `approach_deg` and `settings` as in `plan`. A
    positioner with the same start and goal does not move. If two would touch when all move straight and
    together, `plan` finds an order or a way round. One that cannot arrive is named in `Plan.refused` and ends
    where it was: near its target is better than out of the way of others.
    """
    task = _Task.of(plane, start_deg, goal_deg, approach_deg, settings)
    told: dict[int, str] = {}
    for _ in range(_ROUNDS_OF_STAYING):
        made = _small(task, seed)
        if made.refused.keys() <= told.keys():
            break
        told = {number: f"{why}; it stays where it is" for number, why in made.refused.items()} | told
        task, told = _staying(task, told)
    return replace(made, refused=made.refused | told, cpu_s=task.cpu_s)


def _small(task: _Task, seed: int) -> Plan:
    """All straight and together, if that touches nothing."""
    together = _all_together(task)
    return together if task.verify(together).ok else _plan(task, seed)


def _staying(task: _Task, told: dict[int, str]) -> tuple[_Task, dict[int, str]]:
    """With the starts of those that are told as their goals; others whose goals these touch stay too."""
    plane, goal = task.plane, task.goal.copy()
    while True:
        rows = plane.index_of(list(told))
        goal[rows] = task.start[rows]
        at_rest = _assembled(task, [np.array([[0.0, *angles]]) for angles in goal], {}, {})
        before = len(told)
        for contact in verify(plane, at_rest).contacts:
            pair = str(contact.positioner_id), contact.other
            for number, other in (pair, pair[::-1]):
                if number.isdigit() and int(number) not in told and other.isdigit() and int(other) in told:
                    why = f"its goal touches positioner {other}, which stays where it is; it stays too"
                    told = told | {int(number): f"positioner {number}: {why}"}
        if len(told) == before:
            return replace(task, goal=goal), told


def _all_together(task: _Task) -> Plan:
    """Every positioner straight to the place above its goal within the same steps, then the approach."""
    settings = core.Settings(**task.settings.dynamics)
    quarter_s, grids, turn = core.clock(task.compiled(~task.moving), settings)
    high = task.goal + beside(task.plane, task.approach)
    way = np.where(task.moving[:, None], high - task.start, 0.0)
    most = (np.abs(way).max(axis=1) / np.array(grids)).max(initial=0.0)
    steps = max(1, int(np.ceil(most - 1e-9)))
    # corners cut over half a step, as in the planner: quarters of a step and the way done by then
    quarters = [0, 2, 4 * steps, 4 * steps + 2]
    done = np.array([0.0, 0.25 / steps, 1.0 - 0.25 / steps, 1.0])
    times = np.array([*quarters, quarters[-1] + turn])
    points = np.empty((task.plane.n, len(times), 3))
    points[:, :, 0] = times * quarter_s
    points[:, :-1, 1:] = task.start[:, None] + done[:, None] * way[:, None]
    points[:, -1, 1:] = task.goal
    counts = np.where(task.moving, np.where(task.approach > 0.0, len(times), len(times) - 1), 1)
    motions = [own[:count] for own, count in zip(points, counts, strict=True)]
    return _assembled(task, motions, {}, {"steps": steps})
