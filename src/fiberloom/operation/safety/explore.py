"""Small moves that tell where a positioner is, each proven safe for every place at which it may be.

The begin check leaves positioners whose spot cannot be told from others, and arms folded onto their axis.
For each place that is possible (a hypothesis) the same small relative move is verified; only a move that
is clear in all of them is made. The next image shows which spot has moved as one of them predicts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan, Trajectory, verify
from fiberloom.typing import Floats, Ints

WAYS_DEG = tuple(way for size in (6.0, 3.0) for way in ((0.0, -size), (0.0, size), (size, 0.0), (-size, 0.0)))
"""Moves of alpha and beta that are tried, the first that is safe is made."""

SPEED_DEG_S = 4.0
"""A third of the usual speed: little is swept before a collision is noticed."""

SAME_MM = 0.15
"""A spot this near to a prediction is the one that was predicted; maps err by less within six degrees."""

ALPHAS = 24
"""Directions of an arm that is folded onto its axis."""


@dataclass(frozen=True, eq=False)
class Doubt:
    """One positioner and where it may be."""

    row: int
    places_deg: Floats
    """(H, 2) alpha and beta."""


def places_of(plane: FocalPlane, row: int, spots_mm: Floats, reported_deg: Floats, folded: bool) -> Doubt:
    """Every place at which a positioner may be.

    `row` of the `plane`; `spots_mm` (n, 2): spots that belong to no other for certain; `reported_deg` (2,);
    `folded`: seen on its alpha axis, so that its arm may point anywhere.
    """
    if folded:
        alpha = reported_deg[0] + np.arange(ALPHAS) * 360.0 / ALPHAS
        low, high = plane.limits_deg[0]
        inside = low + np.mod(alpha - low, 360.0)
        kept = inside[inside <= high]
        return Doubt(row, np.column_stack([kept, np.full(len(kept), reported_deg[1])]))
    rows = np.full(len(spots_mm), row)
    found = plane.inverse(spots_mm, index=rows)
    angles = np.column_stack([found.alpha_deg, found.beta_deg])[found.reachable]
    return Doubt(row, np.vstack([angles, reported_deg]))


def safe_way(obstacles: FocalPlane, here_deg: Floats, doubt: Doubt) -> tuple[float, float] | None:
    """The first of WAYS_DEG that is clear of everything wherever the positioner is; None: there is none.

    `obstacles`: the plane, the others where they are; `here_deg` (N, 2): their angles. deg of alpha, beta.
    """
    near = _neighbourhood(obstacles, doubt.row)
    plane = obstacles.select(near)
    row = int(np.flatnonzero(near == doubt.row)[0])
    alone = np.arange(plane.n) != row
    plane = plane.with_offline(plane.positioner_id[alone], here_deg[near][alone])
    for way in WAYS_DEG:
        if all(_clear(plane, row, here_deg[near], place, way) for place in doubt.places_deg):
            return way
    return None


def _neighbourhood(plane: FocalPlane, row: int) -> Ints:
    """Rows of the positioner and of all that it can touch, in order."""
    pairs = plane.neighbour_pairs()
    touching = pairs[(pairs == row).any(axis=1)]
    return np.union1d(touching.ravel(), [row]).astype(int)


def _clear(
    plane: FocalPlane, row: int, here_deg: Floats, place_deg: Floats, way: tuple[float, float]
) -> bool:
    end_deg = place_deg + way
    stops = plane.hard_stops_deg
    if (end_deg < stops[:, 0] + 1.0).any() or (end_deg > stops[:, 1] - 1.0).any():
        return False
    robots = [
        Trajectory(int(p), np.zeros(1), a[:1], a[1:])
        for p, a in zip(plane.positioner_id, here_deg, strict=True)
    ]
    time_s = np.array([0.0, max(map(abs, way)) / SPEED_DEG_S])
    number = int(plane.positioner_id[row])
    robots[row] = Trajectory(number, time_s, *np.column_stack([place_deg, end_deg]))
    moved = verify(plane, Plan(plane.instrument.name, plane.collision_buffer_mm, tuple(robots)))
    # the others stand as they do; what matters is whether this one comes near to any of them
    return not any(number == v.positioner_id or str(number) == v.other for v in moved.collisions)


def found_place(plane: FocalPlane, doubt: Doubt, way: tuple[float, float], spots_mm: Floats) -> Floats | None:
    """Where the positioner is after its way, in deg (2,): where one place alone predicts what is seen.

    `plane` and `doubt` as before; `way`: in deg, as it was made; `spots_mm` (n, 2): those of the second
    image that belong to no other for certain. None where nothing can be concluded.
    """
    ends_deg = doubt.places_deg + np.array(way)
    rows = np.full(len(ends_deg), doubt.row)
    expected = plane.forward(ends_deg[:, 0], ends_deg[:, 1], index=rows)
    before = plane.forward(doubt.places_deg[:, 0], doubt.places_deg[:, 1], index=rows)
    there = np.array([np.hypot(*(spots_mm - e).T).min(initial=np.inf) < SAME_MM for e in expected])
    stayed = np.array([np.hypot(*(spots_mm - b).T).min(initial=np.inf) < SAME_MM for b in before])
    moved = expected - before
    right = np.flatnonzero(there & ~(stayed & (np.hypot(*moved.T) > 2.0 * SAME_MM)))
    places = ends_deg[right]
    if len(right) == 0 or np.hypot(*(expected[right] - expected[right[0]]).T).max() > SAME_MM:
        return None
    return np.asarray(places[0], dtype=np.float64)
