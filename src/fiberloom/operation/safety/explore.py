"""Small moves that tell where a positioner is, each proven safe for every place at which it may be.

The begin check leaves positioners whose spot cannot be told from others, and arms folded onto their axis.
For each place that is possible (a hypothesis) the same small relative move is verified; only a move that
is clear in all of them is made. The next image shows which spot has moved as one of them predicts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom._core import geometry
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import METROLOGY
from fiberloom.operation.safety.begin import DEEP_SHARE
from fiberloom.planning import MotionLimits, Plan, Trajectory, verify
from fiberloom.typing import Floats, Ints
from fiberloom.units import deg_to_rad, rad_to_deg

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
    return Doubt(row, np.vstack([*(at_spot(plane, row, spot) for spot in spots_mm), reported_deg]))


def at_spot(plane: FocalPlane, row: int, spot_mm: Floats) -> Floats:
    """(k, 2) angles in deg at which the fibre of a positioner is at a spot, the elbow on either side.

    `row` of the `plane`; `spot_mm` (2,); as far as the hard stops let it, also where no target would put it.
    """
    found, count, _ = geometry.inverse(
        np.ascontiguousarray(plane.arms[[row]]),
        np.ascontiguousarray(plane.points[METROLOGY][[row]]),
        np.ascontiguousarray(spot_mm, dtype=np.float64).reshape(1, 2),
        deg_to_rad(plane.hard_stops_deg),
    )
    return rad_to_deg(found[0, : count[0]])


def possible(obstacles: FocalPlane, here_deg: Floats, doubt: Doubt) -> Doubt:
    """Without the places at which the arm would be deep in another body: there it cannot be.

    `obstacles`: the plane, the others where they are; `here_deg` (N, 2): their angles.
    """
    plane, row, here = _alone(obstacles, here_deg, doubt.row)
    deep_mm = DEEP_SHARE * plane.collision_buffer_mm
    inside = [_meets(plane, row, here, np.array([p]), deep_mm) for p in doubt.places_deg]
    return Doubt(doubt.row, doubt.places_deg[~np.array(inside, dtype=bool)])


def safe_way(obstacles: FocalPlane, here_deg: Floats, doubt: Doubt) -> tuple[float, float] | None:
    """The first of WAYS_DEG that is clear of everything wherever the positioner is; None: there is none.

    `obstacles`: the plane, the others where they are; `here_deg` (N, 2): their angles. deg of alpha, beta.
    """
    return next((way for way in WAYS_DEG if is_clear(obstacles, here_deg, doubt, way)), None)


def is_clear(obstacles: FocalPlane, here_deg: Floats, doubt: Doubt, way: tuple[float, float]) -> bool:
    """Whether a way is clear of everything wherever the positioner is.

    `obstacles`: the plane, the others where they are; `here_deg` (N, 2): their angles; `doubt`: the places;
    `way`: in deg of alpha and beta.
    """
    plane, row, here = _alone(obstacles, here_deg, doubt.row)
    return all(_clear(plane, row, here, place, way) for place in doubt.places_deg)


def _alone(obstacles: FocalPlane, here_deg: Floats, number: int) -> tuple[FocalPlane, int, Floats]:
    """The neighbourhood of one positioner, in which it alone can move; its row there, and all angles."""
    near = _neighbourhood(obstacles, number)
    plane, here = obstacles.select(near), here_deg[near]
    row = int(np.flatnonzero(near == number)[0])
    alone = np.arange(plane.n) != row
    return plane.with_offline(plane.positioner_id[alone], here[alone]), row, here


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
    return not _meets(plane, row, here_deg, np.array([place_deg, end_deg]), plane.collision_buffer_mm)


def _meets(plane: FocalPlane, row: int, here_deg: Floats, points_deg: Floats, buffer_mm: float) -> bool:
    """Whether one positioner comes near to another body on its way; the others stand as they do."""
    robots = [
        Trajectory(int(p), np.zeros(1), a[:1], a[1:])
        for p, a in zip(plane.positioner_id, here_deg, strict=True)
    ]
    way_s = np.abs(np.diff(points_deg, axis=0)).max(axis=1, initial=0.0) / SPEED_DEG_S
    number = int(plane.positioner_id[row])
    robots[row] = Trajectory(number, np.concatenate([[0.0], np.cumsum(way_s)]), *points_deg.T)
    planned = Plan(plane.instrument.name, buffer_mm, tuple(robots))
    moved = verify(plane, planned, limits=MotionLimits(collision_buffer_mm=buffer_mm))
    return any(number == v.positioner_id or str(number) == v.other for v in moved.collisions)


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
