"""What rules a candidate out by itself, whatever the others do."""

import numpy as np

from fiberloom.assignment.candidates import Block, Candidates, inside_stops
from fiberloom.assignment.clearance import obstacle_gap_mm, places, too_near
from fiberloom.assignment.placement import Placement, Rules
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats, Ints


def screen(
    plane: FocalPlane, found: Candidates, segments: Floats, approach: float | Floats, rules: Rules
) -> Ints:
    """(C,) `Block` of each candidate: offline, beyond a stop, on a fixed body, or in a pocket.

    `found`: C candidates on the `plane`; `segments` (C, POSES, P, 4) mm: their centre lines; `approach`:
    overshoot in deg, one or (C,); `rules`: distances to keep.
    """
    block = np.full(len(found), Block.NONE, dtype=np.int64)
    gap = obstacle_gap_mm(plane, found.positioner, segments, rules.bodies)
    block[gap < rules.gap_mm] = Block.BODY
    block[~inside_stops(plane, found.positioner, found.goal_deg, approach)] = Block.STOPS
    block[plane.offline[found.positioner]] = Block.OFFLINE
    ok = np.flatnonzero(block == Block.NONE)
    folds = rules.escape.can_fold(found.positioner[ok], found.goal_deg[ok])
    block[ok[~folds]] = Block.POCKET
    return block


def screen_placed(
    placement: Placement, found: Candidates, segments: Floats, block: Ints, limit_mm: float
) -> None:
    """Block also candidates that are taken, or too near to a positioner that is placed already.

    `placement`: the placement; `found`: C candidates; `segments` (C, POSES, P, 4) mm: their centre lines;
    `block` (C,) is changed; `limit_mm`: least gap between two arms.
    """
    moving = placement.placed & ~placement.plane.offline
    block[(block == Block.NONE) & moving[found.positioner]] = Block.BUSY
    ok = np.flatnonzero(block == Block.NONE)
    near = [placement.neighbours[row][moving[placement.neighbours[row]]] for row in range(placement.plane.n)]
    mine = np.repeat(ok, [len(near[row]) for row in found.positioner[ok]])
    others = np.concatenate([*(near[row] for row in found.positioner[ok]), np.empty(0, np.int64)])
    others = others.astype(np.int64)
    plane = placement.plane
    wanted, there = (
        places(plane, found.positioner, segments),
        places(plane, np.arange(plane.n), placement.segments),
    )
    bad = too_near(wanted, mine, there, others, limit_mm)
    block[np.unique(mine[bad])] = Block.ARM
