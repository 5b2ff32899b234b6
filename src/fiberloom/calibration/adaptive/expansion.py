"""Arms that grow with the temperature: their plane at another one, and the coefficient learnt from history.

In the frame of the fiducials' table arms of length l at the temperature T1 have l (1 + e (T - T1)) at T, with
e the expansion of the arms less that of the plate. Growth moves a fibre straight away from its centre: with
lever d, from the centre to the fibre, and r, measured less expected, one image tells

    g = sum d r / sum d^2

(least squares, one number for all arms), with a standard error from how r scatters along d: errors of maps
and camera. Nights k whose arms were calibrated alike then tell e as the slope of g_k over T_k, by weighted
least squares with an offset of its own for each calibration, since arms that were measured too long look so
in each night.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.instruments.arms import CENTRE, L_ALPHA
from fiberloom.instruments.model import Expansion
from fiberloom.typing import Flags, Floats, Ints

_FEWEST = 5
"""Fibres, below which a growth has no standard error worth the name."""
_FAR = 5.0
"""Robust standard deviations beyond which a fibre does not count."""
_MEDIAN = 0.6745
"""Of the distance from the mean of a Gaussian, over its sigma."""


@dataclass(frozen=True)
class KnownExpansion:
    """Growth of the arms against the plate for each kelvin, as far as it is known."""

    per_K: float
    sd_per_K: float
    """Standard error."""
    nights: int = 0
    """Observations that it was learnt from; 0: the instrument says so."""

    @classmethod
    def nominal(cls, expansion: Expansion) -> KnownExpansion:
        """What an instrument says."""
        return cls(expansion.arms_per_K, expansion.arms_per_K_sd)


@dataclass(frozen=True)
class NightGrowth:
    """What one observation has shown of the arms."""

    at_C: float
    """Of the positioners, by their thermometers."""
    growth: float
    """Of all arms against those of the calibration, a ratio."""
    sigma: float
    """Its standard error."""
    calibration: str
    """A mark of the arms and maps that it is held against."""


def grown(plane: FocalPlane, growth: float) -> FocalPlane:
    """The layout of a `plane` with arms longer by `growth`, a ratio; centres and zeros stay."""
    if growth == 0.0:
        return plane
    arms = plane.arms.copy()
    arms[:, L_ALPHA] *= 1.0 + growth
    points = {name: xy_mm * (1.0 + growth) for name, xy_mm in plane.points.items()}
    return replace(plane, arms=arms, points=points)


def ungrown_mm(xy_mm: Floats, centres_mm: Floats, growth: float) -> Floats:
    """(n, 2) mm: where fibres would be with arms that had not grown.

    `xy_mm`: (n, 2) where they are; `centres_mm`: (n, 2) of their positioners; `growth`: a ratio.
    """
    return xy_mm if growth == 0.0 else centres_mm + (xy_mm - centres_mm) / (1.0 + growth)


def growth_seen(plane: FocalPlane, angles_deg: Floats, xy_mm: Floats, counted: Flags) -> tuple[float, float]:
    """By how much the arms of a `plane` of N positioners are longer than it says, a ratio, and its sigma.

    `angles_deg`: (N, 2) alpha and beta by the maps; `xy_mm`: (N, 2) metrology fibres in an image; `counted`:
    (N,) those to go by. NaN where too few are left.
    """
    lever_mm = plane.forward(angles_deg[:, 0], angles_deg[:, 1], METROLOGY) - plane.arms[:, CENTRE]
    apart_mm = xy_mm - plane.arms[:, CENTRE] - lever_mm
    used = counted & np.isfinite(apart_mm).all(axis=1)
    if used.sum() < _FEWEST:
        return np.nan, np.nan
    square = np.maximum((lever_mm**2).sum(axis=1), 1e-12)
    along = (lever_mm * np.nan_to_num(apart_mm)).sum(axis=1)
    each_mm = along / np.sqrt(square)
    sigma_mm = np.median(np.abs(each_mm[used] - np.median(each_mm[used]))) / _MEDIAN
    used &= np.abs(each_mm - np.median(each_mm[used])) <= _FAR * sigma_mm
    total = square[used].sum()
    found = along[used].sum() / total
    left = along[used] - found * square[used]
    return float(found), float(np.sqrt((left**2).sum() * used.sum() / (used.sum() - 1)) / total)


def learnt_expansion(nominal: KnownExpansion, nights: Sequence[NightGrowth]) -> KnownExpansion:
    """The expansion that observations show, where they show it better than `nominal` is known; else that.

    `nights`: observations. All at one temperature, or one for each calibration, show nothing.
    """
    weight = np.array([night.sigma**-2.0 for night in nights])
    marks = np.unique([night.calibration for night in nights], return_inverse=True)[1]
    at_C, growth = (np.array([getattr(night, name) for night in nights]) for name in ("at_C", "growth"))
    warmer_K, grown_by = (_about_mean(values, weight, marks) for values in (at_C, growth))
    told = float((weight * warmer_K**2).sum())
    free = len(nights) - len(set(marks.tolist())) - 1
    if free < 1 or told <= 0.0:
        return nominal
    slope = float((weight * warmer_K * grown_by).sum()) / told
    chi2 = float((weight * (grown_by - slope * warmer_K) ** 2).sum()) / free
    # nights that scatter more than they say are not believed as they say
    sd = float(np.sqrt(max(chi2, 1.0) / told))
    return KnownExpansion(slope, sd, len(nights)) if sd < nominal.sd_per_K else nominal


def _about_mean(values: Floats, weight: Floats, marks: Ints) -> Floats:
    """The values less the weighted mean of those of the same mark."""
    about = values.astype(np.float64)
    for mark in np.unique(marks):
        rows = marks == mark
        about[rows] -= np.average(values[rows], weights=weight[rows])
    return about
