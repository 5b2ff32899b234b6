"""Offset, rotation and scale of a field from guide stars: where the telescope truly points.

With complex places p (predicted) and m (measured) and their weighted means taken off,
(1 + k) exp(i rho) = sum w m conj(p) / sum w |p|^2, and the offset is mean m - (1 + k) exp(i rho) mean p.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom.errors import InputError
from fiberloom.typing import Flags, Floats
from fiberloom.units import DEG_PER_RAD, RAD_PER_DEG, UM_PER_MM

Complexes = NDArray[np.complex128]

FEWEST_SCALE = 3
"""Stars from which on the scale is fitted and outliers are clipped."""
CLIP_SIGMA = 3.5
_ROUNDS = 20
_MAD_OF_RAYLEIGH = 1.0 / 1.17741
"""Sigma per axis over the median distance, for errors that are normal in x and y."""
_LEAST_MM = 1e-9
"""Below, residuals are rounding."""


@dataclass(frozen=True, eq=False)
class FieldOffset:
    """seen = offset + (1 + k) R(rotation) predicted, in the focal plane: how a telescope points off."""

    offset_mm: Floats
    """(2,)"""
    rotation_deg: float
    """Counter-clockwise; positive where the true position angle is larger than assumed."""
    scale: float
    """1 + k, a ratio; 1 where two stars are too few to tell."""

    def applied(self, xy_mm: Floats) -> Floats:
        """Where predicted places (n, 2) in mm truly are."""
        moved = complex(*self.offset_mm) + self._factor * _complex(xy_mm)
        return np.column_stack([moved.real, moved.imag])

    def removed(self, xy_mm: Floats) -> Floats:
        """Places (n, 2) in mm had the telescope pointed where it should: the reverse of `applied`."""
        back = (_complex(xy_mm) - complex(*self.offset_mm)) / self._factor
        return np.column_stack([back.real, back.imag])

    @property
    def _factor(self) -> complex:
        return complex(self.scale * np.exp(1j * self.rotation_deg * RAD_PER_DEG))


@dataclass(frozen=True, eq=False)
class GuideFit(FieldOffset):
    """What guide stars tell of it."""

    covariance: Floats
    """(4, 4) of offset x, y in mm, rotation in rad and scale (ratio), from the scatter of the stars."""
    used: Flags
    """(n,) stars that were not clipped."""
    residual_um: Floats
    """(n,) distances that are left, of all stars."""

    @property
    def sigma_um(self) -> float:
        """Error of one star per axis, um: from what is left of those that were used."""
        free = self.freedom
        return float(np.sqrt((self.residual_um[self.used] ** 2).sum() / free)) if free > 0 else float("nan")

    @property
    def freedom(self) -> int:
        """Coordinates of the stars that were used, less the parameters."""
        return 2 * int(self.used.sum()) - (4 if self.used.sum() >= FEWEST_SCALE else 3)

    def chi2(self, star_um: float) -> float:
        """Of the stars that were used, each known to `star_um` (um) per axis; `freedom` on average."""
        return float((self.residual_um[self.used] ** 2).sum()) / star_um**2

    def error_um(self, radius_mm: ArrayLike) -> Floats:
        """Expected error of a corrected place at radii in mm, um per axis, from the covariance."""
        turn, scale = self.covariance[2, 2], self.covariance[3, 3]
        offset = 0.5 * (self.covariance[0, 0] + self.covariance[1, 1])
        spread = offset + 0.5 * (turn + scale) * np.asarray(radius_mm, dtype=np.float64) ** 2
        error: Floats = UM_PER_MM * np.sqrt(spread)
        return error


def fit_guiding(predicted_mm: ArrayLike, measured_mm: ArrayLike, weight: ArrayLike | None = None) -> GuideFit:
    """Offset, rotation and scale from guide stars.

    Parameters
    ----------
    predicted_mm : array_like
        (n, 2) where the chain has the stars, mm, scale 1.
    measured_mm : array_like
        (n, 2) where they were seen, mm.
    weight : array_like, optional
        (n,) weights; all alike when left out.

    Returns
    -------
    GuideFit
        With covariance; stars beyond 3.5 robust sigmas are left out.

    Raises
    ------
    InputError
        Fewer than two stars, or all on one place.
    """
    p, m = _complex(predicted_mm), _complex(measured_mm)
    w = np.ones(len(p)) if weight is None else np.asarray(weight, dtype=np.float64)
    good = np.isfinite(p) & np.isfinite(m) & (w > 0.0)
    used = good.copy()
    for _ in range(_ROUNDS):
        offset, factor = _similarity(p[used], m[used], w[used])
        left_mm = np.abs(m - offset - factor * p)
        kept = good & _within(left_mm, good)
        if (kept == used).all() or kept.sum() < FEWEST_SCALE:
            break
        used = kept
    covariance = _covariance(p[used], w[used], left_mm[used])
    return GuideFit(
        np.array([offset.real, offset.imag]),
        float(np.angle(factor)) * DEG_PER_RAD,
        float(np.abs(factor)),
        covariance,
        used,
        UM_PER_MM * left_mm,
    )


def expected_um(n: int, sigma_um: float, ring_mm: float, radius_mm: float) -> float:
    """Error per axis in um of a place at `radius_mm`, after a fit to `n` stars.

    `sigma_um`: of a star per axis; `ring_mm`: radius r_g of the ring on which they are. It is
    sigma sqrt((1 + r^2 / r_g^2) / N).
    """
    return sigma_um * float(np.sqrt((1.0 + (radius_mm / ring_mm) ** 2) / n))


def _complex(xy: ArrayLike) -> Complexes:
    xy = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
    return xy[:, 0] + 1j * xy[:, 1]


def _similarity(p: Complexes, m: Complexes, w: Floats) -> tuple[complex, complex]:
    if len(p) < 2:
        raise InputError(f"guiding: {len(p)} guide stars; offset and rotation need 2")
    mean_p, mean_m = (np.average(x, weights=w) for x in (p, m))
    spread = np.sum(w * np.abs(p - mean_p) ** 2)
    if not spread > 0.0:
        raise InputError("guiding: all guide stars are on one place; the rotation needs two places")
    factor = np.sum(w * (m - mean_m) * np.conj(p - mean_p)) / spread
    if len(p) < FEWEST_SCALE:
        factor /= np.abs(factor)
    return complex(mean_m - factor * mean_p), complex(factor)


def _within(left_mm: Floats, good: Flags) -> Flags:
    """Stars within 3.5 sigmas; sigma from the median of all, since that of those kept would shrink."""
    if good.sum() <= FEWEST_SCALE:
        return good
    sigma = max(float(np.median(left_mm[good])) * _MAD_OF_RAYLEIGH, _LEAST_MM)
    within: Flags = left_mm <= CLIP_SIGMA * sigma
    return within


def _covariance(p: Complexes, w: Floats, left_mm: Floats) -> Floats:
    """(4, 4) of offset (mm), rotation (rad), scale; the weights say how errors compare, not how large."""
    one, zero = np.ones(len(p)), np.zeros(len(p))
    rows = [np.column_stack([one, zero, -p.imag, p.real]), np.column_stack([zero, one, p.real, p.imag])]
    design = np.vstack(rows) * np.sqrt(np.tile(w, 2))[:, None]
    parameters = 4 if len(p) >= FEWEST_SCALE else 3
    free = 2 * len(p) - parameters
    variance = float(np.sum(w * left_mm**2)) / free if free > 0 else float("nan")
    covariance = np.zeros((4, 4))
    inside = np.linalg.inv(design.T @ design)[:parameters, :parameters]
    if parameters < 4:
        inside = np.linalg.inv(design[:, :3].T @ design[:, :3])
    covariance[:parameters, :parameters] = variance * inside
    return covariance
