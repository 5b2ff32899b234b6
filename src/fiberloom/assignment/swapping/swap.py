"""An assignment and the plan of its motion, made together: targets are swapped where it is held up."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.assignment.assign import Assignment
from fiberloom.assignment.placement import Say, silent
from fiberloom.assignment.swapping.exchange import Choice, Exchanger
from fiberloom.assignment.ways import checked_start
from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan, PlanSettings, bound_s, plan
from fiberloom.targets import TargetList
from fiberloom.typing import Floats

LAST = 3
"""Of those that come late, so many at a time get other choices."""
GAIN_S = 0.1
"""Motion that is shorter by less is not shorter."""
REST_DEG = 0.01
"""An arm that is this near to the place above its goal is there."""


@dataclass(frozen=True)
class SwapSettings:
    """How hard to try, and by which rules."""

    plans: int = 4
    """At most so many plans are made after the first one."""
    late_s: float = 3.0
    """A positioner is late if it comes above its goal so much after the longest way could be done."""
    margin_mm: float = 0.2
    """Between two arms, as of the assignment."""
    planning: PlanSettings | None = None
    """Of every plan."""
    progress: Say = silent
    """Called with the name of each step."""


@dataclass(frozen=True, eq=False)
class Swapped:
    """The best assignment that was found, with its verified plan."""

    assignment: Assignment
    plan: Plan
    first: Plan
    """Of the assignment as it was given."""
    n_plans: int
    """How many were made, the first included."""
    cpu_s: float
    """Of all plans, s."""

    def __repr__(self) -> str:
        begin, end = self.first, self.plan
        refused = f"{len(begin.refused)} to {len(end.refused)} refused"
        return f"Swapped({begin.duration_s:.1f} to {end.duration_s:.1f} s, {refused}, {self.n_plans} plans)"


def swap_targets(
    plane: FocalPlane,
    targets: TargetList,
    found: Assignment,
    start_deg: ArrayLike,
    *,
    seed: int = 0,
    settings: SwapSettings | None = None,
) -> Swapped:
    """Plan the motion to an assignment; where positioners are refused or late, swap targets and plan again.

    A positioner that the plan refuses, or that comes late, gets another choice, together with its neighbours
    and theirs: cycles of any length among them, and targets of the same priority that are free. If it has no
    other choice, its nearest neighbours get one. As many targets of each priority are observed as before. A
    plan is kept if it refuses fewer, or as many in less time; every plan is verified.

    Parameters
    ----------
    plane : FocalPlane
        N positioners.
    targets : TargetList
        n targets in mm, as given to `assign`.
    found : Assignment
        Of these targets; best made with the same start.
    start_deg : array_like
        (N, 2) where the positioners are, deg.
    seed : int
        Of the planner.
    settings : SwapSettings, optional
        How many plans are made at most; margin of the assignment.

    Returns
    -------
    Swapped
        The best assignment and its plan.

    Raises
    ------
    InputError
        A start of another shape, or beyond the hard stops.

    Examples
    --------
    >>> import fiberloom as fl
    >>> from fiberloom.assignment import swap_targets
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> targets = fl.read_targets("targets.csv")
    >>> assigned = fl.assign(plane, targets, start_deg=plane.park_deg)
    >>> swap_targets(plane, targets, assigned, plane.park_deg).plan.refused
    {}
    """
    settings = settings or SwapSettings()
    start = checked_start(plane, start_deg)
    exchanger = Exchanger(plane, targets, start, settings.margin_mm)

    def planned(assigned: Assignment) -> Plan:
        return plan(
            plane,
            start,
            assigned.goal_deg,
            seed=seed,
            approach_deg=assigned.approach_deg,
            settings=settings.planning,
        )

    return _SwapSearch(exchanger, settings, planned).run(found)


class _SwapSearch:
    """Tries other choices for what holds the motion up, and keeps the best."""

    def __init__(
        self, exchanger: Exchanger, settings: SwapSettings, planned: Callable[[Assignment], Plan]
    ) -> None:
        self.exchanger, self.settings, self.planned = exchanger, settings, planned
        self.avoid: set[Choice] = set()
        self.n_plans, self.cpu_s = 0, 0.0

    def run(self, found: Assignment) -> Swapped:
        self.settings.progress("planning the motion")
        best, made = found, self._plan(found)
        first = made
        while self.n_plans <= self.settings.plans:
            held_up = self._held_up(best, made)
            if not self._avoid_more(best, held_up):
                break
            tried = self.exchanger.exchanged(best, held_up, self.avoid)
            if tried is None:
                continue
            self.settings.progress(f"swapping targets, plan {self.n_plans + 1}")
            other = self._plan(tried)
            if _is_better(other, made):
                best, made = tried, other
        return Swapped(best, made, first, self.n_plans, self.cpu_s)

    def _plan(self, assigned: Assignment) -> Plan:
        made = self.planned(assigned)
        self.n_plans, self.cpu_s = self.n_plans + 1, self.cpu_s + made.cpu_s
        return made

    def _held_up(self, assigned: Assignment, made: Plan) -> list[int]:
        """Rows of those that the plan refuses, then of the last that come late."""
        plane, start = self.exchanger.plane, self.exchanger.start_deg
        refused: list[int] = plane.index_of(list(made.refused)).tolist() if made.refused else []
        least_s = bound_s(
            plane, start, assigned.goal_deg, settings=self.settings.planning, refused=made.refused
        )
        above_s = arrivals_s(made, assigned.approach_deg)
        order: list[int] = np.argsort(-above_s, kind="stable")[:LAST].tolist()
        late = [row for row in order if above_s[row] > least_s + self.settings.late_s and row not in refused]
        return refused + late

    def _avoid_more(self, assigned: Assignment, held_up: list[int]) -> bool:
        """Avoids what each has; where that was tried, what its nearest neighbour has, and so on."""
        found = False
        for row in held_up:
            for one in (row, *self.exchanger.nearest(assigned, row)):
                choice = one, int(assigned.target[one])
                if choice not in self.avoid:
                    self.avoid.add(choice)
                    found = True
                    break
        return found


def _is_better(one: Plan, other: Plan) -> bool:
    if len(one.refused) != len(other.refused):
        return len(one.refused) < len(other.refused)
    return one.duration_s < other.duration_s - GAIN_S


def arrivals_s(made: Plan, approach_deg: Floats) -> Floats:
    """(N,) when each positioner is above its goal for good, s: before its approach; 0 if it does not move.

    `approach_deg` (N,): overshoot of the approaches.
    """
    out = np.zeros(len(made.robots))
    for row, robot in enumerate(made.robots):
        angles = np.column_stack([robot.alpha_deg, robot.beta_deg])
        away = np.abs(angles - angles[-1]).max(axis=1) > approach_deg[row] + REST_DEG
        if away.any():
            out[row] = robot.time_s[np.flatnonzero(away)[-1] + 1]
    return out
