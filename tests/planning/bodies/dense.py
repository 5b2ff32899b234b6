"""Gaps of bodies in a plan by brute force: every part of every pair at dense times, in numpy alone."""

from collections.abc import Iterator
from functools import cache

import numpy as np

from fiberloom.instruments import FocalPlane, generate, load_instrument
from fiberloom.planning import Plan

STEP_S = 0.02


@cache
def field(n: int, seed: int = 0) -> FocalPlane:
    """The n innermost positioners of a generated SDSS-V plane, with its fiducials."""
    return generate(load_instrument("sdssv"), seed, n_positioners=n)


def _to_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along, off = b - a, p - a
    part = np.clip((off * along.conj()).real / np.maximum(np.abs(along) ** 2, 1e-300), 0.0, 1.0)
    return np.abs(off - part * along)


def distances(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Of segments (n, 4), mm; 0 where they cross."""
    a, b, c, d = (s[:, k] + 1j * s[:, k + 1] for s in (p, q) for k in (0, 2))
    apart = np.minimum.reduce(
        [_to_segment(a, c, d), _to_segment(b, c, d), _to_segment(c, a, b), _to_segment(d, a, b)]
    )

    def side(line, point):
        return ((line[1] - line[0]).conj() * (point - line[0])).imag

    crossed = (side((a, b), c) * side((a, b), d) < 0) & (side((c, d), a) * side((c, d), b) < 0)
    return np.where(crossed, 0.0, apart)


def placed(plane: FocalPlane, row: int, part: np.ndarray, angles_deg: np.ndarray) -> np.ndarray:
    """(T, 4) centre line of a part: arm (0 alpha, 1 beta), x0, y0, x1, y1."""
    x, y, l_alpha, alpha_off, beta_off = plane.arms[row]
    alpha = np.radians(angles_deg[:, 0]) + alpha_off
    both = alpha + np.radians(angles_deg[:, 1]) + beta_off
    centre = x + 1j * y
    origin, turn = (centre, alpha) if part[0] == 0 else (centre + l_alpha * np.exp(1j * alpha), both)
    ends = [origin + complex(*part[k : k + 2]) * np.exp(1j * turn) for k in (1, 3)]
    return np.column_stack([number for end in ends for number in (end.real, end.imag)])


def times(plan: Plan, step_s: float = STEP_S) -> np.ndarray:
    """Dense, and the end."""
    return np.append(np.arange(0.0, plan.duration_s, step_s), plan.duration_s)


Bodies = list[tuple[np.ndarray, np.ndarray]]
"""Parts of one positioner or obstacle, each with its centre lines (T, 4)."""


def near_bodies(
    plane: FocalPlane, plan: Plan, parts: np.ndarray, obstacles: np.ndarray, of: int | None = None
) -> Iterator[tuple[int, int, Bodies, Bodies]]:
    """(row, other row or -1 - obstacle, bodies of both) of all that are near; or of those with row `of`.

    parts (P, 8) and obstacles (K, 7) as `_core.planning.Bodies` takes them.
    """
    when_s = times(plan)
    angles = [robot.at(when_s) for robot in plan.robots]
    whole = [parts[parts[:, 0] == row, 1:] for row in range(plane.n)]
    bodies = [[(part, placed(plane, k, part, angles[k])) for part in whole[k]] for k in range(plane.n)]
    still = [[(np.array([1, 0, 0, 0, 0, o[4], o[5]]), np.tile(o[:4], (len(when_s), 1)))] for o in obstacles]
    for i in range(plane.n):
        near = np.hypot(*(plane.centres_mm - plane.centres_mm[i]).T) < 60.0
        for j in np.flatnonzero(near[i + 1 :]) + i + 1:
            if of is not None and of not in (i, j):
                continue
            yield i, int(j), bodies[i], bodies[j]
        for k, o in enumerate(obstacles):
            if of in (None, i) and o[6] != i and np.hypot(*(o[:2] - plane.centres_mm[i])) < 60.0:
                yield i, -1 - k, bodies[i], still[k]


def least_gap(one: Bodies, other: Bodies, below: float = np.inf) -> float:
    """The least gap of their parts on common layers, mm, if it is less than `below`; else `below`."""
    for a, p in one:
        for b, q in other:
            if int(a[6]) & int(b[6]) and 1 in (a[0], b[0]) and apart_at_least(p, q) < below + a[5] + b[5]:
                below = min(below, (distances(p, q) - a[5] - b[5]).min())
    return below


def apart_at_least(p: np.ndarray, q: np.ndarray) -> float:
    """A bound below all distances of two centre lines (T, 4) that keep their lengths, by their middles."""
    twice = [p[:, k] + p[:, k + 2] - q[:, k] - q[:, k + 2] for k in (0, 1)]
    middles = 0.5 * np.sqrt((twice[0] ** 2 + twice[1] ** 2).min())
    return middles - 0.5 * sum(np.hypot(*(s[0, :2] - s[0, 2:])) for s in (p, q)) - 1e-9


def pair_gaps(
    plane: FocalPlane, plan: Plan, parts: np.ndarray, obstacles: np.ndarray
) -> Iterator[tuple[int, int, float]]:
    """(row, other row or -1 - obstacle, smallest gap) of all that are near."""
    for i, j, one, other in near_bodies(plane, plan, parts, obstacles):
        yield i, j, least_gap(one, other)


def smallest_gap(
    plane: FocalPlane, plan: Plan, parts: np.ndarray, obstacles: np.ndarray, of: int | None = None
) -> float:
    """Of all pairs of which one moves, or of those with one row in them, mm."""
    moves = [robot.moves for robot in plan.robots]
    least = np.inf
    for i, j, one, other in near_bodies(plane, plan, parts, obstacles, of):
        if moves[i] or (j >= 0 and moves[j]):
            least = least_gap(one, other, least)
    return least


def plain_table(plane: FocalPlane, radii_mm: np.ndarray) -> np.ndarray:
    """(N, 8): a capsule on each beta arm, of its own radius."""
    start, end = plane.beta_segment_mm
    return np.array([[k, 1, start, 0, end, 0, radii_mm[k], 1] for k in range(plane.n)], dtype=float)


def fixed_table(plane: FocalPlane) -> np.ndarray:
    """(K, 7): fiducials and guide cameras."""
    rows = [[x, y, x, y, r, 2**32 - 1, -1] for x, y, r in plane.fiducials]
    rows += [[*camera, 2**32 - 1, -1] for camera in plane.guide_cameras]
    return np.array(rows, dtype=float).reshape(-1, 7)


def top_speeds(plan: Plan) -> np.ndarray:
    """(N, 2) of each axis, deg/s."""
    return np.array(
        [
            np.abs(np.diff(robot.points_deg, axis=0) / np.diff(robot.time_s)[:, None]).max(
                axis=0, initial=0.0
            )
            for robot in plan.robots
        ]
    )


def top_accelerations(plan: Plan) -> np.ndarray:
    """(N,) change of slope over the mean duration beside it, deg/s2, start and end included."""
    out = []
    for robot in plan.robots:
        if not robot.moves:
            out.append(0.0)
            continue
        spans = np.diff(robot.time_s)
        slopes = np.vstack([[0, 0], np.diff(robot.points_deg, axis=0) / spans[:, None], [0, 0]])
        spans = np.concatenate([spans[:1], spans, spans[-1:]])
        mean = 0.5 * (spans[:-1] + spans[1:])
        out.append(float((np.abs(np.diff(slopes, axis=0)) / mean[:, None]).max()))
    return np.array(out)
