"""Proof that a plan is safe: other code and another method than the planner's."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fiberloom._core import planning as core
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.planning.bodies import (
    ROUNDING_RAD,
    CollisionBodies,
    angles_rad,
    approach_rad,
    beyond_stops_deg,
    least_approach_rad,
    paces_rad,
    travel_rad,
    travels_rad,
)
from fiberloom.planning.obstacles import obstacle_name
from fiberloom.planning.trajectories import KEYS, MOST_DEG, Approach, Plan, Trajectory
from fiberloom.timing import part
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad, rad_to_deg

_WHAT = {
    "robots": "comes closer to positioner {other} than the collision buffer, by {depth:.4g} mm",
    "obstacle": "comes closer to {other} than the collision buffer, by {depth:.4g} mm",
    "contact": "is closer to positioner {other} than the collision buffer, by {depth:.4g} mm",
    "obstacle_contact": "is closer to {other} than the collision buffer, by {depth:.4g} mm",
    "points": "has times that do not rise from 0, or numbers that are not finite",
    "stops": "is {depth:.4g} deg beyond a hard stop, where no arm can be",
    "travel": "goes {depth:.4g} deg beyond the travel of an axis",
    "speed": "is {depth:.4g} deg/s too fast",
    "acceleration": "changes speed {depth:.4g} deg/s2 too fast",
    "start": "begins {depth:.4g} deg from where it is",
    "goal": "ends {depth:.4g} deg from its goal",
    "approach": "ends with an approach that is {depth:.4g} deg too short, or not the one that the plan tells",
    "closing": "overlaps positioner {other} and comes {depth:.4g} mm nearer to it",
    "obstacle_closing": "overlaps {other} and comes {depth:.4g} mm nearer to it",
}
_CONTACTS = ("contact", "obstacle_contact")
_COLLISIONS = ("robots", "obstacle", "closing", "obstacle_closing")
_WITH_ROBOTS = ("robots", "contact", "closing")


@dataclass(frozen=True)
class Violation:
    """One breach of a rule; the deepest moment of it."""

    kind: str
    """robots, obstacle; contact, obstacle_contact (of those that do not move, or still overlap at the
    end); closing, obstacle_closing (they overlapped at the start); points, stops, travel, speed,
    acceleration, start, goal, approach."""
    positioner_id: int
    other: str
    """The other positioner, `fiducial k` or `guide camera k`; empty if there is none."""
    time_s: float
    depth: float
    """mm for bodies; deg, deg/s, deg/s2 otherwise."""

    def __str__(self) -> str:
        what = _WHAT[self.kind].format(other=self.other, depth=self.depth)
        return f"positioner {self.positioner_id} {what} at {self.time_s:.3f} s"


@dataclass(frozen=True)
class Verification:
    """What the verifier found. `ok`: nothing that moves touches anything; all rules are kept."""

    violations: tuple[Violation, ...]
    min_robot_clearance_mm: float
    """Smallest gap between the capsules of two positioners; inf without neighbours."""
    min_obstacle_clearance_mm: float
    """Smallest gap to a fiducial or guide camera."""
    top_speed_deg_s: float
    top_acceleration_deg_s2: float
    """Change of slope at a point over the mean duration of the segments beside it."""
    top_jump_deg_s: float
    """Largest change of slope at a point."""

    @property
    def ok(self) -> bool:
        """Safe to send. Contacts of bodies that do not move are told, but not the plan's fault."""
        return all(v.kind in _CONTACTS for v in self.violations)

    @property
    def collisions(self) -> tuple[Violation, ...]:
        """Where something that moves touches something, or comes nearer to what it overlaps."""
        return tuple(v for v in self.violations if v.kind in _COLLISIONS)

    @property
    def contacts(self) -> tuple[Violation, ...]:
        """Bodies that touch although neither moves in this plan, or that still overlap when it ends."""
        return tuple(v for v in self.violations if v.kind in _CONTACTS)

    @property
    def at_fault(self) -> frozenset[int]:
        """Numbers of the positioners for which this plan is not safe to send, both of those that meet.

        Of an `unsound` plan they are not all.
        """
        breaches = [v for v in self.violations if v.kind not in _CONTACTS]
        return frozenset(
            [v.positioner_id for v in breaches] + [int(v.other) for v in breaches if v.kind in _WITH_ROBOTS]
        )

    @property
    def unsound(self) -> bool:
        """Some points are no motion: nothing else has been looked at."""
        return any(v.kind == "points" for v in self.violations)

    @property
    def min_clearance_mm(self) -> float:
        """Smallest gap of all."""
        return min(self.min_robot_clearance_mm, self.min_obstacle_clearance_mm)

    def __str__(self) -> str:
        found = [str(v) for v in self.violations[:5]]
        more = [f"and {len(self.violations) - 5} more"] if len(self.violations) > 5 else []
        return "; ".join([*found, *more]) or f"ok, clearance {self.min_clearance_mm:.4f} mm"


@dataclass(frozen=True)
class MotionLimits:
    """What a plan must keep; what is left out is the instrument's, or the plan's own."""

    speed_deg_s: float | None = None
    acceleration_deg_s2: float | None = None
    collision_buffer_mm: float | None = None
    """Radius of the beta arms."""
    separating: bool = False
    """Bodies that overlap at the start may move if they only move apart. Otherwise they may not move."""
    least_approach_deg: float | None = None
    """To which height the approaches of single positioners may be shortened, if the plan tells it."""


@part("verification")
def verify(
    plane: FocalPlane,
    plan: Plan,
    *,
    start_deg: ArrayLike | None = None,
    goal_deg: ArrayLike | None = None,
    approach_deg: ArrayLike | None = None,
    limits: MotionLimits | None = None,
) -> Verification:
    """Prove in continuous time that a plan keeps clear of everything and within all limits.

    Other code and another method than the planner's. Bodies: every pair of beta arms, arms and fiducials,
    arms and guide cameras; offline positioners are where the plane says. Gaps are proven above -1e-6 mm;
    the smallest is true to 1e-4 mm.

    Parameters
    ----------
    plane : FocalPlane
        N positioners.
    plan : Plan
        What is to be proven.
    start_deg, goal_deg : array_like, optional
        (N, 2) deg; checked where given, goals not for positioners that the plan refuses.
    approach_deg : array_like, optional
        One number or (N,), deg; checked where given, down to the least height for positioners that the plan
        says come in a way of their own. What the plan says of them is always checked.
    limits : MotionLimits, optional
        Of speed (deg/s) and acceleration (deg/s2), the instrument's when left out; radius of the beta arms
        (mm), the plan's own when left out; whether bodies that overlap at the start may separate: their gap
        is then proven to grow, to within 1 um, until it is no longer negative, and to stay so.

    Returns
    -------
    Verification
        `ok`, every breach with its time and depth, and the smallest clearance in mm.

    Raises
    ------
    InputError
        The plan moves an offline positioner, or does not say where one is.

    Examples
    --------
    >>> import fiberloom as fl
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> assigned = fl.assign(plane, fl.read_targets("targets.csv"))
    >>> made = fl.plan(plane, plane.park_deg, assigned.goal_deg)
    >>> fl.verify(plane, made, goal_deg=assigned.goal_deg).ok
    True
    """
    limits = limits or MotionLimits()
    buffer_mm = limits.collision_buffer_mm
    bodies = CollisionBodies.of(plane, plan.collision_buffer_mm if buffer_mm is None else buffer_mm)
    axes = plane.instrument.axes
    nothing = np.zeros((0, 2))
    speed_deg_s = limits.speed_deg_s or min(a.speed_deg_s for a in axes)
    acceleration_deg_s2 = limits.acceleration_deg_s2 or min(a.acceleration_deg_s2 for a in axes)
    rules = core.Rules(
        speed=float(deg_to_rad(speed_deg_s)),
        acceleration=float(deg_to_rad(acceleration_deg_s2)),
        rounding=ROUNDING_RAD,
        travel=travel_rad(plane),
    )
    rules.set_sides(plane.instrument.approach_sides)
    if (own_travels := travels_rad(plane)) is not None:
        rules.set_travels(own_travels)
    if plane.handicaps is not None:
        rules.set_paces(*paces_rad(plane, speed_deg_s, acceleration_deg_s2))
    rules.expect(
        nothing if start_deg is None else angles_rad("start_deg", start_deg, plane),
        nothing if goal_deg is None else angles_rad("goal_deg", goal_deg, plane),
        _arrives(plane, plan),
        _approaches(plane, plan, approach_deg, limits),
    )
    rules.separating = limits.separating
    for number, own in plan.approaches.items():
        rules.say(int(plane.index_of([number])[0]), *_last_legs(own))
    points = _Points.of(plane, plan)
    found = core.verify(bodies.compiled, _motions(plane, points), rules)
    return Verification(
        violations=(
            *_beyond_stops(plane, points),
            *(_violation(plane, *entry) for entry in found["violations"]),
        ),
        min_robot_clearance_mm=_gap(found["robots"]),
        min_obstacle_clearance_mm=_gap(found["obstacles"]),
        top_speed_deg_s=float(rad_to_deg(found["top_speed_rad_s"])),
        top_acceleration_deg_s2=float(rad_to_deg(found["top_acceleration_rad_s2"])),
        top_jump_deg_s=float(rad_to_deg(found["top_jump_rad_s"])),
    )


@dataclass(frozen=True)
class _Points:
    """All points of a plan, one trajectory after the other."""

    robots: tuple[Trajectory, ...]
    rows: Ints
    """(R,) of each trajectory in the plane."""
    whose: Ints
    """(M,) index of the trajectory."""
    time_s: Floats
    """(M,)"""
    angles_deg: Floats
    """(M, 2)"""

    @classmethod
    def of(cls, plane: FocalPlane, plan: Plan) -> "_Points":
        robots = plan.robots
        counts = [len(r.time_s) for r in robots]
        if any(len(r.alpha_deg) != n or len(r.beta_deg) != n for r, n in zip(robots, counts, strict=True)):
            raise ValueError("a trajectory has as many angles as times")
        alpha, beta = (_one_after_another(getattr(r, name) for r in robots) for name in KEYS[1:])
        return cls(
            robots,
            np.atleast_1d(plane.index_of([r.positioner_id for r in robots])).astype(np.int64),
            np.repeat(np.arange(len(robots)), counts),
            _one_after_another(r.time_s for r in robots),
            np.column_stack([alpha, beta]),
        )

    @property
    def ways(self) -> list[Floats]:
        """(n, 3) of each trajectory: time, alpha, beta in s and rad."""
        moments = np.column_stack([self.time_s, deg_to_rad(self.angles_deg)])
        ends = np.cumsum(np.bincount(self.whose, minlength=len(self.robots)))
        return np.split(moments, ends[:-1]) if self.robots else []

    def worst(self, plane: FocalPlane, size: Floats) -> Iterator[tuple[Trajectory, int]]:
        """Trajectories with a `size` (M,) above 0, not of who is offline; the point where it is largest."""
        bad = np.flatnonzero((size > 0.0) & ~plane.offline[self.rows][self.whose])
        for k in np.unique(self.whose[bad]):
            of_it = bad[self.whose[bad] == k]
            yield self.robots[k], int(of_it[size[of_it].argmax()])


def motions_rad(plane: FocalPlane, plan: Plan) -> list[Floats]:
    """Of each positioner of the plane (n, 3): time, alpha, beta in s and rad; InputError as `verify`."""
    return _motions(plane, _Points.of(plane, plan))


def _one_after_another(parts: Iterable[Floats]) -> Floats:
    return np.concatenate([np.zeros(0), *parts])


def _beyond_stops(plane: FocalPlane, points: _Points) -> Iterator[Violation]:
    """One for each positioner that the plan puts where no arm can be, the deepest moment."""
    beyond = beyond_stops_deg(plane, points.angles_deg, points.rows[points.whose]).max(axis=1, initial=0.0)
    for robot, point in points.worst(plane, beyond):
        yield Violation("stops", robot.positioner_id, "", float(points.time_s[point]), float(beyond[point]))


def _gap(found: dict[str, Any]) -> float:
    return float(found["gap_mm"]) if found["robot"] >= 0 else float("inf")


def _motions(plane: FocalPlane, points: _Points) -> list[Floats]:
    """(n, 3) time, alpha, beta in s and rad per row of the plane."""
    motions: list[Floats | None] = [None] * plane.n
    for row in np.flatnonzero(plane.offline):
        motions[row] = np.array([[0.0, *deg_to_rad(plane.offline_position_deg[row])]])
    _refuse_endless(plane, points)
    for row, robot, way in zip(points.rows, points.robots, points.ways, strict=True):
        if plane.offline[row] and robot.moves:
            raise InputError(f"positioner {robot.positioner_id} is offline, but the plan moves it")
        if not plane.offline[row]:
            motions[row] = way
    missing = [int(p) for p, m in zip(plane.positioner_id, motions, strict=True) if m is None]
    if missing:
        raise InputError(
            f"the plan does not say where positioner {missing[0]} is ({len(missing)} missing); "
            "give one that does not move a single point"
        )
    return [m for m in motions if m is not None]


def _refuse_endless(plane: FocalPlane, points: _Points) -> None:
    """Before a proof begins that would not end. What is not finite is told as a violation."""
    far = np.nan_to_num(np.abs(points.angles_deg), posinf=0.0).max(axis=1, initial=0.0)
    for robot, point in points.worst(plane, np.where(far > MOST_DEG, far, 0.0)):
        raise InputError(
            f"positioner {robot.positioner_id} goes to {far[point]:g} deg; at most {MOST_DEG:g} deg is sound"
        )


def _approaches(
    plane: FocalPlane, plan: Plan, approach_deg: ArrayLike | None, limits: MotionLimits
) -> Floats:
    """(N,) rad from which positioners have to come at least; empty: not asked for."""
    if approach_deg is None:
        return np.zeros(0)
    asked = approach_rad(plane, approach_deg)
    if plan.approaches:
        own = plane.index_of(list(plan.approaches))
        asked[own] = least_approach_rad(plane, asked, limits.least_approach_deg)[own]
    return asked


def _last_legs(own: Approach) -> Iterator[tuple[float, float, float]]:
    """Of alpha and beta: height in rad, begin and end in s."""
    for height_deg, begin_s, end_s in zip(own.height_deg, own.begin_s, own.end_s, strict=True):
        yield float(deg_to_rad(height_deg)), begin_s, end_s


def _arrives(plane: FocalPlane, plan: Plan) -> Flags:
    arrives = ~plane.offline
    if plan.refused:
        arrives[plane.index_of(list(plan.refused))] = False
    return arrives


def _violation(plane: FocalPlane, kind: str, row: int, other: int, time_s: float, depth: float) -> Violation:
    name = ""
    bodies = kind in _CONTACTS + _COLLISIONS
    if bodies and kind in _WITH_ROBOTS and other >= 0:
        name = str(plane.positioner_id[other])
    elif bodies:
        name = obstacle_name(plane, other)
    size = depth if bodies else float(rad_to_deg(depth))
    return Violation(kind, int(plane.positioner_id[row]), name, time_s, size)
