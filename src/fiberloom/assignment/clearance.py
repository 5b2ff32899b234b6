"""Gaps between arms at rest and on the approach leg, over arrays of places.

A place is a possible goal of one positioner: the goal and the short straight way to it, from
approach_deg above on both axes, or below where an axis comes from there. The way is kept as POSES poses of
the centre lines of the P parts of an arm (SDSS-V: one capsule); `dip_mm` bounds how much nearer two arms can
come between poses than at them.
"""

from itertools import chain
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from fiberloom._core.geometry import segment_distance
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.single_units import handicaps_of
from fiberloom.planning.bodies import beside
from fiberloom.planning.obstacles import (
    BETA,
    LAYERS,
    RADIUS,
    doubt_obstacles,
    fixed_obstacles,
    meet,
    part_lines_mm,
    parts_of,
    parts_of_one,
)
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad

POSES = 3
"""Goal, middle and start of the approach."""

_ARM = 1
"""Column of parts."""

_AT_ONCE = 100_000
"""Pairs of a place and a body that are in memory together: where units are uncertain there are millions."""
_CARE_MM = 1.0
"""Bodies that are so much farther away than they can meet are looked at still."""
_LONG_MM = 10.0
"""Half length of a body from which on it is held against all."""


def outline(plane: FocalPlane) -> Floats:
    """(P, 8) parts in mm, as in `planning.bodies.CollisionBodies`, of an arm that is no wider than others."""
    return parts_of_one(plane, plane.collision_buffer_mm)


def arm_lines(plane: FocalPlane, angles_deg: Floats, positioner: Ints) -> Floats:
    """(n, P, 4) mm: x0, y0, x1, y1 of the centre lines of all parts, of rows of the `plane` (n,) at angles
    (n, 2).
    """
    arms, angles = plane.arms[positioner], deg_to_rad(angles_deg)
    return np.stack([part_lines_mm(arms, part, angles) for part in outline(plane)], axis=1)


def sweep(plane: FocalPlane, positioner: Ints, goal_deg: Floats, approach_deg: float | Floats) -> Floats:
    """(C, POSES, P, 4) mm: x0, y0, x1, y1 of the centre lines at goals and on the approach to them.

    `positioner` (C,): rows of the `plane`, repeats allowed; `goal_deg` (C, 2): alpha, beta;
    `approach_deg`: one number, or (C,).
    """
    start = goal_deg + beside(plane, np.broadcast_to(approach_deg, len(goal_deg)))
    ways = [(1 - s) * goal_deg + s * start for s in np.linspace(0.0, 1.0, POSES)]
    return np.stack([arm_lines(plane, way, positioner) for way in ways], axis=1)


def standing(plane: FocalPlane, goal_deg: Floats) -> Floats:
    """(N, POSES, P, 4) mm: centre lines of all positioners at rest at these angles (N, 2)."""
    return sweep(plane, np.arange(plane.n), goal_deg, 0.0)


def dip_mm(plane: FocalPlane, approach_deg: float, bodies: int = 2) -> float:
    """How much nearer than at the poses two bodies of the smallest radius can come between them.

    Between poses each end of an arm moves by at most L; straight relative motion by L_rel past a
    point at distance d dips by at most L_rel^2 / (8 d), an arc of angle u leaves its chord by
    r u^2 / 8. `bodies`: how many of the two move (1 against a fixed one).
    """
    step = float(deg_to_rad(approach_deg)) / (POSES - 1)
    parts = outline(plane)
    far = np.hypot(parts[:, 2:6:2], parts[:, 3:7:2]).max(axis=1)
    on_beta = parts[:, _ARM] == BETA
    beta, alpha = far[on_beta].max(initial=0.0), far[~on_beta].max(initial=0.0)
    l_alpha = float(plane.l_alpha_mm.max(initial=0.0))
    # alpha turns the whole arm, beta its second part: twice the angle there
    travel = step * max(l_alpha + 2 * beta, alpha)
    arc = max(l_alpha * step**2 + beta * (2 * step) ** 2, alpha * step**2) / 8
    nearest = 2 * parts[:, RADIUS].min()
    return float((bodies * travel) ** 2 / (8 * nearest) + bodies * arc)


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
    a, b = np.broadcast_arrays(a, b)
    rows = [np.ascontiguousarray(side, dtype=np.float64).reshape(-1, 4) for side in (a, b)]
    return np.array(segment_distance(*rows)).reshape(a.shape[:-1])


def obstacles(plane: FocalPlane, margin_mm: float) -> Floats:
    """(K, 7) capsules that do not move, x0, y0, x1, y1, radius in mm, layers, arm (0 alpha, 1 beta).

    Fiducials, guide cameras, keep-outs, parts of offline positioners and the places where these may be;
    offline positioners with their half of the margin between two arms.
    """
    still = np.flatnonzero(plane.offline)
    parts, wider_mm = outline(plane), handicaps_of(plane).wider_mm[still]
    lines = arm_lines(plane, plane.offline_position_deg[still], still).reshape(-1, 4)
    radius = np.add.outer(wider_mm + margin_mm / 2, parts[:, RADIUS]).reshape(-1, 1)
    kinds = np.tile(parts[:, [LAYERS, _ARM]], (len(still), 1))
    doubt = doubt_obstacles(plane, parts_of(plane, plane.collision_buffer_mm))
    doubt[:, 4] += margin_mm / 2
    fixed = np.vstack([fixed_obstacles(plane), doubt])[:, :6]
    arms = np.hstack([lines, radius, kinds])
    return np.vstack([np.insert(fixed, 6, BETA, axis=1), arms])


def obstacle_gap_mm(plane: FocalPlane, positioner: Ints, segments: Floats, bodies: Floats) -> Floats:
    """(C,) gap in mm between an arm and the nearest fixed body; negative where they overlap.

    `positioner` (C,): rows of the `plane`; `segments` (C, Q, P, 4) mm: centre lines of the arm in Q poses;
    `bodies` (K, 7): as of `obstacles`.
    """
    gap = np.full(len(positioner), np.inf)
    which, body = _near_bodies(plane, positioner, bodies)
    wider_mm = handicaps_of(plane).wider_mm[positioner]
    for k, part in enumerate(outline(plane)):
        here = meet(part[[_ARM, LAYERS]], bodies[:, [6, 5]])[body]
        all_places, all_others = which[here], body[here]
        for begin in range(0, len(all_places), _AT_ONCE):
            places, others = (some[begin : begin + _AT_ONCE] for some in (all_places, all_others))
            apart = segment_mm(segments[places, :, k], bodies[others, None, :4]).min(axis=1, initial=np.inf)
            np.minimum.at(gap, places, apart - bodies[others, 4] - (part[RADIUS] + wider_mm[places]))
    return gap


def _near_bodies(plane: FocalPlane, positioner: Ints, bodies: Floats) -> tuple[Ints, Ints]:
    """(place, body) pairs that can meet: found once per positioner, then spread to its places."""
    rows, where = np.unique(positioner, return_inverse=True)
    row, body = _candidates(plane.centres_mm[rows], float(plane.body_reach_mm[rows].max(initial=0.0)), bodies)
    away = point_segment_mm(plane.centres_mm[rows[row]], bodies[body, :4])
    near = away < plane.body_reach_mm[rows[row]] + bodies[body, 4] + _CARE_MM
    near &= ~plane.offline[rows[row]]
    pairs = csr_array((np.ones(near.sum(), dtype=bool), (row[near], body[near])), (len(rows), len(bodies)))
    place, which = pairs[where].nonzero()
    return place, which


def _candidates(centres_mm: Floats, reach_mm: float, bodies: Floats) -> tuple[Ints, Ints]:
    """(row, body) pairs of short bodies that may be near centres (n, 2), and of all long ones."""
    along = bodies[:, 2:4] - bodies[:, :2]
    far = 0.5 * np.hypot(along[:, 0], along[:, 1]) + bodies[:, 4]
    short, long = np.flatnonzero(far <= _LONG_MM), np.flatnonzero(far > _LONG_MM)
    middles = cKDTree(bodies[short, :2] + 0.5 * along[short])
    found = cKDTree(centres_mm).query_ball_tree(middles, reach_mm + _LONG_MM + _CARE_MM)
    row = np.repeat(np.arange(len(found)), [len(some) for some in found])
    body = short[np.fromiter(chain.from_iterable(found), dtype=np.int64)]
    every = np.arange(len(centres_mm))
    return np.concatenate([row, np.repeat(every, len(long))]), np.concatenate(
        [body, np.tile(long, len(every))]
    )


class Discs(NamedTuple):
    """For each place: discs that hold the arm in all poses, and its parts at the goal."""

    middle: Floats
    """(C, 2) mm."""
    radius: Floats
    """(C,) mm."""
    travel: Floats
    """(C,) mm: how far an end of a part moves on the approach."""
    part_middle: Floats
    """(C, P, 2) mm."""
    part_radius: Floats
    """(C, P) mm."""


class Places(NamedTuple):
    """C places, ready to be compared many times."""

    segments: Floats
    """(C, POSES, P, 4) mm."""
    radius: Floats
    """(C, P) mm, of the parts."""
    meeting: list[tuple[int, int]]
    """Which parts of two arms can meet."""
    discs: Discs


def places(plane: FocalPlane, positioner: Ints, segments: Floats) -> Places:
    """Places with their discs, of rows of the `plane` (C,), from centre lines (C, POSES, P, 4) in mm."""
    parts = outline(plane)
    radius = np.add.outer(handicaps_of(plane).wider_mm[positioner], parts[:, RADIUS])
    kinds = parts[:, [_ARM, LAYERS]]
    meeting = [(int(a), int(b)) for a, b in np.argwhere(meet(kinds[:, None], kinds[None]))]
    return Places(segments, radius, meeting, _discs(segments, radius))


def _discs(segments: Floats, radius: Floats) -> Discs:
    """Discs around places: centre lines (C, POSES, P, 4) and radii (C, P) in mm."""
    shift = segments - segments[:, :1]
    travel = np.maximum(np.hypot(shift[..., 0], shift[..., 1]), np.hypot(shift[..., 2], shift[..., 3]))
    travel = travel.max(axis=(1, 2), initial=0.0)
    start, end = segments[:, 0, :, :2], segments[:, 0, :, 2:]
    part_middle = (start + end) / 2
    along = end - start
    part_radius = np.hypot(along[..., 0], along[..., 1]) / 2 + radius
    middle = (part_middle.min(axis=1) + part_middle.max(axis=1)) / 2
    away = part_middle - middle[:, None]
    whole = (np.hypot(away[..., 0], away[..., 1]) + part_radius).max(axis=1) + travel
    return Discs(middle, whole, travel, part_middle, part_radius)


def gaps_mm(first: Places, a: Ints, second: Places, b: Ints, care_mm: float = np.inf) -> Floats:
    """(n,) smallest gap in mm of `first`[`a`] and `second`[`b`] over all combinations of poses: one
    positioner may have arrived while the other is still on its way.

    Exact where it is below `care_mm`; elsewhere not below it.
    """
    return _gaps_mm(first, a, second, b, np.full(len(a), care_mm), POSES)


def _gaps_mm(first: Places, a: Ints, second: Places, b: Ints, care_mm: Floats, poses: int) -> Floats:
    """As `gaps_mm`, over the first `poses`; `care_mm` (n,)."""
    travel = first.discs.travel[a] + second.discs.travel[b] if poses > 1 else np.zeros(len(a))
    gap = care_mm.copy()
    for p, q in first.meeting:
        shift = first.discs.part_middle[a, p] - second.discs.part_middle[b, q]
        wide = first.discs.part_radius[a, p] + second.discs.part_radius[b, q] + travel
        near = np.flatnonzero(np.hypot(shift[:, 0], shift[:, 1]) - wide < gap)
        i, j = a[near], b[near]
        apart = segment_mm(first.segments[i, :poses, p][:, :, None], second.segments[j, :poses, q][:, None])
        found = apart.min(axis=(1, 2), initial=np.inf) - (first.radius[i, p] + second.radius[j, q])
        gap[near] = np.minimum(gap[near], found)
    return gap


def too_near(first: Places, a: Ints, second: Places, b: Ints, limit_mm: float) -> Flags:
    """(n,) is the gap of `first`[`a`] and `second`[`b`] below `limit_mm`? Cheap for pairs far apart."""
    out = np.zeros(len(a), dtype=bool)
    shift = first.discs.middle[a] - second.discs.middle[b]
    gap = np.hypot(shift[:, 0], shift[:, 1]) - first.discs.radius[a] - second.discs.radius[b]
    near = np.flatnonzero(gap < limit_mm)
    # the goals decide most pairs; only the rest needs all combinations of poses
    travel = first.discs.travel[a[near]] + second.discs.travel[b[near]]
    at_goal = _gaps_mm(first, a[near], second, b[near], limit_mm + travel, 1)
    out[near] = at_goal < limit_mm
    rest = near[(at_goal >= limit_mm) & (at_goal - travel < limit_mm)]
    out[rest] = gaps_mm(first, a[rest], second, b[rest], limit_mm) < limit_mm
    return out
