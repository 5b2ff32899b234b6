"""Targets change hands among neighbours: as many of each priority as before, on other ways."""

from collections.abc import Iterable, Set
from dataclasses import dataclass, field, replace

import numpy as np

from fiberloom.assignment.assign import Assignment
from fiberloom.assignment.candidates import Block, Candidates, find_candidates
from fiberloom.assignment.choose import conflicts, exchange
from fiberloom.assignment.clearance import gaps_mm, places, sweep
from fiberloom.assignment.placement import NO_TARGET, Placement, Rules
from fiberloom.assignment.screen import screen, screen_placed
from fiberloom.assignment.ways import way_cost, way_deg
from fiberloom.instruments import FocalPlane
from fiberloom.targets import TargetList
from fiberloom.targets.target_list import FREE
from fiberloom.typing import Flags, Floats, Ints

RINGS = 2
"""Targets change hands among a positioner, its neighbours and theirs."""
AVOIDED = 10.0
"""Cost of a choice that is to be avoided: more than some of the longest ways."""
CHANGED = 1e-3
"""Cost of any change: what gains nothing stays as it is."""
REASON = "exchanged for a target of the same priority, for the sake of the motion"

Choice = tuple[int, int]
"""Row of a positioner, and of its target; NO_TARGET without one."""


@dataclass
class Exchanger:
    """Exchanges targets on one plane, for ways from one start."""

    plane: FocalPlane
    targets: TargetList
    start_deg: Floats
    """(N, 2) where the positioners are."""
    margin_mm: float = 0.2
    """Between two arms, as of the assignment."""
    rules: Rules = field(init=False)

    def __post_init__(self) -> None:
        self.rules = Rules.of(self.plane, self.plane.instrument.approach_deg, self.margin_mm)

    def exchanged(
        self, found: Assignment, rows: Iterable[int], avoid: Set[Choice] = frozenset()
    ) -> Assignment | None:
        """The assignment with other choices around these positioners; None where nothing changes.

        As many targets of each priority as in `found` are observed, by the same rules for places; which ones
        may change. Among `rows` and two rings of neighbours it is the choice with the least sum of the costs
        of ways, where choices to `avoid` are dearer than any way. Positioners whose target demands them,
        and those whose approach is not the usual one, keep what they have.
        """
        members = self._members(found, rows)
        if not len(members):
            return None
        choices, present = self._choices(found, members)
        segments = sweep(self.plane, choices.positioner, choices.goal_deg, self.rules.approach_deg)
        open_ = np.flatnonzero(self._is_open(found, members, choices, segments))
        some, now = choices.select(open_), present[open_]
        pairs = conflicts(self.plane, some, segments[open_], self.rules.pair_mm)
        kind, numbers = self._kinds(some.target, now)
        cost = self._cost(some, now, avoid)
        chosen = exchange(some.positioner, some.target, kind, pairs, numbers, cost)
        if chosen is None or now.sum() < len(members) or (chosen == now).all():
            return None
        return self._result(found, some.select(chosen), segments[open_[chosen]])

    def nearest(self, found: Assignment, row: int) -> list[int]:
        """The positioners that a positioner can touch and that can move, the nearest at the goals first."""
        placement = self._placed(found, np.ones(self.plane.n, dtype=bool))
        near = placement.neighbours[row]
        near = near[~self.plane.offline[near]]
        arms = places(self.plane, np.arange(self.plane.n), placement.segments)
        order: list[int] = near[np.argsort(gaps_mm(arms, np.full(len(near), row), arms, near))].tolist()
        return order

    def _members(self, found: Assignment, rows: Iterable[int]) -> Ints:
        """Rows of the positioners that may choose anew."""
        pairs = self.plane.neighbour_pairs(1.0)
        inside = np.zeros(self.plane.n, dtype=bool)
        inside[list(rows)] = True
        for _ in range(RINGS):
            inside[pairs[inside[pairs].any(axis=1)]] = True
        demanded = self.targets.positioner_id[found.target[found.target >= 0]] != FREE
        inside[np.flatnonzero(found.target >= 0)[demanded]] = False
        usual = np.abs(found.approach_deg - self.rules.approach_deg) < 1e-9
        return np.flatnonzero(inside & usual & ~self.plane.offline)

    def _choices(self, found: Assignment, members: Ints) -> tuple[Candidates, Flags]:
        """What the members could do: take a target, fold, or stay without one; and what they do now (C,)."""
        reached = find_candidates(self.plane.select(members), self.targets)
        reached = replace(reached, positioner=members[reached.positioner])
        # those who keep their targets would be in the way there, too; so the programme is smaller
        others = np.delete(found.target, members)
        free = (self.targets.positioner_id[reached.target] == FREE) & ~np.isin(reached.target, others)
        reached = reached.select(free)
        idle = members[found.target[members] < 0]
        folded = self.plane.park_deg[members]
        waits = np.concatenate([members, idle])
        # without a target: each positioner has one of its own that is none
        all_ = Candidates(
            np.concatenate([reached.positioner, waits]),
            np.concatenate([reached.target, len(self.targets) + waits]),
            np.concatenate([reached.fibre, np.full(len(waits), "")]),
            np.vstack([reached.goal_deg, folded, found.goal_deg[idle]]),
        )
        all_ = all_.select(np.lexsort((all_.target, all_.positioner)))
        mine = np.where(found.target < 0, len(self.targets) + np.arange(self.plane.n), found.target)
        same = np.abs(all_.goal_deg - found.goal_deg[all_.positioner]).max(axis=1) < 1e-9
        present = same & (all_.target == mine[all_.positioner])
        # one that waits folded is there twice
        first = np.unique(all_.positioner[present], return_index=True)[1]
        once = np.zeros(len(all_), dtype=bool)
        once[np.flatnonzero(present)[first]] = True
        return all_, once

    def _is_open(self, found: Assignment, members: Ints, choices: Candidates, segments: Floats) -> Flags:
        """(C,) which choices keep the rules beside all that are not members."""
        others = np.ones(self.plane.n, dtype=bool)
        others[members] = False
        block = screen(self.plane, choices, segments, self.rules.approach_deg, self.rules)
        screen_placed(self._placed(found, others), choices, segments, block, self.rules.pair_mm)
        open_: Flags = block == Block.NONE
        return open_

    def _placed(self, found: Assignment, which: Flags) -> Placement:
        """A placement with these positioners (N,) at their goals."""
        placement = Placement(self.plane, found.approach_deg.copy())
        rows = np.flatnonzero(which & ~self.plane.offline)
        goal, approach = found.goal_deg[rows], found.approach_deg[rows]
        segments = sweep(self.plane, rows, goal, approach)
        placement.put(rows, goal, segments, approach, found.target[rows], found.fibre[rows])
        return placement

    def _kinds(self, target: Ints, present: Flags) -> tuple[Ints, Ints]:
        """(C,) number of the priority of each choice, the last for none; and how many of each there are."""
        values, kind = np.unique(self.targets.priority, return_inverse=True)
        kind = np.append(kind, len(values))[np.minimum(target, len(self.targets))]
        return kind, np.bincount(kind[present], minlength=len(values) + 1)

    def _cost(self, choices: Candidates, present: Flags, avoid: Set[Choice]) -> Floats:
        start, sides = self.start_deg[choices.positioner], self.plane.instrument.approach_sides
        way = way_deg(start, choices.goal_deg, self.rules.approach_deg, sides)
        cost = way_cost(way) + CHANGED * ~present
        target = np.where(choices.target < len(self.targets), choices.target, NO_TARGET).tolist()
        avoided = [pair in avoid for pair in zip(choices.positioner.tolist(), target, strict=True)]
        cost[np.array(avoided, dtype=bool)] += AVOIDED
        return cost

    def _result(self, found: Assignment, new: Candidates, segments: Floats) -> Assignment:
        """The assignment with new choices of some positioners."""
        placement = self._placed(found, np.ones(self.plane.n, dtype=bool))
        target = np.where(new.target < len(self.targets), new.target, NO_TARGET)
        placement.put(new.positioner, new.goal_deg, segments, self.rules.approach_deg, target, new.fibre)
        lost = set(found.target.tolist()) - set(placement.target.tolist()) - {NO_TARGET}
        taken = set(placement.target.tolist())
        unassigned = {row: why for row, why in found.unassigned.items() if row not in taken}
        alpha, beta = placement.goal_deg.T.copy()
        return replace(
            found,
            target=placement.target,
            fibre=placement.fibre,
            alpha_deg=alpha,
            beta_deg=beta,
            approach_deg=np.where(self.plane.offline, 0.0, placement.approach_deg),
            clearance_mm=placement.clearance_mm(),
            unassigned=unassigned | dict.fromkeys(sorted(lost), REASON),
        )
