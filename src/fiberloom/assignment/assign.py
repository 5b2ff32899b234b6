"""Which positioner takes which target."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom.assignment.candidates import Block, Candidates, WayRule, check_targets, find_candidates
from fiberloom.assignment.choose import LEVEL_WEIGHT, STRICT_LEVELS, conflicts, pack, shortlist
from fiberloom.assignment.clearance import sweep
from fiberloom.assignment.demanded import place_demanded
from fiberloom.assignment.other_units import unit_hint
from fiberloom.assignment.park import park
from fiberloom.assignment.placement import Placement, Rules, Say, silent
from fiberloom.assignment.reasons import explain, kinds
from fiberloom.assignment.screen import screen, screen_placed
from fiberloom.assignment.ways import Preference, checked_start
from fiberloom.instruments import FocalPlane
from fiberloom.targets import TargetList
from fiberloom.targets.target_list import FREE
from fiberloom.timing import part
from fiberloom.typing import Floats, Ints

STRICT_WORTH = 100.0
"""The same where levels are strict: more than an arm has neighbours."""


@dataclass(frozen=True)
class AssignSettings:
    """How to assign."""

    margin_mm: float = 0.2
    """Between two arms, beyond touching, mm."""
    strict: bool = False
    """No number of targets of lower priority outweighs one of higher priority."""
    progress: Say = silent
    """Called with the name of each step."""
    ways: WayRule | None = None
    """What the drive asks of targets that a positioner may choose; None: nothing."""


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
    """Gap to the nearest other arm at the goal and on the approach, among those that can come within 1 mm;
    inf without."""
    unassigned: dict[int, str]
    """Row of the target list: why no positioner takes it."""
    notes: list[str]
    """What the operator should know: shorter approaches, targets given up, best not proven."""
    lead_mm: Floats | None = None
    """(N, 2) by which a fibre is placed beside its target, for what moves it until the exposure; None: 0."""

    def __repr__(self) -> str:
        return (
            f"Assignment({len(self.target)} positioners, {self.n_assigned} with a target, "
            f"{len(self.unassigned)} targets left out)"
        )

    @property
    def goal_deg(self) -> Floats:
        """(N, 2) goals."""
        return np.column_stack([self.alpha_deg, self.beta_deg])

    @property
    def n_assigned(self) -> int:
        """Positioners with a target."""
        return int(np.count_nonzero(self.target >= 0))

    def reasons(self) -> dict[str, int]:
        """How many targets were left out for each kind of reason, the most frequent first."""
        return kinds(self.unassigned.values())


@part("assignment")
def assign(
    plane: FocalPlane,
    targets: TargetList,
    *,
    seed: int = 0,
    approach_deg: float | None = None,
    start_deg: ArrayLike | None = None,
    settings: AssignSettings | None = None,
) -> Assignment:
    """Give targets to positioners: most and highest-priority ones, no collision at rest.

    One target of a priority level outweighs nine of the next lower level; or any number, if the settings are
    strict. Every goal, goal + approach_deg on both axes, and the straight way between are free of collisions
    with every pose of the neighbours on their ways, for arms thicker by half of the margin; and the
    positioner, alone, can get from there to its folded place. Targets that demand a positioner get it before
    all others, without margin and, where needed, with an approach that only just closes the backlash; never
    below the collision buffer.

    Parameters
    ----------
    plane : FocalPlane
        N positioners.
    targets : TargetList
        n targets, mm.
    seed : int
        Decides between equally good assignments; the same input and seed give the same one.
    approach_deg : float, optional
        Overshoot of the approach on both axes, deg; the instrument's when left out.
    start_deg : array_like, optional
        (N, 2) where the positioners are, deg. Of equally good assignments it is then the one of the shortest
        ways: the least sum of fourth powers of max over axes of (abs(goal + approach - start) + approach).
    settings : AssignSettings, optional
        Margin between arms, strict priorities.

    Returns
    -------
    Assignment
        For every positioner its target (-1: none), fibre and goal in deg; why targets were left out.

    Raises
    ------
    InputError
        A target demands a fibre or a positioner that there is not; start_deg has another shape.

    Examples
    --------
    >>> import fiberloom as fl
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> assigned = fl.assign(plane, fl.read_targets("targets.csv"))
    >>> assigned
    Assignment(7 positioners, 7 with a target, 53 targets left out)
    >>> assigned.goal_deg.shape
    (7, 2)
    """
    check_targets(plane, targets)
    settings = settings or AssignSettings()
    if approach_deg is None:
        approach_deg = plane.instrument.approach_deg
    start = None if start_deg is None else checked_start(plane, start_deg)
    by = Preference(settings.strict, start, plane.instrument.approach_sides, settings.ways)
    rules = Rules.of(plane, approach_deg, settings.margin_mm)
    rng = np.random.default_rng(seed)
    placement = Placement(plane, np.full(plane.n, approach_deg))
    settings.progress(f"finding who reaches which of {len(targets)} targets")
    found = find_candidates(plane, targets)
    block = np.full(len(found), Block.NONE, dtype=np.int64)
    mine = targets.positioner_id[found.target] != FREE
    block[mine] = place_demanded(placement, found.select(mine), targets, rules, rng, by)
    settings.progress(f"choosing for {plane.n} positioners")
    block[~mine] = _place_free(placement, found.select(~mine), targets, rules, rng, by)
    settings.progress("placing positioners without a target")
    return finished(placement, targets, found, block, rules, by)


def finished(
    placement: Placement,
    targets: TargetList,
    found: Candidates,
    block: Ints,
    rules: Rules,
    by: Preference,
) -> Assignment:
    """The assignment once targets are chosen: the others are parked, and it is told why targets are left out.

    `placement` of N positioners is changed; `targets`: the whole list; `found`: all C candidates; `block`
    (C,): what blocks each (`Block`); `rules`: distances in mm; `by`: what is preferred.
    """
    rest = np.flatnonzero(~placement.placed)
    given_up = park(placement, rest, rules, _worth(placement, targets, by), by.ways)
    unassigned = explain(placement, targets, found, block, given_up, rules.pair_mm)
    _note_bands(placement, targets, by)
    return _result(placement, unassigned, targets, given_up, rules)


def _place_free(
    placement: Placement,
    found: Candidates,
    targets: TargetList,
    rules: Rules,
    rng: np.random.Generator,
    by: Preference,
) -> Ints:
    """Place targets that any positioner may take; (C,) what blocks each candidate."""
    segments, block = screened(placement, found, rules, by)
    open_ = np.flatnonzero(block == Block.NONE)
    level, wish = by.levels(targets.priority)[found.target], by.wish(found, rules.approach_deg)
    few = shortlist(found.positioner[open_], level[open_], rng, wish.select(open_))
    ok = open_[few]
    some = found.select(ok)
    pairs = conflicts(placement.plane, some, segments[ok], rules.pair_mm, by.ways)
    chosen, proven = pack(some.positioner, some.target, level[ok], pairs, rng, wish.select(ok))
    if not proven or len(ok) < len(open_):
        placement.notes.append("the choice of targets is good, but not proven to be the best")
    rows = ok[chosen]
    placement.put(
        found.positioner[rows],
        found.goal_deg[rows],
        segments[rows],
        rules.approach_deg,
        found.target[rows],
        found.fibre[rows],
    )
    return block


def screened(placement: Placement, found: Candidates, rules: Rules, by: Preference) -> tuple[Floats, Ints]:
    """Centre lines of each candidate, (C, POSES, P, 4) mm, and (C,) what blocks it whatever others do.

    `placement`: what is placed already; `found`: C candidates; `rules`: distances in mm; `by`: with the rule
    of ways.
    """
    plane = placement.plane
    segments = sweep(plane, found.positioner, found.goal_deg, rules.approach_deg)
    block = screen(plane, found, segments, rules.approach_deg, rules)
    screen_placed(placement, found, segments, block, rules.pair_mm)
    if by.ways is not None:
        free = np.flatnonzero(block == Block.NONE)
        block[free] = by.ways.blocks(found.positioner[free], found.goal_deg[free])
    return segments, block


def _worth(placement: Placement, targets: TargetList, by: Preference) -> Floats:
    """(N,) what it costs to send each positioner elsewhere; nearly nothing if it is parked."""
    has = placement.target >= 0
    worth = np.full(placement.plane.n, 1e-3)
    one = STRICT_WORTH if by.strict else LEVEL_WEIGHT
    worth[has] = one ** by.levels(targets.priority)[placement.target[has]]
    demanded = has.copy()
    demanded[has] = targets.positioner_id[placement.target[has]] != FREE
    worth[demanded] *= 1e20
    return worth


def _note_bands(placement: Placement, targets: TargetList, by: Preference) -> None:
    """Says so where priorities are too many to be told apart strictly."""
    n = len(np.unique(targets.priority))
    if by.strict and n > STRICT_LEVELS:
        placement.notes.append(
            f"{n} different priorities are put into {STRICT_LEVELS} bands of equal size: "
            "strict between bands, all the same within one"
        )


def _result(
    placement: Placement,
    unassigned: dict[int, str],
    targets: TargetList,
    given_up: dict[int, int],
    rules: Rules,
) -> Assignment:
    short = placement.approach_deg < rules.approach_deg
    names = ", ".join(map(str, placement.plane.positioner_id[short & (placement.target >= 0)]))
    notes = list(placement.notes)
    if names:
        least = placement.approach_deg[short].min()
        notes.append(f"approach of {least:.3f} deg instead of {rules.approach_deg:g} where the "
                     f"demanded places leave no room: positioners {names}")  # fmt: skip
    notes += [f"target {targets.target_id[row]}: {unassigned[row]}" for row in given_up]
    hint = unit_hint(placement.plane, targets, int((placement.target >= 0).sum()))
    notes += [hint] if hint else []
    alpha, beta = placement.goal_deg.T.copy()
    return Assignment(
        target=placement.target,
        fibre=placement.fibre,
        alpha_deg=alpha,
        beta_deg=beta,
        approach_deg=np.where(placement.plane.offline, 0.0, placement.approach_deg),
        clearance_mm=placement.clearance_mm(),
        unassigned=unassigned,
        notes=notes,
    )
