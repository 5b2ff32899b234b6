"""From pixels to the focal plane: a similarity, then Zhao-Burge terms fitted on fiducials.

    p_mm = s + sum_k c_k V_k(s / R),   s = similarity(p_px)

The similarity is found first and then held: terms 0, 1, 2 and 27 (shift, scale, rotation) are among
those fitted, so nothing is lost, and the fit is linear. R is the radius of the field: with it the
terms are orthonormal and the fit well conditioned. Every number comes with its covariance:

    C = s2 (A^T W A)^-1,   s2 = max(1, chi2 per degree of freedom)
    cov(p_mm) = J cov(p_px) J^T + B C B^T

and every fiducial with the residual that it would have had it been left out of the fit,
r_i / (1 - H_ii) with the 2 x 2 block H_ii of the hat matrix: one fit instead of as many as there
are fiducials. Whether a fiducial is believed goes by that residual, over what the others and its own
error let expect of it: at the rim, where few others tell the terms, several times the error alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom.errors import InputError
from fiberloom.metrology import zhao_burge
from fiberloom.timing import part
from fiberloom.typing import Array, Flags, Floats, Ints
from fiberloom.units import UM_PER_MM

_DOUBTED, _REFUSED = 4.5, 9.0
"""Robust standard deviations from which on a fiducial weighs less, and beyond which nothing. In between its
weight falls smoothly: one that is near a limit would be in one image and out of the next, and the fibres
around it would jump by what it pulls."""
_SETTLED = 1e-4
"""Change of a weight, a ratio, below which the fit is done."""
_TRUSTED_MM = 1e-3
"""No fiducial is doubted for less, where nothing is known of the errors."""
_ROUNDS = 20


@dataclass(frozen=True)
class Similarity:
    """z_mm = a z_px + b with z = x + i y; with `flipped` of the conjugate of z_px."""

    a: complex
    b: complex
    flipped: bool = False

    def to_mm(self, xy_px: ArrayLike) -> Floats:
        """Focal-plane positions (n, 2)."""
        z = _complex(xy_px)
        return _real(self.a * (z.conj() if self.flipped else z) + self.b)

    def to_px(self, xy_mm: ArrayLike) -> Floats:
        """Pixel positions (n, 2)."""
        z = (_complex(xy_mm) - self.b) / self.a
        return _real(z.conj() if self.flipped else z)

    @property
    def scale_mm_px(self) -> float:
        """Millimetres per pixel."""
        return abs(self.a)

    @property
    def rotation_deg(self) -> float:
        """Direction in the focal plane of the pixel x axis."""
        return float(np.rad2deg(np.angle(self.a)))

    @property
    def jacobian(self) -> Floats:
        """d(mm)/d(px), 2 x 2."""
        c, s = self.a.real, self.a.imag
        return np.array([[c, s], [s, -c]] if self.flipped else [[c, -s], [s, c]])


def fit_similarity(
    xy_px: ArrayLike, xy_mm: ArrayLike, *, flipped: bool = False, weight: ArrayLike | None = None
) -> Similarity:
    """Weighted least squares from `xy_px` (n, 2) to `xy_mm` (n, 2); needs two points.

    `flipped`: the image is mirrored; `weight` (n,): relative weights, not all 0; equal when None.
    """
    z, m = _complex(xy_px), _complex(xy_mm)
    if len(z) < 2:
        raise InputError(f"{len(z)} points: a similarity needs at least 2")
    z = z.conj() if flipped else z
    w = np.ones(len(z)) if weight is None else np.asarray(weight, dtype=np.float64)
    total = w.sum(dtype=np.complex128)  # complex, as np.average adds: the same bits
    if w.shape != z.shape or not total:
        raise InputError("a similarity needs a weight for each point, and not all 0")
    z0, m0 = (z * w).sum() / total, (m * w).sum() / total
    norm = float(np.sum(w * np.abs(z - z0) ** 2))
    if norm == 0:
        raise InputError("all points of the similarity are the same")
    a = complex(np.sum(w * (m - m0) * (z - z0).conj()) / norm)
    return Similarity(a, complex(m0 - a * z0), flipped)


@dataclass(frozen=True)
class FieldTransform:
    """Pixels to focal plane, with covariance."""

    similarity: Similarity
    radius_mm: float
    terms: tuple[int, ...]
    coefficients_mm: Floats
    covariance_mm2: Floats
    """(K, K) of the coefficients."""
    noise_mm2: Floats
    """(K, K) of them by the spots' noise alone, new in every image. The rest is the fiducials' table."""

    def to_mm(self, xy_px: ArrayLike) -> Floats:
        """Focal-plane positions (n, 2)."""
        s = self.similarity.to_mm(xy_px)
        mm: Floats = s + zhao_burge.field(s / self.radius_mm, self.coefficients_mm, self.terms)
        return mm

    def to_px(self, xy_mm: ArrayLike) -> Floats:
        """Pixel positions (n, 2), to 1e-7 px: the inverse, by Newton's method."""
        goal = np.asarray(xy_mm, dtype=np.float64)
        px = self.similarity.to_px(goal)
        for _ in range(12):
            step = np.linalg.solve(self.jacobian(px), (goal - self.to_mm(px))[..., None])[..., 0]
            px = px + step
            if np.abs(step).max(initial=0.0) < 1e-7:
                break
        return px

    def jacobian(self, xy_px: ArrayLike) -> Floats:
        """d(mm)/d(px), (n, 2, 2)."""
        s = self.similarity.to_mm(xy_px)
        bend_mm = zhao_burge.field_jacobian(s / self.radius_mm, self.coefficients_mm, self.terms)
        jacobian: Floats = (np.eye(2) + bend_mm / self.radius_mm) @ self.similarity.jacobian
        return jacobian

    @part("transform")
    def covariance(self, xy_px: ArrayLike, covariance_px2: ArrayLike | None = None) -> Floats:
        """(n, 2, 2) mm^2 of positions: of the spots, if given, and of the transform itself."""
        b = self.fields(xy_px)
        own = _spread_mm2(b, self.covariance_mm2)
        return own if covariance_px2 is None else own + self.of_spots(xy_px, covariance_px2)

    @part("transform")
    def noise(self, xy_px: ArrayLike, covariance_px2: ArrayLike) -> Floats:
        """(n, 2, 2) mm^2 by which positions differ from image to image; `covariance_px2`: of the spots."""
        b = self.fields(xy_px)
        return _spread_mm2(b, self.noise_mm2) + self.of_spots(xy_px, covariance_px2)

    def of_spots(self, xy_px: ArrayLike, covariance_px2: ArrayLike) -> Floats:
        """(n, 2, 2) mm^2 of positions by `covariance_px2` (n, 2, 2) of the spots alone."""
        j = self.jacobian(xy_px)
        spots: Floats = j @ np.asarray(covariance_px2) @ j.transpose(0, 2, 1)
        return spots

    def fields(self, xy_px: ArrayLike) -> Floats:
        """(K, n, 2) dimensionless: the terms at pixels (n, 2)."""
        return self._basis(self.similarity.to_mm(xy_px))

    def distortion_mm(self, xy_px: ArrayLike) -> Floats:
        """(n, 2): what the terms beyond shift, scale and rotation add."""
        s = self.similarity.to_mm(xy_px)
        keep = [k for k, t in enumerate(self.terms) if t not in zhao_burge.SIMILARITY_TERMS]
        terms = [self.terms[k] for k in keep]
        return zhao_burge.field(s / self.radius_mm, self.coefficients_mm[keep], terms)

    def significant(self, sigma: float) -> tuple[int, ...]:
        """The terms whose coefficient is at least `sigma` standard errors (a ratio) from zero."""
        size = np.abs(self.coefficients_mm) / np.sqrt(np.diag(self.covariance_mm2))
        return tuple(t for t, s in zip(self.terms, size, strict=True) if s > sigma)

    def _basis(self, s_mm: Floats) -> Floats:
        return zhao_burge.basis(s_mm / self.radius_mm, self.terms)


@dataclass(frozen=True)
class TransformFit:
    """A transform and how well the fiducials agree with it; rows are fiducials."""

    transform: FieldTransform
    residual_mm: Floats
    """(m, 2) known minus fitted."""
    leave_one_out_mm: Floats
    """(m, 2) the same had the fiducial been left out; equal to the residual where it was."""
    used: Flags
    chi2: float
    """Per degree of freedom."""

    @property
    def rms_um(self) -> float:
        """2-D rms of the residuals of the fiducials that were used."""
        return _rms_um(self.residual_mm[self.used])

    @property
    def leave_one_out_rms_um(self) -> float:
        """2-D rms of the leave-one-out residuals: what a point between fiducials must expect."""
        return _rms_um(self.leave_one_out_mm[self.used])


@dataclass(frozen=True)
class Distortion:
    """What of a distortion is fitted."""

    radius_mm: float
    """Of the field: it scales the terms."""
    terms: Sequence[int] = zhao_burge.DEFAULT_TERMS


@dataclass(frozen=True, eq=False)
class PlaceErrors:
    """What is known of the errors of spots and fiducials. Without any, all weigh the same."""

    covariance_px2: ArrayLike | None = None
    """(n, 2, 2) of the spots."""
    sigma_mm: ArrayLike = 0.0
    """Of the table of fiducials, per coordinate: one number or (m,)."""

    def of(self, spot: Ints, fiducial: Ints) -> PlaceErrors:
        """Of some spots and fiducials, by their rows."""
        covariance, sigma = self.covariance_px2, np.asarray(self.sigma_mm)
        return PlaceErrors(
            None if covariance is None else np.asarray(covariance)[spot],
            sigma if sigma.ndim == 0 else sigma[fiducial],
        )


def fit_transform(
    xy_px: ArrayLike,
    xy_mm: ArrayLike,
    distortion: Distortion,
    *,
    flipped: bool = False,
    errors: PlaceErrors | None = None,
    robust: bool = True,
) -> TransformFit:
    """Fits fiducials seen at `xy_px` (m, 2) and known to be at `xy_mm`.

    `distortion`: what of it is fitted; `flipped`: the image is mirrored; `errors` of both places. If
    `robust`, fiducials beyond 4.5 robust standard deviations weigh less, those beyond 9 nothing. Where there
    are fewer than four more than half the number of terms, fewer terms are fitted.
    """
    px, mm = (np.asarray(a, dtype=np.float64) for a in (xy_px, xy_mm))
    if px.shape != mm.shape or len(px) < 3:
        raise InputError(f"{len(px)} fiducials seen: a transform needs at least 3")
    terms, radius_mm = _affordable(tuple(distortion.terms), len(px)), distortion.radius_mm
    base = _robust_similarity(px, mm, flipped) if robust else fit_similarity(
        px, mm, flipped=flipped)  # fmt: skip
    variance, known = _variance(base, len(px), errors or PlaceErrors())
    start = base.to_mm(px)
    a = zhao_burge.basis(start / radius_mm, terms).transpose(1, 2, 0).reshape(2 * len(px), -1)
    r = (mm - start).ravel()
    weight = np.ones(len(px))
    for _ in range(_ROUNDS if robust else 1):
        c, loo, residual, normal, off = _solve(a, r, variance, weight)
        # the median of a 2-D Gaussian's length is 1.177 of its sigma per coordinate
        scale = float(np.median(off[weight > 0.5])) / 1.177
        again = _believed(off / max(scale, 1.0 if known else _TRUSTED_MM / _DOUBTED))
        if again.sum() < max(3, len(terms) // 2 + 2) or np.abs(again - weight).max() < _SETTLED:
            break
        weight = again
    freedom = 2 * float(weight.sum()) - len(terms)
    chi2 = float(np.sum(weight[:, None] * residual**2 / variance[:, None])) / max(freedom, 1.0)
    inflate = max(chi2, 1.0) if known else chi2
    inverse = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    spots, weighed = _spot_variance(base, errors or PlaceErrors()), weight / variance
    # where nothing is known of the spots, all may be new in every image
    noise = inverse * inflate if spots is None or not known else _by_spots(a, inverse, weighed, spots)
    transform = FieldTransform(base, radius_mm, terms, c, inverse * inflate, noise)
    return TransformFit(transform, residual, loo, weight > 0.5, chi2)


def _affordable(terms: tuple[int, ...], n: int) -> tuple[int, ...]:
    """As many terms as the fiducials carry: all, the default ones among them, or a similarity."""
    for some in (terms, tuple(t for t in terms if t in zhao_burge.DEFAULT_TERMS)):
        if 2 * n >= len(some) + 8:
            return some
    return zhao_burge.SIMILARITY_TERMS


def _believed(off: Floats) -> Floats:
    """Weights (m,) of fiducials that are off by so many robust standard deviations."""
    doubt = np.clip((off - _DOUBTED) / (_REFUSED - _DOUBTED), 0.0, 1.0)
    weight: Floats = 0.5 * (1.0 + np.cos(np.pi * doubt))
    return weight


def _solve(a: Floats, r: Floats, variance: Floats, weight: Floats) -> tuple[Array, ...]:
    """Coefficients, plain and leave-one-out residuals (m, 2), normal matrix, and (m,) the latter in sigmas.

    What the others and its own error let expect of a fiducial has the covariance v (1 + P / (1 - w P)), with
    P = A N^-1 A^T / v and its weight w: the square of its residual in sigmas is
    r^T (1 + (1 - w) P)^-1 r_loo / v.
    """
    w = np.repeat(weight / variance, 2)
    normal = a.T @ (a * w[:, None])
    c = np.linalg.solve(normal, a.T @ (w * r))
    residual = (r - a @ c).reshape(-1, 2)
    blocks = a.reshape(-1, 2, a.shape[1])
    lever = blocks @ np.linalg.solve(normal, blocks.transpose(0, 2, 1)) / variance[:, None, None]
    share = weight[:, None, None]
    loo = np.linalg.solve(np.eye(2) - share * lever, residual[..., None])[..., 0]
    plain = np.linalg.solve(np.eye(2) + (1.0 - share) * lever, residual[..., None])[..., 0]
    off = np.sqrt(np.maximum(np.einsum("mc,mc->m", plain, loo) / variance, 0.0))
    return c, loo, residual, normal, off


def _variance(base: Similarity, n: int, errors: PlaceErrors) -> tuple[Floats, bool]:
    """Variance per coordinate of each fiducial, and whether anything is known about it."""
    variance = np.broadcast_to(np.square(np.asarray(errors.sigma_mm, dtype=np.float64)), (n,)).copy()
    spots = _spot_variance(base, errors)
    if spots is not None:
        variance += spots
    if not (variance > 0).all():
        return np.ones(n), False
    return variance, True


def _spot_variance(base: Similarity, errors: PlaceErrors) -> Floats | None:
    """(m,) mm^2 per coordinate by the noise of the spots; None where nothing is known of it."""
    if errors.covariance_px2 is None:
        return None
    trace: Floats = np.trace(np.asarray(errors.covariance_px2), axis1=1, axis2=2)
    return 0.5 * trace * base.scale_mm_px**2


def _by_spots(a: Floats, inverse: Floats, weight: Floats, spots_mm2: Floats) -> Floats:
    """(K, K) mm^2 of the coefficients, by the noise of the spots and not by where the table has them."""
    gain = inverse @ (a * np.repeat(weight, 2)[:, None]).T
    noise: Floats = (gain * np.repeat(spots_mm2, 2)) @ gain.T
    return noise


def _robust_similarity(px: Floats, mm: Floats, flipped: bool) -> Similarity:
    """Least squares, again and again with weights that fall with the residual."""
    weight = np.ones(len(px))
    for _ in range(10):
        base = fit_similarity(px, mm, flipped=flipped, weight=weight)
        off = np.hypot(*(mm - base.to_mm(px)).T)
        weight = 1.0 / np.maximum(off, np.median(off) + 1e-12)
    return base


def _spread_mm2(fields: Floats, covariance_mm2: Floats) -> Floats:
    """(n, 2, 2) covariance of what `fields` (K, n, 2) make of coefficients with that of (K, K)."""
    rows = fields.transpose(1, 2, 0)
    spread: Floats = (rows @ covariance_mm2) @ rows.transpose(0, 2, 1)
    return spread


def _rms_um(residual_mm: Floats) -> float:
    return UM_PER_MM * float(np.sqrt(np.mean(np.sum(residual_mm**2, axis=1))))


def _complex(xy: ArrayLike) -> NDArray[np.complex128]:
    xy = np.asarray(xy, dtype=np.float64)
    return xy[:, 0] + 1j * xy[:, 1]


def _real(z: NDArray[np.complex128]) -> Floats:
    return np.column_stack([z.real, z.imag])
