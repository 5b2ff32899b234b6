"""The smooth part of what an image shows beside where fibres are expected: air, not arms.

Errors of gears are each unit's own; air shifts neighbours together. So what all fibres have in common over
some 50 mm is taken off before an image teaches. How large the units' own errors are is told by neighbours,
whose air is the same, where they differ by more than their maps say: maps are worse than they know then, and
less is taken off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from fiberloom.metrology.turbulence import AirSize, remove_turbulence
from fiberloom.typing import Flags, Floats

LEAST_FIBRES = 60
"""[A] With fewer nothing is told apart."""
LEAST_STANDING = 50
USUAL_UM, USUAL_MM = 5.0, 50.0
"""[Q] Of the air, as DESI's on-line code takes it."""
MOST_POINTS = 900
"""Of the Gaussian process: some for each stretch of 25 mm of the field."""
_NORMAL = 1.4826
"""A standard deviation, in median absolute deviations."""


@dataclass(frozen=True)
class StillPoints:
    """Points that do not move: M places, how far each is seen beside it, and how well that is known; mm."""

    places_mm: Floats
    off_mm: Floats
    sigma_mm: float


NO_STILL_POINTS = StillPoints(np.empty((0, 2)), np.empty((0, 2)), 1.0)


@dataclass(frozen=True)
class Air:
    """What an image shows beside where N fibres are."""

    shift_mm: Floats
    """(N, 2)."""
    sigma_mm: Floats
    """(N,) of it, per coordinate."""


def air_of(
    expected_mm: Floats,
    off_mm: Floats,
    sigma_mm: Floats,
    told: Flags,
    standing: StillPoints = NO_STILL_POINTS,
) -> Air:
    """The air of an image; nothing where too few tell.

    Parameters
    ----------
    expected_mm : (N, 2) float
        Where fibres are expected.
    off_mm : (N, 2) float
        By how much each is seen beside that; not used where not `told`.
    sigma_mm : (N,) float
        How well that is known without the air, per coordinate.
    told : (N,) bool
        Who is seen, and moves as told.
    standing : StillPoints
        Points that do not move, beside them.
    """
    rows = np.flatnonzero(told & np.isfinite(off_mm).all(axis=1))
    if len(rows) < LEAST_FIBRES:
        return Air(np.zeros_like(expected_mm), np.zeros(len(expected_mm)))
    noise = np.hypot(sigma_mm, _own_mm(expected_mm[rows], off_mm[rows], sigma_mm[rows]))
    few = rows[:: max(1, len(rows) // MOST_POINTS)]
    found = remove_turbulence(
        np.vstack([standing.places_mm, expected_mm[few]]),
        np.vstack([standing.off_mm, off_mm[few]]),
        np.concatenate([np.full(len(standing.places_mm), standing.sigma_mm), noise[few]]),
        expected_mm,
        size=_size(standing),
    )
    return Air(found.shift_mm, np.sqrt(found.variance_mm2))


def _size(standing: StillPoints) -> AirSize:
    """Rms per coordinate in um and length in mm of the air, by what stands still: fibres err too much."""
    if len(standing.places_mm) < LEAST_STANDING:
        return AirSize(USUAL_UM, USUAL_MM)
    places = standing.places_mm
    found = remove_turbulence(places, standing.off_mm, standing.sigma_mm, places[:1])
    return AirSize(found.amplitude_um, found.length_mm)


def _own_mm(places_mm: Floats, off_mm: Floats, sigma_mm: Floats) -> float:
    """By how much neighbours differ more than they may, per coordinate in mm, by the median."""
    _, nearest = cKDTree(places_mm).query(places_mm, k=2)
    apart = off_mm - off_mm[nearest[:, 1]]
    allowed = np.sqrt(sigma_mm**2 + sigma_mm[nearest[:, 1]] ** 2)
    times = _NORMAL * float(np.median(np.abs(apart) / allowed[:, None]))
    beyond = np.sqrt(max(times**2 - 1.0, 0.0))
    return float(beyond * np.median(sigma_mm))
