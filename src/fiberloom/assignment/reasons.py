"""Why a target has no positioner, in words."""

import re
from collections import Counter
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from fiberloom.assignment.candidates import Block, Candidates
from fiberloom.assignment.clearance import sweep
from fiberloom.assignment.placement import Placement
from fiberloom.instruments import FocalPlane
from fiberloom.targets import TargetList
from fiberloom.targets.target_list import FREE
from fiberloom.typing import Floats, Ints

WORDS = {
    Block.OFFLINE: "is offline",
    Block.BUSY: "has a target of its own, demanded by the list",
    Block.STOPS: "would run into a hard stop on the approach",
    Block.BODY: "would touch a fiducial, a guide camera or an offline neighbour",
    Block.POCKET: "could not get there past what does not move",
    Block.EDGE: "might not reach it: so near to an end of its reach, by what is not known of its arms",
    Block.DARK: "would have its fibre behind its dot, where no image shows it",
    Block.ARM: "would touch a neighbour whose target the list demands",
}


_DETAILS = re.compile(r"[:;,(].*", re.DOTALL)
_NAMED = re.compile(r"\bpositioner \d+")


def kinds(reasons: Iterable[str]) -> dict[str, int]:
    """How many there are of each kind of reason, without the numbers that differ; most frequent first."""
    short = (_NAMED.sub("its positioner", _DETAILS.sub("", reason)).strip() for reason in reasons)
    return dict(Counter(short).most_common())


def explain(
    placement: Placement,
    targets: TargetList,
    found: Candidates,
    block: Ints,
    given_up: dict[int, int],
    limit_mm: float,
) -> dict[int, str]:
    """The reason for each target without a positioner, by its row in `targets`.

    `placement`: the placement; `found`: all C candidates; `block` (C,): what blocks each (`Block`);
    `given_up`: target row -> positioner row that needed its place; `limit_mm`: least gap between two
    arms.
    """
    plane = placement.plane
    taken = np.zeros(len(targets), dtype=bool)
    taken[placement.target[placement.target >= 0]] = True
    by_target = np.argsort(found.target, kind="stable")
    ends = np.searchsorted(found.target[by_target], np.arange(len(targets) + 1))
    out = {}
    for row in np.flatnonzero(~taken).tolist():
        mine = by_target[ends[row] : ends[row + 1]]
        if row in given_up:
            for_whom = plane.positioner_id[given_up[row]]
            out[row] = f"given up: positioner {for_whom} has no safe place otherwise"
        elif not len(mine):
            out[row] = _out_of_reach(plane, targets, row)
        elif block[mine].all():
            out[row] = _blocked(plane, found, block, mine)
        else:
            open_ = mine[block[mine] == Block.NONE]
            out[row] = _lost(placement, targets, found.select(open_), limit_mm)
    return out


def _out_of_reach(plane: FocalPlane, targets: TargetList, row: int) -> str:
    rows = np.arange(plane.n)
    if targets.positioner_id[row] != FREE:
        rows = plane.index_of(targets.positioner_id[row : row + 1])
    asked = str(targets.fibre[row])
    gaps = {fibre: _gaps(plane, targets, row, fibre, rows) for fibre in plane.science_fibres}
    wanted = gaps[asked] if asked else np.minimum.reduce(list(gaps.values()))
    if asked and any((gap == 0).any() for gap in gaps.values()) and not (wanted == 0).any():
        return f"no positioner with fibre {asked} in reach"
    if not len(rows) or not np.isfinite(wanted).any():
        return f"no positioner with fibre {asked or 'for science'}"
    nearest = int(np.argmin(wanted))
    name = f"positioner {plane.positioner_id[rows[nearest]]}"
    if wanted[nearest] == 0:
        return f"out of the axis limits of {name}"
    whom = f"of every positioner: {name} is the nearest" if len(rows) > 1 else f"of {name}"
    return f"out of reach {whom}, gap {wanted[nearest]:.3f} mm"


def _gaps(plane: FocalPlane, targets: TargetList, row: int, fibre: str, rows: Ints) -> Floats:
    return plane.inverse(targets.place_mm(fibre)[row], fibre, rows).gap_mm


def _blocked(plane: FocalPlane, found: Candidates, block: Ints, mine: NDArray[np.intp]) -> str:
    nearest = mine[np.argmax(block[mine])]
    positioner = plane.positioner_id[found.positioner[nearest]]
    others = len(np.unique(found.positioner[mine])) - 1
    more = f"; {others} more in reach are ruled out too" if others else ""
    return f"positioner {positioner} {WORDS[Block(block[nearest])]}{more}"


def _lost(placement: Placement, targets: TargetList, mine: Candidates, limit_mm: float) -> str:
    """Positioners that could take it have another target, or are kept off by a neighbour."""
    plane = placement.plane
    idle = np.flatnonzero(placement.target[mine.positioner] < 0)
    for k in idle.tolist():
        row = int(mine.positioner[k])
        segments = sweep(plane, mine.positioner[k : k + 1], mine.goal_deg[k : k + 1],
                         placement.approach_deg[row])  # fmt: skip
        near, hit = placement.hits(row, segments, limit_mm)
        if hit.any():
            other = int(near[np.argmax(hit[0])])
            return (
                f"collision: positioner {plane.positioner_id[row]} would touch positioner "
                f"{plane.positioner_id[other]}{_busy_with(placement, targets, other)}"
            )
    best = int(np.argmax(targets.priority[placement.target[mine.positioner]]))
    row = int(mine.positioner[best])
    return f"lost to another target: positioner {plane.positioner_id[row]}" + _busy_with(
        placement, targets, row
    )


def _busy_with(placement: Placement, targets: TargetList, row: int) -> str:
    target = int(placement.target[row])
    if target < 0:
        return ", which is parked"
    return f", which has {targets.target_id[target]} (priority {targets.priority[target]:g})"
