"""What the air between camera and focal plane does to the image, taken off again.

Turbulence in the dome shifts neighbouring spots together: a field of a few micrometres that is the
same over some 50 mm and new in every exposure. Points that do not move (fiducials, positioners that
do not move) show it; a Gaussian process carries it to the fibres between them, each axis alone:

    k(p, q) = s^2 exp(-|p - q|^2 / (2 l^2)),   shift(q) = k_q^T (K + N)^-1 d,
    variance(q) = s^2 - k_q^T (K + N)^-1 k_q

with d the observed shifts and N their variances. s and l are those of the highest marginal
likelihood on a small grid, or given.
"""

from __future__ import annotations

from dataclasses import dataclass

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


def remove_turbulence(
    standing_mm: ArrayLike,
    shift_mm: ArrayLike,
    sigma_mm: ArrayLike,
    places_mm: ArrayLike,
    *,
    amplitude_um: float | None = None,
    length_mm: float | None = None,
) -> Turbulence:
    """The field at `places_mm` (n, 2) from shifts seen at points that do not move.

    `standing_mm` (m, 2): these points; `shift_mm` (m, 2): measured less known place; `sigma_mm` (m,) or
    one number: how well each shift is known, per coordinate, its place in the focal plane included.
    `amplitude_um` and `length_mm`: rms and correlation length of the air, estimated when None. Points
    that disagree with their neighbours by five sigma have moved and are left out.
    """
    at, shift, places = (np.asarray(a, dtype=np.float64) for a in (standing_mm, shift_mm, places_mm))
    if at.shape != shift.shape or at.ndim != 2 or len(at) < 3:
        raise InputError(f"turbulence: {len(at)} standing points, at least 3 are needed")
    noise = np.broadcast_to(np.square(np.asarray(sigma_mm, dtype=np.float64)), (len(at),))
    used = np.isfinite(shift).all(axis=1) & (noise > 0)
    s_um, l_mm = _hyperparameters(at[used], shift[used], noise[used], amplitude_um, length_mm)
    for _ in range(_ROUNDS):
        process = _Process(at[used], noise[used], s_um * MM_PER_UM, l_mm)
        off, spread = process.left_out(shift[used])
        size = np.hypot(*off.T) / np.sqrt(spread)
        # the worst first: its neighbours look wrong only because of it
        bad = size > max(_CLIP, 0.3 * float(size.max(initial=0.0)))
        if not bad.any() or used.sum() - bad.sum() < 3:
            break
        used[np.flatnonzero(used)[bad]] = False
    field, variance = process.predict(shift[used], places)
    return Turbulence(field, variance, s_um, l_mm, used)


class _Process:
    """The Gaussian process with its factorised covariance."""

    def __init__(self, at: Floats, noise: Floats, amplitude: float, length: float) -> None:
        self.at, self.amplitude, self.length = at, amplitude, length
        self.factor = cho_factor(self._kernel(at) + np.diag(noise), lower=True)

    def _kernel(self, places: Floats) -> Floats:
        square = cdist(places, self.at, "sqeuclidean")
        covariance: Floats = self.amplitude**2 * np.exp(-0.5 * square / self.length**2)
        return covariance

    def predict(self, shift: Floats, places: Floats) -> tuple[Floats, Floats]:
        k = self._kernel(places)
        explained = np.einsum("nm,mn->n", k, cho_solve(self.factor, k.T))
        variance = np.maximum(self.amplitude**2 - explained, 0.0)
        return k @ cho_solve(self.factor, shift), variance

    def left_out(self, shift: Floats) -> tuple[Floats, Floats]:
        """Each shift less what all others say, and the variance of that: from one inverse."""
        inverse = cho_solve(self.factor, np.eye(len(self.at)))
        diagonal = np.diag(inverse)
        return (inverse @ shift) / diagonal[:, None], 1.0 / diagonal

    def log_likelihood(self, shift: Floats) -> float:
        fit = np.sum(shift * cho_solve(self.factor, shift))
        log_determinant = 2 * np.sum(np.log(np.diag(self.factor[0])))
        return float(-0.5 * fit - 0.5 * shift.shape[1] * log_determinant)


def _hyperparameters(
    at: Floats, shift: Floats, noise: Floats, amplitude_um: float | None, length_mm: float | None
) -> tuple[float, float]:
    if amplitude_um is not None and length_mm is not None:
        return amplitude_um, length_mm
    step = max(1, len(at) // _FIT_ON)
    at, shift, noise = at[::step], shift[::step], noise[::step]
    # a point that moved must not pass for strong turbulence
    size = np.hypot(*(shift - np.median(shift, axis=0)).T)
    calm = size <= 6 * np.median(size) + 1e-12
    at, shift, noise = at[calm], shift[calm], noise[calm]
    beyond = max(float(np.mean(shift**2) - np.mean(noise)), 0.0)
    scatter_um = max(UM_PER_MM * float(np.sqrt(beyond)), _LEAST_UM)
    sizes = [scatter_um * a for a in _AMPLITUDES] if amplitude_um is None else [amplitude_um]
    lengths = _LENGTHS_MM if length_mm is None else (length_mm,)
    tried = [
        (_Process(at, noise, s * MM_PER_UM, length).log_likelihood(shift), s, length)
        for s in sizes
        for length in lengths
    ]
    return max(tried)[1:]


def rms_um(shift_mm: ArrayLike) -> float:
    """2-D rms of shifts (n, 2)."""
    return UM_PER_MM * float(np.sqrt(np.mean(np.sum(np.square(shift_mm), axis=1))))
