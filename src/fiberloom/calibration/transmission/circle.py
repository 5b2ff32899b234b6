"""Circles through measured points, many at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.typing import Flags, Floats

# A point this many (robust) standard deviations off its circle is the spot of another, or a move
# that went wrong; never cut what lies within the floor, where a perfect camera would have it.
_OUTLIER_SIGMAS = 6.0
_OUTLIER_FLOOR_MM = 1e-4
_STEPS = 6
_ROUNDS = 3


@dataclass(frozen=True)
class Circles:
    """N least-squares circles."""

    centre_mm: Floats
    """(N, 2)"""
    radius_mm: Floats
    """(N,)"""
    covariance: Floats
    """(N, 3, 3) mm^2 of centre x, centre y, radius, from the residual scatter."""
    rms_mm: Floats
    """(N,) radial residual."""
    used: Flags
    """(N, M) points that took part."""


def fit_circles(xy_mm: Floats, use: Flags) -> Circles:
    """Least squares of the radial distance for (N, M, 2) points; outliers are thrown out.

    Rows with fewer than three usable points get what the pseudo-inverse makes of them: the caller
    decides how many are enough.
    """
    used = use & np.isfinite(xy_mm).all(axis=-1)
    xy = np.where(used[..., None], xy_mm, 0.0)
    for _ in range(_ROUNDS):
        p = _refine(xy, used, _algebraic(xy, used))
        distance = np.where(used, _radial(xy, p), np.nan)
        kept = used & (np.abs(np.nan_to_num(distance)) <= _limit(distance)[:, None])
        if (kept == used).all():
            break
        used = kept
    return _summary(xy, used, p)


def _algebraic(xy: Floats, used: Flags) -> Floats:
    """x^2 + y^2 = 2 a x + 2 b y + c, linear in (a, b, c): a start that needs none itself."""
    count = np.maximum(used.sum(axis=1), 1)
    mean = xy.sum(axis=1) / count[:, None]
    d = (xy - mean[:, None]) * used[..., None]
    design = np.concatenate([2 * d, used[..., None]], axis=-1)
    solution = _solve(design, (d**2).sum(axis=-1))
    squared = solution[:, 2] + (solution[:, :2] ** 2).sum(axis=1)
    return np.column_stack([solution[:, :2] + mean, np.sqrt(np.maximum(squared, 0.0))])


def _refine(xy: Floats, used: Flags, p: Floats) -> Floats:
    """Gauss-Newton on the radial distance."""
    for _ in range(_STEPS):
        design = _design(xy, used, p)
        p = p + _solve(design, _radial(xy, p) * used)
    return p


def _design(xy: Floats, used: Flags, p: Floats) -> Floats:
    out = xy - p[:, None, :2]
    length = np.maximum(np.linalg.norm(out, axis=-1, keepdims=True), 1e-300)
    return np.concatenate([out / length, np.ones_like(length)], axis=-1) * used[..., None]


def _radial(xy: Floats, p: Floats) -> Floats:
    off: Floats = np.linalg.norm(xy - p[:, None, :2], axis=-1) - p[:, None, 2]
    return off


def _solve(design: Floats, right: Floats) -> Floats:
    normal = np.einsum("nmi,nmj->nij", design, design)
    step: Floats = np.einsum("nij,nj->ni", np.linalg.pinv(normal), np.einsum("nmi,nm->ni", design, right))
    return step


def _limit(distance: Floats) -> Floats:
    """(N,) from the median absolute deviation, which outliers do not move."""
    filled = np.where(np.isnan(distance).all(axis=1, keepdims=True), 0.0, distance)
    median = np.nanmedian(filled, axis=1, keepdims=True)
    sigma = 1.4826 * np.nanmedian(np.abs(filled - median), axis=1)
    limit: Floats = np.maximum(_OUTLIER_SIGMAS * sigma, _OUTLIER_FLOOR_MM)
    return limit


def _summary(xy: Floats, used: Flags, p: Floats) -> Circles:
    design = _design(xy, used, p)
    square = (used * _radial(xy, p) ** 2).sum(axis=1)
    count = used.sum(axis=1)
    variance = square / np.maximum(count - 3, 1)
    inverse = np.linalg.pinv(np.einsum("nmi,nmj->nij", design, design))
    rms = np.sqrt(square / np.maximum(count, 1))
    return Circles(p[:, :2], p[:, 2], inverse * variance[:, None, None], rms, used)
