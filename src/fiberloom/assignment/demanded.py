"""Targets that demand their positioner: honoured before all others."""

from dataclasses import replace

import numpy as np

from fiberloom.assignment.candidates import Block, Candidates
from fiberloom.assignment.choose import conflicts, pack
from fiberloom.assignment.clearance import dip_mm, obstacles, sweep
from fiberloom.assignment.escape import Escape
from fiberloom.assignment.placement import Placement, Rules
from fiberloom.assignment.screen import screen
from fiberloom.assignment.ways import Preference
from fiberloom.instruments import FocalPlane
from fiberloom.targets import TargetList
from fiberloom.typing import Floats, Ints


def place_demanded(
    placement: Placement,
    found: Candidates,
    targets: TargetList,
    rules: Rules,
    rng: np.random.Generator,
    by: Preference,
) -> Ints:
    """Place the targets that demand their positioner; (C,) what blocks each candidate (`Block`).

    `placement` is changed; `found`: the C candidates of these targets, rows of `targets`; `rules`:
    distances to keep; `rng` and `by` decide between choices. The operator chose these places, so
    they need the collision buffer and no margin. Where the approach is too long for that, it shrinks to
    what closes the backlash.
    """
    plane = placement.plane
    bare = replace(
        rules,
        pair_mm=dip_mm(plane, rules.approach_deg),
        gap_mm=dip_mm(plane, rules.approach_deg, bodies=1),
        escape=Escape(plane, obstacles(plane, 0.0)),
    )
    approach = np.full(len(found), rules.approach_deg)
    least_deg = min(bare.approach_deg, plane.instrument.least_approach_deg)
    approach[_crowded(plane, found, approach, bare)] = least_deg
    segments = sweep(plane, found.positioner, found.goal_deg, approach)
    block = screen(plane, found, segments, approach, bare)
    ok = np.flatnonzero(block == Block.NONE)
    some = found.select(ok)
    pairs = conflicts(plane, some, segments[ok], bare.pair_mm)
    level = by.levels(targets.priority)[some.target]
    wish = by.wish(some, approach[ok])
    chosen, proven = pack(some.positioner, some.target, level, pairs, rng, wish)
    block[ok[~chosen]] = Block.ARM
    rows = ok[chosen]
    placement.put(
        found.positioner[rows],
        found.goal_deg[rows],
        segments[rows],
        approach[rows],
        found.target[rows],
        found.fibre[rows],
    )
    if not proven:
        placement.notes.append("demanded targets: the choice among colliding ones may not be the best")
    return block


def _crowded(plane: FocalPlane, found: Candidates, approach: Floats, rules: Rules) -> Ints:
    """Candidates that the usual approach would bring into collision."""
    segments = sweep(plane, found.positioner, found.goal_deg, approach)
    block = screen(plane, found, segments, approach, rules)
    pairs = conflicts(plane, found, segments, rules.pair_mm)
    return np.unique(np.concatenate([np.flatnonzero(block != Block.NONE), *pairs]))
