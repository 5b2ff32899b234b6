"""Places for positioners without a target: folded, and out of the way of all others."""

import numpy as np

from fiberloom.assignment.candidates import WayRule, inside_stops
from fiberloom.assignment.clearance import obstacle_gap_mm, sweep
from fiberloom.assignment.placement import NO_TARGET, Placement, Rules
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints

STEP_ALPHA_DEG, STEP_BETA_DEG = 15.0, 10.0
"""Grid of places to try."""
BARRED = 0.01
"""A way that is barred costs so much of a target that is given up."""


def park(
    placement: Placement, rows: Ints, rules: Rules, worth: Floats, ways: WayRule | None = None
) -> dict[int, int]:
    """Place positioners without a target. Returns the targets given up, and for which positioner (row)
    each was.

    `placement` is changed; `rows`: the positioners to place; `rules`: distances to keep. First come all
    that are free in the folded place of the instrument, then one by one the first free place of a grid.
    Free ones do not bar the `ways` of neighbours either. Where none is free, the neighbours in the way of the
    place that costs least (`worth` (N,) of each neighbour, dimensionless weights, summed; a way that is
    barred costs `BARRED` of that) make room and are parked in their turn.
    """
    queue = _park_folded(placement, rows, rules, ways)
    worth = worth.copy()
    given_up: dict[int, int] = {}
    while queue:
        row = queue.pop(0)
        goals, segments = _places(placement.plane, row, rules)
        near, hit = placement.hits(row, segments, rules.pair_mm)
        bars = _barring(placement, row, goals, near, ways)
        best = _cheapest(row, goals, (hit + BARRED * bars) @ worth[near], rules)
        if best is None:
            _leave_folded(placement, row)
            continue
        for other in near[hit[best]].tolist():
            target = placement.take_away(other)
            if target != NO_TARGET:
                given_up[target] = row
            # so that two of them cannot push each other out for ever
            worth[other] *= 10.0
            queue.append(other)
        placement.put(row, goals[best], segments[best], rules.approach_deg)
    return given_up


def _barring(placement: Placement, row: int, goals: Floats, near: Ints, ways: WayRule | None) -> Flags:
    """(C, k) places `goals` (C, 2) of a positioner that bar the way of neighbours `near` (k,)."""
    if ways is None:
        return np.zeros((len(goals), len(near)), dtype=bool)
    mine, theirs = np.indices((len(goals), len(near))).reshape(2, -1)
    both = np.concatenate([np.full(len(goals), row), near])
    goal_deg = np.concatenate([goals, placement.goal_deg[near]])
    return ways.crossing(both, goal_deg, mine, len(goals) + theirs).reshape(len(goals), len(near))


def _places(plane: FocalPlane, row: int, rules: Rules) -> tuple[Floats, Floats]:
    """Goals (C, 2) and segments that only fixed bodies limit, the most folded first."""
    goals = _grid_deg(plane, row)
    rows = np.full(len(goals), row)
    segments = sweep(plane, rows, goals, rules.approach_deg)
    gap = obstacle_gap_mm(plane, rows, segments, rules.bodies)
    ok = (gap >= rules.gap_mm) & inside_stops(plane, rows, goals, rules.approach_deg)
    return goals[ok], segments[ok]


def _cheapest(row: int, goals: Floats, cost: Floats, rules: Rules) -> int | None:
    """The first of the cheapest places that can be left again."""
    order: list[int] = np.argsort(cost, kind="stable").tolist()
    for k in order:
        if rules.escape.can_fold(np.array([row]), goals[k : k + 1])[0]:
            return k
    return None


def _leave_folded(placement: Placement, row: int) -> None:
    """Nothing that moves could help: the positioner is walled in by what does not move."""
    plane = placement.plane
    goal = plane.park_deg[[row]]
    placement.put(row, goal[0], sweep(plane, np.array([row]), goal, 0.0)[0], 0.0)
    placement.notes.append(
        f"positioner {plane.positioner_id[row]}: no place free of fiducials, guide cameras and "
        "offline neighbours; left folded, in collision"
    )


def _park_folded(placement: Placement, rows: Ints, rules: Rules, ways: WayRule | None) -> list[int]:
    """Fold every positioner that can be folded; returns the others."""
    plane = placement.plane
    goals = plane.park_deg[rows]
    segments = sweep(plane, rows, goals, rules.approach_deg)
    free = obstacle_gap_mm(plane, rows, segments, rules.bodies) >= rules.gap_mm
    others = []
    for k, row in enumerate(rows.tolist()):
        near, hit = placement.hits(row, segments[k : k + 1], rules.pair_mm)
        if free[k] and not hit.any() and not _barring(placement, row, goals[k : k + 1], near, ways).any():
            placement.put(row, goals[k], segments[k], rules.approach_deg)
        else:
            others.append(row)
    return others


def _grid_deg(plane: FocalPlane, row: int) -> Floats:
    """Places to try, those nearest to the folded one in beta first, then in alpha."""
    park = plane.park_deg[row]
    axes = [
        _steps(p, low, high, step)
        for p, (low, high), step in zip(
            park, plane.limits_of(np.array([row]))[0], (STEP_ALPHA_DEG, STEP_BETA_DEG), strict=True
        )
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    away = np.abs(grid - park)
    return grid[np.lexsort((away[:, 0], away[:, 1]))]


def _steps(middle: float, low: float, high: float, step: float) -> Floats:
    below, above = np.ceil((low - middle) / step), np.floor((high - middle) / step)
    return middle + step * np.arange(below, above + 1)
