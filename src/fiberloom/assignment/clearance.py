"""Distances between arms at rest and on the approach leg, over arrays of places.

A place is a possible goal of one positioner: the goal and the short straight way to it, from
approach_deg above on both axes. The way is kept as POSES poses of the centre line of the beta arm's
capsule; `dip_mm` bounds how much nearer two arms can come between poses than at them.
"""

from typing import NamedTuple

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad

POSES = 3
"""Goal, middle and start of the approach."""


def sweep(plane: FocalPlane, positioner: Ints, goal_deg: Floats, approach_deg: float | Floats) -> Floats:
    """(C, POSES, 4) mm: x0, y0, x1, y1 of the centre lines at goals and on the approach to them.

    `positioner` (C,): rows of the `plane`, repeats allowed; `goal_deg` (C, 2): alpha, beta;
    `approach_deg`: one number, or (C,).
    """
    start = goal_deg + np.broadcast_to(approach_deg, len(goal_deg))[:, None]
    ways = [(1 - s) * goal_deg + s * start for s in np.linspace(0.0, 1.0, POSES)]
    poses = [plane.beta_segments(way[:, 0], way[:, 1], positioner) for way in ways]
    return np.stack(poses, axis=1).reshape(-1, POSES, 4)


def standing(plane: FocalPlane, goal_deg: Floats) -> Floats:
    """(N, POSES, 4) mm: centre lines of all positioners at rest at these angles (N, 2)."""
    return sweep(plane, np.arange(plane.n), goal_deg, 0.0)


def dip_mm(plane: FocalPlane, approach_deg: float, bodies: int = 2) -> float:
    """How much nearer than at the poses two bodies of the smallest radius can come between them.

    Between poses each end of an arm moves by at most L; straight relative motion by L_rel past a
    point at distance d dips by at most L_rel^2 / (8 d), an arc of angle u leaves its chord by
    r u^2 / 8. `bodies`: how many of the two move (1 against a fixed one).
    """
    step = float(deg_to_rad(approach_deg)) / (POSES - 1)
    arm = max(map(abs, plane.beta_segment_mm))
    l_alpha = float(plane.l_alpha_mm.max(initial=0.0))
    # alpha turns the whole arm, beta its second part: twice the angle there
    travel = step * (l_alpha + 2 * arm)
    arc = (l_alpha * step**2 + arm * (2 * step) ** 2) / 8
    nearest = 2 * plane.collision_buffer_mm
    return (bodies * travel) ** 2 / (8 * nearest) + bodies * arc


def point_segment_mm(point: Floats, segment: Floats) -> Floats:
    """Distance of points (..., 2) from segments (..., 4), all in mm."""
    start, along = segment[..., :2], segment[..., 2:] - segment[..., :2]
    offset = point - start
    length2 = np.sum(along * along, axis=-1)
    t = np.sum(offset * along, axis=-1) / np.where(length2 > 0, length2, 1.0)
    nearest = offset - np.clip(t, 0.0, 1.0)[..., None] * along
    depth: Floats = np.hypot(nearest[..., 0], nearest[..., 1])
    return depth


def segment_mm(a: Floats, b: Floats) -> Floats:
    """Distance between segments (..., 4), all in mm; 0 where they cross."""
    ends = [
        point_segment_mm(a[..., :2], b),
        point_segment_mm(a[..., 2:], b),
        point_segment_mm(b[..., :2], a),
        point_segment_mm(b[..., 2:], a),
    ]
    return np.where(_cross(a, b), 0.0, np.minimum.reduce(ends))


def _cross(a: Floats, b: Floats) -> Flags:
    """Do the segments cross? Each one's ends lie on different sides of the other."""
    return (_side(a, b[..., :2]) * _side(a, b[..., 2:]) < 0) & (
        _side(b, a[..., :2]) * _side(b, a[..., 2:]) < 0
    )


def _side(segment: Floats, point: Floats) -> Floats:
    along, offset = segment[..., 2:] - segment[..., :2], point - segment[..., :2]
    return along[..., 0] * offset[..., 1] - along[..., 1] * offset[..., 0]


def obstacles(plane: FocalPlane, margin_mm: float) -> Floats:
    """(K, 5) mm: capsules that do not move, x0, y0, x1, y1, radius: fiducials, guide cameras, arms of
    offline positioners (these with their half of the margin between two arms).
    """
    still = np.flatnonzero(plane.offline)
    place = plane.offline_position_deg[still]
    arms = plane.beta_segments(place[:, 0], place[:, 1], still)
    radius = np.full((len(still), 1), plane.collision_buffer_mm + margin_mm / 2)
    xy, r = plane.fiducials[:, :2], plane.fiducials[:, 2:]
    return np.vstack([np.hstack([xy, xy, r]), plane.guide_cameras, np.hstack([arms, radius])])


def obstacle_gap_mm(plane: FocalPlane, positioner: Ints, segments: Floats, bodies: Floats) -> Floats:
    """(C,) gap in mm between the capsule of an arm and the nearest fixed body; negative where they
    overlap.

    `positioner` (C,): rows of the `plane`; `segments` (C, P, 4) mm: centre lines of the arm in P poses;
    `bodies` (K, 5) mm: capsules, x0, y0, x1, y1, radius.
    """
    gap = np.full(len(positioner), np.inf)
    which, body = _near_bodies(plane, positioner, bodies)
    distance = segment_mm(segments[which], bodies[body, None, :4]).min(axis=1, initial=np.inf)
    np.minimum.at(gap, which, distance - bodies[body, 4] - plane.collision_buffer_mm)
    return gap


def _near_bodies(plane: FocalPlane, positioner: Ints, bodies: Floats) -> tuple[Ints, Ints]:
    """(place, body) pairs that can meet: found once per positioner, then spread to its places."""
    rows, where = np.unique(positioner, return_inverse=True)
    centre, reach = plane.centres_mm[rows, None], plane.body_reach_mm[rows, None]
    near = point_segment_mm(centre, bodies[None, :, :4]) < reach + bodies[:, 4] + 1.0
    near[plane.offline[rows]] = False
    place, body = np.nonzero(near[where])
    return place, body


def pair_distance_mm(first: Floats, second: Floats) -> Floats:
    """(P,) smallest distance in mm of centre lines (P, POSES, 4) over all combinations of poses: one
    positioner may have arrived while the other is still on its way.
    """
    gap: Floats = segment_mm(first[:, :, None], second[:, None, :]).min(axis=(1, 2))
    return gap


class Discs(NamedTuple):
    """For each place: a disc that holds its centre line in all poses, and how far an end moves."""

    middle: Floats
    """(C, 2)."""
    radius: Floats
    travel: Floats


def discs(segments: Floats) -> Discs:
    """Discs around places: centre lines (C, POSES, 4) in mm."""
    shift = segments - segments[:, :1]
    ends = np.hypot(shift[..., 0], shift[..., 1]), np.hypot(shift[..., 2], shift[..., 3])
    travel = np.maximum(*ends).max(axis=1)
    start, end = segments[:, 0, :2], segments[:, 0, 2:]
    half = np.hypot(*(end - start).T) / 2
    return Discs((start + end) / 2, half + travel, travel)


class Places(NamedTuple):
    """Places with their discs, ready to be compared many times."""

    segments: Floats
    discs: Discs


def places(segments: Floats) -> Places:
    """Places with their discs, from centre lines (C, POSES, 4) in mm."""
    return Places(segments, discs(segments))


def too_near(first: Places, a: Ints, second: Places, b: Ints, limit_mm: float) -> Flags:
    """(P,) do `first`[`a`] and `second`[`b`] come nearer than `limit_mm`? Cheap for pairs far apart."""
    out = np.zeros(len(a), dtype=bool)
    shift = first.discs.middle[a] - second.discs.middle[b]
    gap = np.hypot(shift[:, 0], shift[:, 1]) - first.discs.radius[a] - second.discs.radius[b]
    near = np.flatnonzero(gap < limit_mm)
    # the goals decide most pairs; only the rest needs all combinations of poses
    at_goal = segment_mm(first.segments[a[near], 0], second.segments[b[near], 0])
    out[near] = at_goal < limit_mm
    travel = first.discs.travel[a[near]] + second.discs.travel[b[near]]
    rest = near[(at_goal >= limit_mm) & (at_goal - travel < limit_mm)]
    distance = pair_distance_mm(first.segments[a[rest]], second.segments[b[rest]])
    out[rest] = distance < limit_mm
    return out
