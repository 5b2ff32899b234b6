"""Which positioner takes which target."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fiberloom.assignment.candidates import Block, Candidates, check_targets, find_candidates
from fiberloom.assignment.choose import LEVEL_WEIGHT, conflicts, levels_of, pack, shortlist
from fiberloom.assignment.clearance import sweep
from fiberloom.assignment.demanded import place_demanded
from fiberloom.assignment.park import park
from fiberloom.assignment.placement import Floor, Rules
from fiberloom.assignment.reasons import explain
from fiberloom.assignment.screen import screen, screen_placed
from fiberloom.instruments import FocalPlane
from fiberloom.targets import TargetList
from fiberloom.targets.target_list import FREE
from fiberloom.typing import Floats, Ints


@dataclass(frozen=True, eq=False)
class Assignment:
    """Where every positioner goes. Arrays over the N positioners of the plane."""

    target: Ints
    """Row of the target list; -1: none."""
    fibre: NDArray[np.str_]
    """Fibre that looks at the target; empty without one."""
    alpha_deg: Floats
    beta_deg: Floats
    """Goal; a safe folded place without a target; the place of the plane if offline."""
    approach_deg: Floats
    """Overshoot of the approach on both axes for which the goal was found free."""
    clearance_mm: Floats
    """Gap to the nearest other arm at the goal and on the approach; inf without neighbours."""
    unassigned: dict[int, str]
    """Row of the target list: why no positioner takes it."""
    notes: list[str]
    """What the operator should know: shorter approaches, targets given up, best not proven."""

    @property
    def goal_deg(self) -> Floats:
        """(N, 2) goals."""
        return np.column_stack([self.alpha_deg, self.beta_deg])

    @property
    def n_assigned(self) -> int:
        """Positioners with a target."""
        return int(np.count_nonzero(self.target >= 0))


def assign(
    plane: FocalPlane,
    targets: TargetList,
    *,
    seed: int = 0,
    approach_deg: float | None = None,
    margin_mm: float = 0.2,
) -> Assignment:
    """Give targets to positioners: most and highest-priority ones, no collision at rest.

    `plane` has N positioners, `targets` M rows in focal-plane mm. One target of a priority level
    outweighs nine of the next lower level. Every goal, goal + `approach_deg` on both axes, and the
    straight way between are free of collisions with every pose of the neighbours on their ways, for
    arms thicker by `margin_mm` / 2; and the positioner, alone, can get from there to its folded place.
    `approach_deg`: the instrument's when left out. The same input and seed give the same assignment;
    `seed` decides between equally good ones.

    Targets that demand a positioner get it before all others, without margin and, where needed, with an
    approach that only just closes the backlash; never below the collision buffer.
    """
    check_targets(plane, targets)
    if approach_deg is None:
        approach_deg = max(axis.approach_deg for axis in plane.instrument.axes)
    rules = Rules.of(plane, approach_deg, margin_mm)
    rng = np.random.default_rng(seed)
    floor = Floor(plane, np.full(plane.n, approach_deg))
    found = find_candidates(plane, targets)
    block = np.full(len(found), Block.NONE, dtype=np.int64)
    mine = targets.positioner_id[found.target] != FREE
    block[mine] = place_demanded(floor, found.select(mine), targets, rules, rng)
    block[~mine] = _place_free(floor, found.select(~mine), targets, rules, rng)
    rest = np.flatnonzero(~floor.placed)
    given_up = park(floor, rest, rules, _worth(floor, targets))
    unassigned = explain(floor, targets, found, block, given_up, rules.pair_mm)
    return _result(floor, unassigned, targets, given_up, rules)


def _place_free(
    floor: Floor, found: Candidates, targets: TargetList, rules: Rules, rng: np.random.Generator
) -> Ints:
    """Place targets that any positioner may take; (C,) what blocks each candidate."""
    plane = floor.plane
    segments = sweep(plane, found.positioner, found.goal_deg, rules.approach_deg)
    block = screen(plane, found, segments, rules.approach_deg, rules)
    screen_placed(floor, found, segments, block, rules.pair_mm)
    open_ = np.flatnonzero(block == Block.NONE)
    level = levels_of(targets.priority)[found.target]
    ok = open_[shortlist(found.positioner[open_], level[open_], rng)]
    some = found.select(ok)
    pairs = conflicts(plane, some.positioner, some.target, segments[ok], rules.pair_mm)
    chosen, proven = pack(some.positioner, some.target, level[ok], pairs, rng)
    if not proven or len(ok) < len(open_):
        floor.notes.append("the choice of targets is good, but not proven to be the best")
    rows = ok[chosen]
    floor.put(
        found.positioner[rows],
        found.goal_deg[rows],
        segments[rows],
        rules.approach_deg,
        found.target[rows],
        found.fibre[rows],
    )
    return block


def _worth(floor: Floor, targets: TargetList) -> Floats:
    """(N,) what it costs to send each positioner elsewhere; nearly nothing if it is parked."""
    has = floor.target >= 0
    worth = np.full(floor.plane.n, 1e-3)
    worth[has] = LEVEL_WEIGHT ** levels_of(targets.priority)[floor.target[has]]
    demanded = has.copy()
    demanded[has] = targets.positioner_id[floor.target[has]] != FREE
    worth[demanded] *= 1e20
    return worth


def _result(
    floor: Floor,
    unassigned: dict[int, str],
    targets: TargetList,
    given_up: dict[int, int],
    rules: Rules,
) -> Assignment:
    short = floor.approach_deg < rules.approach_deg
    names = ", ".join(map(str, floor.plane.positioner_id[short & (floor.target >= 0)]))
    notes = list(floor.notes)
    if names:
        least = floor.approach_deg[short].min()
        notes.append(f"approach of {least:.3f} deg instead of {rules.approach_deg:g} where the "
                     f"demanded places leave no room: positioners {names}")  # fmt: skip
    notes += [f"target {targets.target_id[row]}: {unassigned[row]}" for row in given_up]
    alpha, beta = floor.goal_deg.T.copy()
    return Assignment(
        target=floor.target,
        fibre=floor.fibre,
        alpha_deg=alpha,
        beta_deg=beta,
        approach_deg=np.where(floor.plane.offline, 0.0, floor.approach_deg),
        clearance_mm=floor.clearance_mm(),
        unassigned=unassigned,
        notes=notes,
    )
