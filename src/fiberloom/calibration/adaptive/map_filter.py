"""A Kalman filter on the transmission maps of N positioners.

What a map is off by, at wire position w, is the sum of

- smooth wear: a cubic B-spline with a node every few degrees, common to many teeth;
- ripple between the knots of the calibration, which it could not see: one value per fine knot;

and the place of the fibre depends besides on the arms: centre and lengths. A measurement (x, y) weighs
them all at once through the Jacobian of Eq. 1, so that each gets what its own uncertainty is worth,
and where the Jacobian is singular (beta near 0 or 180 deg) only what the fibre shows is learnt.

The smooth part and the arms have their full joint covariance; the ripple, of which there are many
hundred values, its variances only. Measurements given together are weighed together.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from fiberloom.calibration.adaptive import knots as lines
from fiberloom.typing import Flags, Floats, Ints

ARMS = ("centre_x_mm", "centre_y_mm", "l_alpha_mm", "l_beta_mm")
N_ARMS = len(ARMS)
_ORDER = 4  # nodes that a cubic spline has at any place
_UNSEEN = 1e12
"""Variance factor of a measurement that does not count."""


@dataclass
class FilterState:
    """What is known, and how well; rows are positioners. Lengths in mm, angles in deg."""

    mean: Floats
    """(N, D): arms, then alpha's nodes, then beta's."""
    covariance: Floats
    """(N, D, D)"""
    ripple_deg: Floats
    """(N, 2, K)"""
    ripple_variance: Floats
    """(N, 2, K) deg^2"""
    doubt: Ints
    """(N,) updates in a row in which every measurement surprised."""

    def rows(self, index: Ints) -> FilterState:
        """A copy of some positioners."""
        return FilterState(*(getattr(self, f.name)[index].copy() for f in fields(self)))

    def put(self, index: Ints, other: FilterState) -> None:
        """Replaces some positioners."""
        for f in fields(self):
            getattr(self, f.name)[index] = getattr(other, f.name)

    def spread(self, moves: Floats, wear: Floats, ripple_wear: float, arms_wear: float) -> None:
        """Forgetting: variances grow with the `moves` (N,) done since.

        Per move: `wear` of the nodes in deg^2, `ripple_wear` of the fine knots in deg^2, `arms_wear` of
        the arms in mm^2.
        """
        n, d = self.mean.shape
        growth = np.concatenate([np.full(N_ARMS, arms_wear), wear])
        diagonal = self.covariance.reshape(n, d * d)[:, :: d + 1]
        diagonal += moves[:, None] * growth
        self.ripple_variance += (moves * ripple_wear)[:, None, None]


class Spline:
    """Uniform cubic B-splines over the maps of both axes."""

    def __init__(self, wire_deg: Floats, spacing_deg: float) -> None:
        self.low, self.span = wire_deg[..., 0], wire_deg[..., -1] - wire_deg[..., 0]
        pieces = np.maximum(np.ceil(self.span.max(axis=0) / spacing_deg), 1).astype(int)
        self.pieces = pieces
        self.nodes = pieces + _ORDER - 1
        self.first = np.array([N_ARMS, N_ARMS + self.nodes[0]])
        self.size = N_ARMS + int(self.nodes.sum())

    def at(self, wire_deg: Floats, index: Ints) -> tuple[Ints, Floats]:
        """State indices and weights, (n, 2, M, 4), at (n, 2, M) wire positions."""
        part = (wire_deg - self.low[index][..., None]) / self.span[index][..., None]
        u = np.clip(part, 0.0, 1.0) * self.pieces[:, None]
        i = np.minimum(u.astype(np.int64), self.pieces[:, None] - 1)
        s = u - i
        weights = np.stack(
            [(1 - s) ** 3, 3 * s**3 - 6 * s**2 + 4, -3 * s**3 + 3 * s**2 + 3 * s + 1, s**3], axis=-1
        )
        nodes = (i + self.first[:, None])[..., None] + np.arange(_ORDER)
        return nodes, weights / 6.0


@dataclass(frozen=True)
class MeasurementBlock:
    """Measurements of n positioners, M each, and how they depend on the state."""

    innovation: Floats
    """(n, M, 2) mm: measured less expected; whatever where `counts` is False."""
    jacobian: Floats
    """(n, M, 2, 2) mm/deg"""
    arms: Floats
    """(n, M, 2, 4): d(x, y)/d(arms)"""
    noise: Floats
    """(n, M, 2, 2) mm^2"""
    nodes: Ints
    weights: Floats
    """(n, 2, M, 4) of the splines."""
    k: Ints
    t: Floats
    """(n, 2, M) fine knots."""
    counts: Flags
    """(n, M)"""


def design(block: MeasurementBlock, size: int) -> Floats:
    """(n, M, 2, D): d(x, y)/d(state) without the ripple; mm/deg for angles, mm/mm for the arms."""
    n, m = block.counts.shape
    h = np.zeros((n, m, size, 2))
    h[:, :, :N_ARMS] = block.arms.swapaxes(2, 3)
    for axis in range(2):
        column = block.jacobian[:, :, None, :, axis] * block.weights[:, axis, :, :, None]
        np.put_along_axis(h, block.nodes[:, axis, :, :, None], column, axis=2)
    return h.swapaxes(2, 3)


def _ripple_gain(block: MeasurementBlock, variance: Floats) -> Floats:
    """(n, 2 axes, 2 sides, M, M', 2): covariance of measurement M' with the fine knot of M, mm deg."""
    own = np.stack([lines.pick(variance, block.k), lines.pick(variance, block.k + 1)], axis=2)
    at = np.stack([block.k, block.k + 1], axis=2)  # (n, 2, 2, M)
    share = np.stack([1.0 - block.t, block.t], axis=2)
    same = at[:, :, :, None, :, None] == at[:, :, None, :, None, :]
    felt = (same * share[:, :, None, :, None, :]).sum(axis=3)  # (n, axis, side, M, M')
    gain = own[..., None] * felt
    moved: Floats = gain[..., None] * block.jacobian.transpose(0, 3, 1, 2)[:, :, None, None]
    return moved


@dataclass(frozen=True)
class Weighing:
    """How the measurements of a block and the state vary together."""

    with_state: Floats
    """(n, D, 2M)"""
    with_ripple: Floats
    """(n, 2, 2, M, 2M)"""
    spread: Floats
    """(n, 2M, 2M) of the innovations."""

    @classmethod
    def of(cls, state: FilterState, block: MeasurementBlock) -> Weighing:
        """Of a block whose rows are those of the state."""
        n, m = block.counts.shape
        h = design(block, state.mean.shape[1]).reshape(n, 2 * m, -1)
        with_state = state.covariance @ h.swapaxes(1, 2)
        gain = _ripple_gain(block, state.ripple_variance)
        share = np.stack([1.0 - block.t, block.t], axis=2)
        # (n, axis, side, M, M', c') with the Jacobian and share of M
        felt = (share[..., None, None] * gain).sum(axis=2)  # (n, axis, M, M', c')
        ripple = np.einsum("nmca,namkd->nmckd", block.jacobian, felt)
        spread = h @ with_state + ripple.reshape(n, 2 * m, 2 * m)
        noise = np.zeros((n, m, 2, m, 2))
        each = np.arange(m)
        noise[:, each, :, each] = block.noise.swapaxes(0, 1)
        spread = spread + noise.reshape(n, 2 * m, 2 * m)
        return cls(with_state, gain.reshape(n, 2, 2, m, 2 * m), spread)

    def own(self) -> Floats:
        """(n, M, 2, 2) mm^2: each measurement's own covariance."""
        n, size, _ = self.spread.shape
        blocks = self.spread.reshape(n, size // 2, 2, size // 2, 2)
        each = np.arange(size // 2)
        return blocks[:, each, :, each].swapaxes(0, 1)


def surprise(weighing: Weighing, block: MeasurementBlock) -> Floats:
    """(n, M) squared innovation relative to its covariance, dimensionless: 2 on average."""
    solved = np.linalg.solve(weighing.own(), block.innovation[..., None])[..., 0]
    return np.where(block.counts, (block.innovation * solved).sum(axis=-1), np.nan)


def weigh(state: FilterState, block: MeasurementBlock, w: Weighing) -> None:
    """The Kalman update with all measurements that count; changes `state`, which has block's rows."""
    n, m = block.counts.shape
    ignore = np.repeat(~block.counts, 2, axis=1) * _UNSEEN
    scale = np.einsum("nii->n", w.spread)[:, None] / (2 * m)
    spread = w.spread + (ignore * scale)[:, :, None] * np.eye(2 * m)
    innovation = np.where(block.counts[..., None], block.innovation, 0.0).reshape(n, 2 * m)
    inverse = np.linalg.inv(spread)
    solved = (inverse @ innovation[..., None])[..., 0]
    state.mean += (w.with_state @ solved[..., None])[..., 0]
    covariance = state.covariance - w.with_state @ inverse @ w.with_state.swapaxes(1, 2)
    # what rounding makes unsymmetric grows from update to update, until the filter runs away after some
    # 5000 of them: half a hundred cycles of a lifetime test
    state.covariance[:] = 0.5 * (covariance + covariance.swapaxes(1, 2))
    gained = ((w.with_ripple @ inverse[:, None, None]) * w.with_ripple).sum(axis=-1)
    moved = (w.with_ripple @ solved[:, None, None, :, None])[..., 0]
    _replace(state.ripple_deg, block.k, moved)
    _replace(state.ripple_variance, block.k, -gained)
    np.maximum(state.ripple_variance, 0.0, out=state.ripple_variance)


def _replace(values: Floats, k: Ints, change: Floats) -> None:
    """Adds (n, 2, 2 sides, M) at knots k and k + 1, once where several measurements share a knot."""
    # they all carry the same change; so read everything before anything is written
    new = [lines.pick(values, k + side) + change[:, :, side] for side in range(2)]
    for side in range(2):
        np.put_along_axis(values, k + side, new[side], axis=-1)
