"""What an identification gives: a value with its standard error, or the reason why there is none.

All arrays have a row for each positioner. A standard error holds what scatters and what does not: the
first comes from the residuals, the second (`systematic`) from what the reference is known to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from fiberloom.errors import InputError
from fiberloom.typing import Flags, Floats, Ints


@dataclass(frozen=True, eq=False)
class Estimate:
    """One quantity of N positioners."""

    name: str
    unit: str
    value: Floats
    """(N,); NaN where refused."""
    standard_error: Floats
    """(N,) everything included."""
    n: Ints
    """(N,) measurements used."""
    residuals: Floats
    """(N, M) measured minus fitted, NaN where not used."""
    residual_unit: str
    reason: tuple[str, ...]
    """Why a positioner has no estimate; empty where it has."""
    systematic: Floats | float = 0.0
    """Part of the standard error that more of the same measurements would not make smaller."""
    freedom: Floats | float = np.inf
    """Degrees of freedom of the part that scatters."""

    def __len__(self) -> int:
        return len(self.value)

    @property
    def ok(self) -> Flags:
        """(N,) which positioners have an estimate."""
        return np.array([not r for r in self.reason], dtype=bool)

    def interval(self, level: float = 0.95) -> tuple[Floats, Floats]:
        """Confidence interval (N,), (N,) of each positioner in the unit of the value; `level` is a
        probability.

        Student's t; Welch's rule with a systematic part.
        """
        whole2 = self.standard_error**2
        scatter2 = np.maximum(whole2 - np.square(self.systematic), 1e-6 * whole2)
        share2 = np.divide(whole2, scatter2, out=np.ones_like(whole2), where=scatter2 > 0.0)
        freedom = np.maximum(np.asarray(self.freedom) * share2**2, 1.0)
        half = stats.t.ppf(0.5 + 0.5 * level, freedom) * self.standard_error
        return self.value - half, self.value + half

    def of(self, row: int) -> tuple[float, float]:
        """Value and standard error of one positioner, in the unit that `unit` names (mm, deg, ...);
        InputError with the reason where there is none.
        """
        if self.reason[row]:
            raise InputError(f"{self.name}: {self.reason[row]}")
        return float(self.value[row]), float(self.standard_error[row])

    def record(self, row: int) -> dict[str, Any]:
        """One positioner's result as a file holds it."""
        if self.reason[row]:
            return {"unit": self.unit, "value": None, "reason": self.reason[row]}
        low, high = (float(side[row]) for side in self.interval())
        systematic = np.broadcast_to(self.systematic, self.value.shape)
        return {
            "unit": self.unit,
            "value": float(self.value[row]),
            "standard_error": float(self.standard_error[row]),
            "systematic": float(systematic[row]),
            "interval_95": [low, high],
            "n": int(self.n[row]),
            "residual_rms": float(np.sqrt(np.nanmean(self.residuals[row] ** 2))),
            "residual_unit": self.residual_unit,
        }

    def scaled(self, factor: ArrayLike, relative_error: ArrayLike = 0.0, **changes: Any) -> Estimate:
        """Multiplied by something that is itself known to a relative error."""
        factor = np.asarray(factor, dtype=np.float64)
        new = self.value * factor
        added = new * np.asarray(relative_error)
        return replace(
            self,
            value=new,
            standard_error=np.hypot(self.standard_error * np.abs(factor), added),
            systematic=np.hypot(np.asarray(self.systematic) * np.abs(factor), added),
            **changes,
        )


@dataclass(frozen=True, eq=False)
class Fitted:
    """Values of N positioners as a fit gives them, in one unit."""

    value: Floats
    """(N,)"""
    scatter: Floats
    """(N,) standard error by the scatter of the measurements alone."""
    systematic: ArrayLike = 0.0
    """Part of the error that more measurements would not make smaller."""
    freedom: ArrayLike = np.inf
    """Degrees of freedom of the scatter."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Measured minus fitted."""

    value: Floats
    """(N, M) NaN where not used."""
    unit: str


def estimate(name: str, unit: str, fitted: Fitted, residuals: Residuals, reason: Sequence[str]) -> Estimate:
    """An Estimate from the scatter's standard error, NaN where refused.

    `name` and `unit` of the quantity (mm, deg, ...); `fitted` in that unit; `residuals` in their own;
    `reason` per positioner, empty where it has an estimate. InputError when no positioner has data that
    support it.
    """
    reason = tuple(reason)
    refuse_if_all(name, reason)
    good = np.array([not r for r in reason])
    value = fitted.value
    systematic = np.broadcast_to(np.asarray(fitted.systematic, dtype=np.float64), value.shape)
    return Estimate(
        name,
        unit,
        np.where(good, value, np.nan),
        np.where(good, np.hypot(fitted.scatter, systematic), np.nan),
        np.asarray(np.isfinite(residuals.value).sum(axis=1), dtype=np.int64),
        residuals.value,
        residuals.unit,
        reason,
        systematic,
        np.broadcast_to(np.asarray(fitted.freedom, dtype=np.float64), value.shape),
    )


def refuse_if_all(name: str, reason: Sequence[str]) -> None:
    """InputError with the first reason when no positioner is left."""
    if len(reason) and all(reason):
        others = f" (and {len(reason) - 1} more, all refused)" if len(reason) > 1 else ""
        raise InputError(f"{name}: {reason[0]}{others}")


@dataclass(frozen=True, eq=False)
class Fit:
    """Least squares of N positioners at once."""

    value: Floats
    """(N, P)"""
    covariance: Floats
    """(N, P, P) from the residuals, their correlation along the row included."""
    residuals: Floats
    """(N, M) NaN where not used."""
    freedom: Floats
    """(N,)"""
    singular: Flags
    """(N,) the data do not tell the unknowns apart."""


def least_squares(design: Floats, right: Floats, *, used: Flags | None = None, lag: int = 0) -> Fit:
    """Fits `right` (N, M) = `design` (N, M, P) @ value; rows of NaN do not count, nor those not `used`
    (N, M).

    The values have the unit of `right` over that of `design`. Neighbouring residuals may go together,
    up to `lag` places apart: then the covariance is Newey and West's (Bartlett weights), with 1/(1 -
    P/M) for the unknowns. Singular where the columns, each scaled to unit length, are dependent to
    1e-7.
    """
    good = np.isfinite(right) & np.isfinite(design).all(axis=-1)
    good = good if used is None else good & used
    x = np.where(good[..., None], design, 0.0)
    y = np.where(good, right, 0.0)
    length = np.sqrt((x**2).sum(axis=1))
    length = np.where(length > 0.0, length, 1.0)
    x = x / length[:, None]
    normal = np.einsum("nmi,nmj->nij", x, x)
    weakest = np.linalg.eigvalsh(normal)[:, 0]
    inverse = np.linalg.pinv(normal, hermitian=True)
    scaled = np.einsum("nij,nmj,nm->ni", inverse, x, y, optimize=True)
    left = (y - np.einsum("nmi,ni->nm", x, scaled)) * good
    freedom = np.maximum(good.sum(axis=1) - x.shape[-1], 1).astype(np.float64)
    share = freedom / np.maximum(good.sum(axis=1), 1)
    middle = _long_run(x * left[..., None], lag) / share[:, None, None]
    if lag == 0:
        middle = normal * ((left**2).sum(axis=1) / freedom)[:, None, None]
    covariance = inverse @ middle @ inverse / (length[:, :, None] * length[:, None, :])
    return Fit(
        scaled / length,
        covariance,
        np.where(good, left, np.nan),
        freedom / (1.0 + lag),
        (weakest < 1e-7) | (good.sum(axis=1) <= x.shape[-1]),
    )


def _long_run(score: Floats, lag: int) -> Floats:
    """(N, P, P) sums of products of scores up to `lag` apart, with falling weights."""
    out: Floats = np.einsum("nmi,nmj->nij", score, score)
    for k in range(1, lag + 1):
        side = np.einsum("nmi,nmj->nij", score[:, k:], score[:, :-k])
        out += (1.0 - k / (lag + 1.0)) * (side + side.transpose(0, 2, 1))
    return out


def standard_errors(fit: Fit) -> Floats:
    """(N, P) standard deviations of the fitted values, in their units."""
    variances = np.einsum("nii->ni", fit.covariance)
    errors: Floats = np.sqrt(np.maximum(variances, 0.0))
    return errors
