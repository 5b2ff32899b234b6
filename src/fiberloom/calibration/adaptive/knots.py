"""Many polylines at once: N positioners, 2 axes, K knots.

The functions of `transmission` go row by row and are exact to rounding; these go through all rows in
one call, for what is done after every move of every positioner.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import isotonic_regression

from fiberloom.typing import Floats, Ints

LEAST_SLOPE = 0.05
"""Output deg per wire deg below which a map is no gear any more: SDSS-V accepts slopes of delta up
to 0.15, that is 0.85 and more here."""


def locate(knots: Floats, values: Floats) -> tuple[Ints, Floats]:
    """Segment and place in it: (n, 2, K) rising knots in deg, (n, 2, M) values in deg -> k and t, (n,
    2, M).

    t is a share of the segment; outside [0, 1] beyond the ends, where a map is extended straight.
    """
    n, axes, count = knots.shape
    low, high = knots[..., 0].min(), knots[..., -1].max()
    # one sorted list of all rows: each row is shifted beyond the one before it
    shift = (high - low + 1.0) * np.arange(n * axes).reshape(n, axes, 1)
    inside = np.clip(values, low, high)
    found = np.searchsorted((knots + shift).ravel(), (inside + shift).ravel(), side="right")
    first = count * np.arange(n * axes).reshape(n, axes, 1)
    k = np.clip(found.reshape(values.shape) - 1 - first, 0, count - 2)
    at, after = pick(knots, k), pick(knots, k + 1)
    return k, (values - at) / (after - at)


def pick(values: Floats, k: Ints) -> Floats:
    """Values (n, 2, K), usually in deg, at indices (n, 2, M)."""
    return np.take_along_axis(values, k, axis=-1)


def between(values: Floats, k: Ints, t: Floats) -> Floats:
    """Linear interpolation of `values` (n, 2, K) in deg at segment `k` and share `t`, as `locate` found
    them.
    """
    return (1.0 - t) * pick(values, k) + t * pick(values, k + 1)


def evaluate(source: Floats, goal: Floats, values: Floats) -> Floats:
    """The polylines from `source` knots to `goal` knots, (n, 2, K), at `values` (n, 2, M); all in deg."""
    return between(goal, *locate(source, values))


def refine(knots: Floats, factor: int) -> Floats:
    """(..., K) -> (..., (K - 1) factor + 1): each segment cut into equal parts, ends kept exactly."""
    t = np.arange(factor) / factor
    inner = knots[..., :-1, None] * (1.0 - t) + knots[..., 1:, None] * t
    return np.concatenate([inner.reshape(*knots.shape[:-1], -1), knots[..., -1:]], axis=-1)


def rising(output_deg: Floats, wire_deg: Floats) -> Floats:
    """The nearest map in output deg (least squares) that rises by LEAST_SLOPE everywhere; mostly the
    map itself.
    """
    rest = output_deg - LEAST_SLOPE * wire_deg
    bad = np.argwhere((np.diff(rest, axis=-1) <= 0.0).any(axis=-1))
    if len(bad) == 0:
        return output_deg
    out = output_deg.copy()
    for row in map(tuple, bad):
        ramp = LEAST_SLOPE * wire_deg[row]
        out[row] = isotonic_regression(rest[row]).x + ramp
    return out
