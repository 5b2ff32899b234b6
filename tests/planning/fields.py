"""Focal planes and bodies for the tests of planning."""

from functools import cache

import numpy as np
from tests.conftest import beside_checkout

from fiberloom.instruments import FocalPlane, generate, load_instrument, read_layout

SDSSV = load_instrument("sdssv")


@cache
def field(n: int, seed: int = 0) -> FocalPlane:
    """The n innermost positioners of a generated SDSS-V plane, with its fiducials."""
    return generate(SDSSV, seed, n_positioners=n)


@cache
def real_field() -> FocalPlane:
    """The array of Apache Point with its 60 fiducials and 6 guide cameras."""
    return read_layout(beside_checkout("sdssv") / "apo_2024.04.01", SDSSV)


def sampled_gaps(plane: FocalPlane, plan, step_s: float = 0.01) -> tuple[float, float]:
    """Smallest gaps in mm of arms to arms and to fiducials, by dense sampling in numpy alone."""
    times = np.arange(0.0, plan.duration_s + step_s, step_s)
    lines = np.stack([_lines(plane, k, robot.at(times)) for k, robot in enumerate(plan.robots)])
    pairs = plane.neighbour_pairs()
    arms = min((_segments(lines[i], lines[j]).min() for i, j in pairs), default=np.inf)
    discs = np.inf
    for x, y, radius in plane.fiducials:
        for k in np.flatnonzero(np.hypot(*(plane.centres_mm - (x, y)).T) < 30.0):
            gap = _to_segment(np.array([x, y]), lines[k]).min() - radius
            discs = min(discs, gap)
    return arms - 2 * plan.collision_buffer_mm, discs - plan.collision_buffer_mm


def _lines(plane: FocalPlane, row: int, angles_deg: np.ndarray) -> np.ndarray:
    x, y, l_alpha, alpha_off, beta_off = plane.arms[row]
    alpha = np.radians(angles_deg[:, 0]) + alpha_off
    beta = alpha + np.radians(angles_deg[:, 1]) + beta_off
    elbow = x + 1j * y + l_alpha * np.exp(1j * alpha)
    ends = [elbow + s * np.exp(1j * beta) for s in plane.beta_segment_mm]
    return np.column_stack([part for e in ends for part in (e.real, e.imag)])


def _to_segment(p: np.ndarray, s: np.ndarray) -> np.ndarray:
    along, offset = s[:, 2:] - s[:, :2], p - s[:, :2]
    t = np.clip((offset * along).sum(1) / (along**2).sum(1), 0.0, 1.0)
    return np.hypot(*(offset - t[:, None] * along).T)


def _segments(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    ends = [_to_segment(p[:, :2], q), _to_segment(p[:, 2:], q)]
    ends += [_to_segment(q[:, :2], p), _to_segment(q[:, 2:], p)]
    apart = np.minimum.reduce(ends)
    return np.where(_cross(p, q) & _cross(q, p), 0.0, apart)


def _cross(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    def side(a, b, c):
        return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])

    return side(p[:, :2], p[:, 2:], q[:, :2]) * side(p[:, :2], p[:, 2:], q[:, 2:]) < 0


def signed(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Distances of segments (n, 4); of those that cross, by separating axes: the least overlap of shadows."""
    apart = _segments(p, q)
    shadows = []
    for line in (p, q):
        normal = np.column_stack([line[:, 1] - line[:, 3], line[:, 2] - line[:, 0]])
        normal /= np.hypot(*normal.T)[:, None]
        mine = np.stack([(normal * s[:, k : k + 2]).sum(1) for s in (p,) for k in (0, 2)])
        other = np.stack([(normal * s[:, k : k + 2]).sum(1) for s in (q,) for k in (0, 2)])
        shadows += [mine.max(0) - other.min(0), other.max(0) - mine.min(0)]
    return np.where(apart > 0.0, apart, -np.min(shadows, axis=0))
