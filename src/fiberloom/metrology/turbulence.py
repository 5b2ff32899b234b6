"""What the air between camera and focal plane does to the image, taken off again.

Turbulence in the dome shifts neighbouring spots together: a field of a few micrometres that is the
same over some 50 mm and new in every exposure. Points that do not move (fiducials, positioners that
do not move) show it; a Gaussian process carries it to the fibres between them, each axis alone:

    k(p, q) = s^2 exp(-|p - q|^2 / (2 l^2)),   shift(q) = k_q^T (K + N)^-1 d,
    variance(q) = s^2 - k_q^T (K + N)^-1 k_q

with d the observed shifts and N their variances. s and l are those of the highest marginal
likelihood on a small grid, or given.

Where a transform was fitted to the same points before, its terms have taken up whatever air looks like them,
and carry it to the edge and beyond, where no point holds them. So these terms are fitted once more, together
with the air (universal kriging: Cressie 1993, Statistics for Spatial Data, 3.4). With A the terms at the
points, b at a place:

    c = (A^T C^-1 A)^-1 A^T C^-1 d,   shift(q) = b c + k_q^T C^-1 (d - A c),   C = K + N,
    variance(q) = s^2 - k_q^T C^-1 k_q + g^T (A^T C^-1 A)^-1 g,   g = b - A^T C^-1 k_q

and the likelihood is that of what no such term can be (REML).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist

from fiberloom.errors import InputError
from fiberloom.typing import Flags, Floats
from fiberloom.units import MM_PER_UM, UM_PER_MM

_AMPLITUDES = (0.6, 0.8, 1.0, 1.3, 1.7)
"""Tried, in units of the scatter of the shifts beyond their noise."""
_LEAST_UM = 0.3
_LENGTHS_MM = (25.0, 35.0, 50.0, 70.0, 100.0, 150.0)
_FIT_ON = 250
"""Points that the hyperparameters are fitted on, at most: more tell nothing new about two numbers."""
_CLIP = 5.0
_ROUNDS = 12
_LEAST_TOLD = 1e-12
"""Of what points tell best of the terms: sums of terms of which they tell less are left at 0."""


@dataclass(frozen=True)
class Turbulence:
    """A field of shifts at n places."""

    shift_mm: Floats
    """(n, 2): measured minus true."""
    variance_mm2: Floats
    """(n,) per coordinate: what is not known of it."""
    amplitude_um: float
    """Per coordinate."""
    length_mm: float
    used: Flags
    """Which of the standing points were believed."""


class AirSize(NamedTuple):
    """How much air there is."""

    amplitude_um: float
    """Rms per coordinate."""
    length_mm: float
    """Of the correlation: exp(-d^2 / (2 l^2)) over a distance d."""


@dataclass(frozen=True)
class FittedTerms:
    """The K terms of a transform that was fitted to the standing points: mm/mm, or any other unit."""

    standing: Floats
    """(K, m, 2) their fields at the standing points."""
    places: Floats
    """(K, n, 2) at the places."""

    def of(self, rows: Flags | slice) -> FittedTerms:
        """With some of the standing points."""
        return FittedTerms(self.standing[:, rows], self.places)


def remove_turbulence(
    standing_mm: ArrayLike,
    shift_mm: ArrayLike,
    sigma_mm: ArrayLike,
    places_mm: ArrayLike,
    *,
    size: AirSize | None = None,
    trend: FittedTerms | None = None,
) -> Turbulence:
    """The field at `places_mm` (n, 2) from shifts seen at points that do not move.

    `standing_mm` (m, 2): these points; `shift_mm` (m, 2): measured less known place; `sigma_mm` (m,) or
    one number: how well each shift is known, per coordinate, its place in the focal plane included.
    `size` of the air, estimated when None; `trend` of a transform fitted to these points, whose residuals the
    shifts are, None where there was none. Points that disagree with their neighbours by five sigma have moved
    and are left out.
    """
    at, shift, places = (np.asarray(a, dtype=np.float64) for a in (standing_mm, shift_mm, places_mm))
    if at.shape != shift.shape or at.ndim != 2 or len(at) < 3:
        raise InputError(f"turbulence: {len(at)} standing points, at least 3 are needed")
    noise = np.broadcast_to(np.square(np.asarray(sigma_mm, dtype=np.float64)), (len(at),))
    used = np.isfinite(shift).all(axis=1) & (noise > 0)
    fitted = trend or FittedTerms(np.zeros((0, len(at), 2)), np.zeros((0, len(places), 2)))
    points = _StandingPoints(at[used], shift[used], noise[used], fitted.of(used))
    s_um, l_mm = size or _estimated(points)
    for _ in range(_ROUNDS):
        process = _Process(at[used], noise[used], s_um * MM_PER_UM, l_mm)
        off, spread = process.left_out(shift[used])
        sigmas = np.hypot(*off.T) / np.sqrt(spread)
        # the worst first: its neighbours look wrong only because of it
        bad = sigmas > max(_CLIP, 0.3 * float(sigmas.max(initial=0.0)))
        if not bad.any() or used.sum() - bad.sum() < 3:
            break
        used[np.flatnonzero(used)[bad]] = False
    field, variance = process.predict(shift[used], places, fitted.of(used))
    return Turbulence(field, variance, s_um, l_mm, used)


@dataclass(frozen=True)
class _StandingPoints:
    """Standing points: where, (m, 2) shifts, (m,) their variances, and the terms that were fitted to them."""

    at: Floats
    shift: Floats
    noise: Floats
    trend: FittedTerms

    def of(self, rows: Flags | slice) -> _StandingPoints:
        return _StandingPoints(self.at[rows], self.shift[rows], self.noise[rows], self.trend.of(rows))


class _TrendFit(NamedTuple):
    """Terms that were fitted beside the air."""

    covariance: Floats
    """(K, K): the inverse of the normal matrix, where it has one."""
    terms: Floats
    """(K,)"""
    left: Floats
    """(m, 2) shifts without them."""
    log_determinant: float
    """Of the normal matrix, as far as its inverse goes."""


class _Process:
    """The Gaussian process with its factorised covariance."""

    def __init__(self, at: Floats, noise: Floats, amplitude: float, length: float) -> None:
        self.at, self.amplitude, self.length = at, amplitude, length
        self.factor = cho_factor(self._kernel(at) + np.diag(noise), lower=True)

    def _kernel(self, places: Floats) -> Floats:
        square = cdist(places, self.at, "sqeuclidean")
        covariance: Floats = self.amplitude**2 * np.exp(-0.5 * square / self.length**2)
        return covariance

    def predict(self, shift: Floats, places: Floats, trend: FittedTerms) -> tuple[Floats, Floats]:
        k = self._kernel(places)
        weights = cho_solve(self.factor, k.T)
        variance = np.maximum(self.amplitude**2 - np.einsum("nm,mn->n", k, weights), 0.0)
        fit = self._fit(shift, trend)
        gap = trend.places - np.einsum("kmc,mn->knc", trend.standing, weights)
        unsure: Floats = 0.5 * np.einsum("knc,kl,lnc->n", gap, fit.covariance, gap, optimize=True)
        return weights.T @ fit.left + np.einsum("k,knc->nc", fit.terms, trend.places), variance + unsure

    def _fit(self, shift: Floats, trend: FittedTerms) -> _TrendFit:
        """The terms beside the air, by least squares; what the points do not tell of them stays 0."""
        normal, right = np.zeros((len(trend.standing),) * 2), np.zeros(len(trend.standing))
        for axis in (0, 1):
            terms = trend.standing[..., axis]
            weighed = cho_solve(self.factor, terms.T)
            normal += terms @ weighed
            right += weighed.T @ shift[:, axis]
        values, vectors = np.linalg.eigh(normal)
        told = values > _LEAST_TOLD * values.max(initial=0.0)
        values, vectors = values[told], vectors[:, told]
        covariance = (vectors / values) @ vectors.T
        c = covariance @ right
        left = shift - np.einsum("k,kmc->mc", c, trend.standing)
        return _TrendFit(covariance, c, left, float(np.sum(np.log(values))))

    def left_out(self, shift: Floats) -> tuple[Floats, Floats]:
        """Each shift less what all others say, and the variance of that: from one inverse."""
        inverse = cho_solve(self.factor, np.eye(len(self.at)))
        diagonal = np.diag(inverse)
        return (inverse @ shift) / diagonal[:, None], 1.0 / diagonal

    def log_likelihood(self, shift: Floats, trend: FittedTerms) -> float:
        fit = self._fit(shift, trend)
        misfit = np.sum(fit.left * cho_solve(self.factor, fit.left))
        log_determinant = 2 * np.sum(np.log(np.diag(self.factor[0])))
        return float(-0.5 * misfit - 0.5 * shift.shape[1] * log_determinant - 0.5 * fit.log_determinant)


def _estimated(points: _StandingPoints) -> AirSize:
    """The likeliest of a small grid."""
    points = points.of(slice(None, None, max(1, len(points.at) // _FIT_ON)))
    # a point that moved must not pass for strong turbulence
    size = np.hypot(*(points.shift - np.median(points.shift, axis=0)).T)
    points = points.of(size <= 6 * np.median(size) + 1e-12)
    beyond = max(float(np.mean(points.shift**2) - np.mean(points.noise)), 0.0)
    scatter_um = max(UM_PER_MM * float(np.sqrt(beyond)), _LEAST_UM)
    tried = [AirSize(scatter_um * times, length) for times in _AMPLITUDES for length in _LENGTHS_MM]
    return max(tried, key=lambda size: (_likelihood(points, size), size))


def _likelihood(points: _StandingPoints, size: AirSize) -> float:
    process = _Process(points.at, points.noise, size.amplitude_um * MM_PER_UM, size.length_mm)
    return process.log_likelihood(points.shift, points.trend)


def rms_um(shift_mm: ArrayLike) -> float:
    """2-D rms of shifts (n, 2)."""
    return UM_PER_MM * float(np.sqrt(np.mean(np.sum(np.square(shift_mm), axis=1))))
