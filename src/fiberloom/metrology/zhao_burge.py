"""Zhao-Burge vector polynomials: orthonormal distortions on the unit disc.

C. Zhao and J. H. Burge, Opt. Express 15, 18014 (2007), part I (S: gradients of Zernike
polynomials, free of curl) and Opt. Express 16, 6586 (2008), part II (T: free of divergence). With
Noll's index j of (n, m), Noll-normalised Z_j, and j' = (n - 2, m):

    S_j = grad Z_j / sqrt(2 n (n + 1))                                          n = |m|
    S_j = (grad Z_j - sqrt((n + 1)/(n - 1)) grad Z_j') / sqrt(4 n (n + 1))      else
    T_j = the same scalar, its gradient turned: (d/dy, -d/dx)                   n != |m| only

The gradients are taken of polynomials in x and y, exactly. Terms are numbered as instruments do
(`polid`): 0..26 = S2..S28, 27..32 = T4, T7, T8, T11, T12, T13. Polids 0 and 1 are shifts, 2 is a
change of scale, 27 a rotation, 9 = S11 the third-order and 20 = S22 the fifth-order radial term.
Ours is one more, 33 = S37, the seventh-order radial term: the inverse of a third-order distortion has
one, 0.6 um rms for the 0.64 mm of SDSS-V's camera. Terms 34..56 are the rest of the seventh degree and below:
S29..S36, T16..T19, T22..T26, T29..T34. No camera fits them, its fiducials are too few; hundreds of stars tell
them (`calibration.fibres.frame`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from math import comb, factorial, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom.typing import Floats

Ints = NDArray[np.intp]

N_TERMS = 34
"""That a camera may fit."""
N_WIDE_TERMS = 57
"""With those that only the stars of whole fields tell."""
DEFAULT_TERMS = (0, 1, 2, 3, 4, 5, 6, 9, 20, 27, 28, 29, 30)
"""What SDSS-V and DESI fit."""
SIMILARITY_TERMS = (0, 1, 2, 27)
_S_INDEX = (*range(2, 29), 37, *range(29, 37))
_T_INDEX = (4, 7, 8, 11, 12, 13, *range(16, 20), *range(22, 27), *range(29, 35))
_DEGREE = 8


def noll(j: int) -> tuple[int, int]:
    """(n, m) of Noll's index j >= 1; m > 0 for cosine terms, m < 0 for sine terms."""
    n = int((sqrt(8 * j - 7) - 1) / 2)
    k = j - n * (n + 1) // 2 - 1
    m = k + (k + n) % 2
    return n, m if j % 2 == 0 else -m


def zernike(j: int) -> Floats:
    """Z_j with unit rms on the disc, as dimensionless coefficients c[a, b] of x^a y^b."""
    n, m = noll(j)
    out = np.zeros((_DEGREE + 1, _DEGREE + 1))
    for k in range((n - abs(m)) // 2 + 1):
        radial = (-1) ** k * factorial(n - k) / (
            factorial(k)
            * factorial((n + abs(m)) // 2 - k)
            * factorial((n - abs(m)) // 2 - k)
        )  # fmt: skip
        out += radial * _times_angular(m, (n - abs(m)) // 2 - k)
    return out * sqrt(n + 1) * (sqrt(2) if m else 1)


def _times_angular(m: int, half_power: int) -> Floats:
    """r^(2 half_power) times Re or Im of (x + i y)^|m|."""
    out = np.zeros((_DEGREE + 1, _DEGREE + 1))
    for b in range(abs(m) + 1):
        phase = 1j**b
        part = phase.real if m >= 0 else phase.imag
        if part == 0:
            continue
        for c in range(half_power + 1):
            out[abs(m) - b + 2 * (half_power - c), b + 2 * c] += part * comb(abs(m), b) * comb(half_power, c)
    return out


def _scalar(j: int) -> Floats:
    """The scalar whose gradient is S_j."""
    n, m = noll(j)
    if n == abs(m):
        return zernike(j) / sqrt(2 * n * (n + 1))
    lower = next(k for k in range(1, j) if noll(k) == (n - 2, m))
    return (zernike(j) - sqrt((n + 1) / (n - 1)) * zernike(lower)) / sqrt(4 * n * (n + 1))


def _gradient(c: Floats) -> tuple[Floats, Floats]:
    dx, dy = np.zeros_like(c), np.zeros_like(c)
    powers = np.arange(1, _DEGREE + 1)
    dx[:-1] = c[1:] * powers[:, None]
    dy[:, :-1] = c[:, 1:] * powers
    return dx, dy


@cache
def _coefficients() -> Floats:
    """(57, 2, 9, 9): x^a y^b of both components of every term."""
    s = [_gradient(_scalar(j)) for j in _S_INDEX]
    t = [(dy, -dx) for dx, dy in (_gradient(_scalar(j)) for j in _T_INDEX)]
    return np.array([*s[:27], *t[:6], *s[27:], *t[6:]])


@cache
def _monomials(order: int) -> tuple[Ints, Ints, Floats]:
    """Powers of x, powers of y (both (p,)), and coefficients (57, 2 or 4, p) of fields (order 0) or
    of their derivatives (1: component, then axis)."""
    c = _coefficients()
    if order:
        c = np.array([[_gradient(part) for part in pair] for pair in c])
        c = c.reshape(len(c), 4, *c.shape[3:])
    a, b = np.nonzero((c != 0).any(axis=(0, 1)))
    return a, b, c[:, :, a, b]


def basis(xy: ArrayLike, terms: Sequence[int] = DEFAULT_TERMS) -> Floats:
    """(len(terms), n, 2) dimensionless: the vector fields at points (n, 2) of the unit disc."""
    chosen = _monomials(0)[2][list(terms)]
    values = _values(xy, 0, chosen.reshape(2 * len(chosen), -1))
    return np.moveaxis(values.reshape(len(values), len(chosen), 2), 0, 1)


def field(xy: ArrayLike, size_mm: Floats, terms: Sequence[int] = DEFAULT_TERMS) -> Floats:
    """(n, 2) mm: `size_mm` (len(terms),) of each of the terms together, at points `xy` (n, 2) of the unit
    disc, dimensionless.
    """
    return _values(xy, 0, _summed(size_mm, terms, 0))


def field_jacobian(xy: ArrayLike, size_mm: Floats, terms: Sequence[int] = DEFAULT_TERMS) -> Floats:
    """(n, 2, 2) mm, since the disc has no unit: d(component)/d(x, y) of what `field` gives; `xy`
    (n, 2) dimensionless, and `size_mm` (len(terms),).
    """
    flat = _values(xy, 1, _summed(size_mm, terms, 1))
    return flat.reshape(len(flat), 2, 2)


def _summed(size: Floats, terms: Sequence[int], order: int) -> Floats:
    """(p, m): m polynomials in one for each component, so that a point asks for no term by itself."""
    chosen = _monomials(order)[2][list(terms)]
    return np.tensordot(size, chosen, axes=1)


def _values(xy: ArrayLike, order: int, polynomials: Floats) -> Floats:
    """(n, p) of `polynomials` (p, m) in the monomials of this order, at points (n, 2)."""
    xy = np.asarray(xy, dtype=np.float64)
    a, b, _ = _monomials(order)
    x = np.vander(xy[:, 0], _DEGREE + 1, increasing=True)
    y = np.vander(xy[:, 1], _DEGREE + 1, increasing=True)
    values: Floats = (x[:, a] * y[:, b]) @ polynomials.T
    return values
