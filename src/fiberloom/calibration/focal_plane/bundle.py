"""Fiducials where they really are: one fit of camera, fiducials and arms to the images of a survey.

Every image is the same lens on the same fiducials; what differs is how it is turned, and where the arms are.
A spot at u (mm in the frame of the camera, by its nominal scale) comes from the place

    F_i(u) = (u + sum_k c_k V_k(u / R) - b_i) / a_i

with the distortion c of all images, and shift b_i, turn and scale a_i of image i (complex numbers). It is
that of a fiducial, unknown but for its table, or that of an arm: centre, lengths and zeros as in Eq. 26
(Kronig 2020), angles as well as the maps tell them. All are unknown at once; least squares, with fiducials
and arms taken out of the normal equations (Schur).

What tells lens from fiducials: a turned camera sees the same fiducials by another part of the lens. Terms
that are the same after any turn (the radial ones, and a twist of them) it does not tell; arms do, which keep
their lengths: what the frame shears shows as a circle that is none. What nothing tells, by how the whole
field is shifted, turned and scaled, stays as the table of the fiducials has it; the telescope's guider takes
it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.calibration.focal_plane.fiducials import Fiducials
from fiberloom.calibration.focal_plane.fit import (
    N_GEOMETRY,
    FocalPlaneFit,
    layout_parameters,
    measurement_covariance,
    model,
)
from fiberloom.calibration.focal_plane.survey_data import Looks
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import zhao_burge
from fiberloom.metrology.transform import fit_similarity
from fiberloom.typing import Flags, Floats
from fiberloom.units import MM_PER_UM, UM_PER_MM

TERMS = tuple(t for t in range(zhao_burge.N_TERMS) if t not in zhao_burge.SIMILARITY_TERMS)
POSE = 4
"""Unknowns of an image: scale, turn, shift."""
SPOT_UM = 1.0
"""Least error of a spot per coordinate: what air and pixels do to it."""
_STEPS, _ROUNDS = 10, 4
_SETTLED_MM = 1e-7
_OUTLIER = 25.0
"""Squared residual over its variance, beyond which a spot is not that of its fiducial or arm."""
_FEWEST_IMAGES = 4
_FEWEST_FIDUCIALS = 8
_ARM_MM = 0.2
"""How far arms are at most from where the fit before has them: what is not told does not run away."""


def calibrate_fiducials(
    plane: FocalPlane, fit: FocalPlaneFit, theta_deg: Floats, looks: Looks, table_um: float
) -> tuple[Fiducials, Floats]:
    """Fiducials from the images of a survey, and the fibres in the frame that they make.

    Parameters
    ----------
    plane : FocalPlane
        The layout, N positioners and F fiducials, by their table.
    fit : FocalPlaneFit
        Of the arms, with the frame of the table.
    theta_deg : (N, S, 2) float
        Angles of the configurations, by the maps, deg.
    looks : Looks
        Spots in the images.
    table_um : float
        Standard error of the table, per coordinate.

    Returns
    -------
    Fiducials
        In the gauge of the table: the same mean place, turn and scale.
    (N, S, 2) float
        Metrology fibres in mm, means over the images of each configuration; NaN where not seen.

    Raises
    ------
    InputError
        Too few images or fiducials.
    """
    if looks.n_images < _FEWEST_IMAGES:
        raise InputError(f"{looks.n_images} images of the survey show fiducials, {_FEWEST_IMAGES} are needed")
    if len(plane.fiducials) < _FEWEST_FIDUCIALS:
        raise InputError(f"{len(plane.fiducials)} fiducials, {_FEWEST_FIDUCIALS} are needed")
    bundle = _Bundle(plane, fit, theta_deg, looks, table_um)
    for _ in range(_ROUNDS):
        bundle.settle()
        bundle.judge()
    bundle.settle()
    return bundle.fiducials(), bundle.fibres_mm(theta_deg.shape[1])


class _Bundle:
    """State of the iteration. Axes: i image, k spot, c coordinate."""

    def __init__(
        self, plane: FocalPlane, fit: FocalPlaneFit, theta_deg: Floats, looks: Looks, table_um: float
    ) -> None:
        self.table_mm, self.looks = plane.fiducials[:, :2], looks
        self.table_sigma_mm, self.spot_mm = table_um * MM_PER_UM, SPOT_UM * MM_PER_UM
        self.angles_deg = fit.angles_deg
        if not np.isfinite(self.angles_deg).all():
            raise InputError("the errors of the angles are not known")
        good = fit.ok & np.isfinite(theta_deg).all(axis=(1, 2))
        self.rows = np.flatnonzero(good)
        if not len(self.rows):
            raise InputError("the arms of no positioner could be calibrated: fiducials need them")
        self.phi = plane.metrology_phi_rad[self.rows]
        self.theta = theta_deg[self.rows][:, looks.configuration]  # (n, I, 2)
        self.arms = np.where(good[:, None], fit.parameters, layout_parameters(plane))[self.rows, :N_GEOMETRY]
        self.start = self.arms.copy()
        self.at_mm = self.table_mm.copy()
        self.u_fiducial = looks.fiducial_mm @ _COMPLEX  # (I, F)
        self.u_fibre = looks.fibre_mm[:, self.rows] @ _COMPLEX  # (I, n)
        self.used_fiducial: Flags = np.isfinite(self.u_fiducial)
        self.used_fibre: Flags = np.isfinite(self.u_fibre) & fit.used[self.rows][:, looks.configuration].T
        self.radius_mm = float(np.nanmax(np.abs(self.u_fiducial)))
        self.basis_fiducial = _basis(self.u_fiducial, self.radius_mm)
        self.basis_fibre = _basis(self.u_fibre, self.radius_mm)
        self.c = np.zeros(len(TERMS))
        self.a, self.b = self._poses()
        self.wide = np.empty((0, 0))
        self.of_fiducial: _Own

    def _poses(self) -> tuple[Floats, Floats]:
        """Of each image by its fiducials alone: u = a z + b."""
        a, b = np.empty(self.looks.n_images, complex), np.empty(self.looks.n_images, complex)
        for i, used in enumerate(self.used_fiducial):
            u = self.u_fiducial[i, used]
            found = fit_similarity(np.column_stack([u.real, u.imag]), self.table_mm[used])
            a[i], b[i] = 1.0 / found.a, -found.b / found.a
        return a, b

    def places(self) -> tuple[Floats, Floats]:
        """Of fiducials (I, F) and fibres (I, n) in the focal plane, complex, mm."""
        out = []
        for u, basis in ((self.u_fiducial, self.basis_fiducial), (self.u_fibre, self.basis_fibre)):
            bent = u + np.tensordot(self.c, basis, 1)
            out.append((bent - self.b[:, None]) / self.a[:, None])
        return out[0], out[1]

    def settle(self) -> None:
        for _ in range(_STEPS):
            if self._step() < _SETTLED_MM:
                return

    def _step(self) -> float:
        """One step of Gauss and Newton; the largest change of a fiducial, mm."""
        place_fiducial, place_fibre = self.places()
        common = _Normal(len(self.c) + POSE * self.looks.n_images)
        felt = self._felt(place_fiducial, self.basis_fiducial)
        scale = self.used_fiducial[..., None] / self.spot_mm
        left = _xy(place_fiducial) - self.at_mm
        own = np.broadcast_to(-np.eye(2), (*place_fiducial.shape, 2, 2))
        prior = np.broadcast_to(np.eye(2) / self.table_sigma_mm**2, (len(self.at_mm), 2, 2))
        of_fiducial = common.add(
            _Rows(scale[..., None] * felt, scale[..., None] * own, scale * left),
            prior,
            (self.at_mm - self.table_mm) / self.table_sigma_mm**2,
        )
        expected, slopes = model(self.arms, self.theta, self.phi)
        white = np.linalg.inv(
            np.linalg.cholesky(
                measurement_covariance(slopes, np.sqrt(2.0) * self.spot_mm * UM_PER_MM, self.angles_deg)
            )
        )
        white = white.swapaxes(0, 1) * self.used_fibre[..., None, None]  # (I, n, 2, 2)
        left = _xy(place_fibre) - expected.swapaxes(0, 1)
        held = np.diag(np.array([1.0, 1.0, 1.0, 1.0, _ARM_MM, _ARM_MM]) ** 2) / _ARM_MM**2
        of_arm = common.add(
            _Rows(
                white @ self._felt(place_fibre, self.basis_fibre),
                -white @ slopes.swapaxes(0, 1),
                np.einsum("ikcd,ikd->ikc", white, left),
            ),
            np.broadcast_to(held, (len(self.rows), N_GEOMETRY, N_GEOMETRY)),
            (self.arms - self.start) @ held,
        )
        self.wide = np.asarray(np.linalg.inv(common.matrix), dtype=np.float64)
        step = -self.wide @ common.right
        self._take(step)
        moved = of_fiducial.step(step)
        self.at_mm = self.at_mm + moved
        self.arms += of_arm.step(step)
        self.of_fiducial = of_fiducial
        return float(np.abs(moved).max())

    def _felt(self, place: Floats, basis: Floats) -> Floats:
        """(I, k, 2, G) derivatives of places by lens and poses, mm per unit."""
        n_i, n_k = place.shape
        felt = np.zeros((n_i, n_k, 2, len(self.c) + POSE * n_i))
        felt[..., : len(self.c)] = _xy((basis / self.a[:, None]).transpose(1, 2, 0)).swapaxes(-1, -2)
        for i in range(n_i):
            by = np.stack(
                [-place[i], -1j * place[i], *(np.full(n_k, s / self.a[i]) for s in (-1.0, -1j))], axis=-1
            )
            o = len(self.c) + POSE * i
            felt[i, :, :, o : o + POSE] = _xy(by).swapaxes(-1, -2)
        return np.nan_to_num(felt)

    def _take(self, step: Floats) -> None:
        self.c = self.c + step[: len(self.c)]
        grow, turn, *shift = step[len(self.c) :].reshape(-1, POSE).T
        self.a, self.b = self.a * (1.0 + grow + 1j * turn), self.b + shift[0] + 1j * shift[1]

    def judge(self) -> None:
        """How noisy spots are, by the fiducials themselves; then spots that are another light's go out."""
        fiducial, fibre = self.places()
        # against the median image: one wrong light must not take its fiducial with it
        shown = np.isfinite(fiducial).any(axis=0)
        middle = np.nanmedian(_xy(np.where(shown, fiducial, 0.0)), axis=0) @ _COMPLEX
        off = np.abs(fiducial - middle)
        # the median of a 2-D Gaussian's length is 1.177 of its sigma per coordinate
        self.spot_mm = max(float(np.median(off[self.used_fiducial])) / 1.177, 0.1 * MM_PER_UM)
        self.used_fiducial = np.isfinite(off) & (np.nan_to_num(off) ** 2 < _OUTLIER * 2.0 * self.spot_mm**2)
        expected, slopes = model(self.arms, self.theta, self.phi)
        wide = measurement_covariance(slopes, np.sqrt(2.0) * self.spot_mm * UM_PER_MM, self.angles_deg)
        left = np.nan_to_num(_xy(fibre).swapaxes(0, 1) - expected)
        square = np.einsum("nic,nic->ni", left, np.linalg.solve(wide, left[..., None])[..., 0])
        self.used_fibre = np.isfinite(fibre) & (square.T < _OUTLIER)

    def fiducials(self) -> Fiducials:
        covariance = self.of_fiducial.covariance(self.wide)
        free = _without_similarity(self.table_mm)
        formal = free @ covariance @ free.T
        sigma_mm = np.sqrt(np.maximum(np.diag(formal), 0.0).reshape(-1, 2).mean(axis=1))
        apart = (self.at_mm - self.table_mm).ravel()
        kept = (free @ apart).reshape(-1, 2)
        turned = np.rad2deg(np.unwrap(np.angle(self.a[np.argsort(self.looks.configuration, kind="stable")])))
        return Fiducials(
            self.table_mm,
            self.table_mm + kept,
            sigma_mm * UM_PER_MM,
            self.spot_mm * UM_PER_MM,
            self.looks.n_images,
            float(np.ptp(turned)),
        )

    def fibres_mm(self, configurations: int) -> Floats:
        """(N, S, 2) in the gauge of the table."""
        _, fibre = self.places()
        shift = fit_similarity(self.at_mm, self.fiducials().xy_mm)
        out = np.full((self.looks.fibre_mm.shape[1], configurations, 2), np.nan)
        xy_mm = shift.to_mm(_xy(fibre).reshape(-1, 2)).reshape(*fibre.shape, 2)
        for s in range(configurations):
            images = xy_mm[self.looks.configuration == s]
            seen = np.isfinite(images[..., 0]).sum(axis=0)
            mean = np.nansum(images, axis=0) / np.maximum(seen, 1)[:, None]
            out[self.rows, s] = np.where(seen[:, None] > 0, mean, np.nan)
        return out


@dataclass(frozen=True)
class _Rows:
    """Whitened equations of spots: by what is common (I, k, 2, G), by the own unknowns (I, k, 2, P)."""

    common: Floats
    own: Floats
    left: Floats
    """(I, k, 2): residuals, place less expected."""


class _Normal:
    """Normal equations of what is common to all spots."""

    def __init__(self, size: int) -> None:
        self.matrix, self.right = np.zeros((size, size)), np.zeros(size)

    def add(self, rows: _Rows, prior: Floats, pulled: Floats) -> _Own:
        """Takes the unknowns of each k (their `prior` (k, P, P), and `pulled` (k, P) by it) out of them."""
        left = np.nan_to_num(rows.left)
        n_k, size, own_size = rows.common.shape[1], rows.common.shape[-1], rows.own.shape[-1]
        # one matrix product over all spots of each k
        common = rows.common.swapaxes(0, 1).reshape(n_k, -1, size)
        own = rows.own.swapaxes(0, 1).reshape(n_k, -1, own_size)
        flat = left.swapaxes(0, 1).reshape(n_k, -1)
        inverse = np.asarray(np.linalg.inv(own.swapaxes(1, 2) @ own + prior), dtype=np.float64)
        shared = own.swapaxes(1, 2) @ common
        pull = np.einsum("krp,kr->kp", own, flat) + pulled
        both = common.reshape(-1, size)
        self.matrix += both.T @ both - np.einsum("kpg,kph->gh", shared, inverse @ shared, optimize=True)
        self.right += both.T @ flat.ravel() - np.einsum("kpg,kpq,kq->g", shared, inverse, pull, optimize=True)
        return _Own(inverse, shared, pull)


@dataclass(frozen=True)
class _Own:
    """What the unknowns (k, P) of fiducials or arms are, once the common ones are known."""

    inverse: Floats
    shared: Floats
    pull: Floats

    def step(self, common: Floats) -> Floats:
        moved: Floats = -np.einsum("kpq,kq->kp", self.inverse, self.pull + self.shared @ common)
        return moved

    def covariance(self, wide: Floats) -> Floats:
        """(k P, k P) of all of them, `wide` being that of what is common."""
        n, size = self.pull.shape
        lever = (self.inverse @ self.shared).reshape(n * size, -1)
        total = lever @ wide @ lever.T
        for k in range(n):
            total[k * size : (k + 1) * size, k * size : (k + 1) * size] += self.inverse[k]
        return np.asarray(total)


_COMPLEX = np.array([1.0, 1.0j])


def _xy(z: Floats) -> Floats:
    """(..., 2)"""
    return np.stack([z.real, z.imag], axis=-1)


def _basis(u: Floats, radius_mm: float) -> Floats:
    """(30, I, k) complex terms at places (I, k) of the camera's frame; NaN where there is no spot."""
    flat = _xy(np.where(np.isfinite(u), u, 0.0)).reshape(-1, 2) / radius_mm
    terms = zhao_burge.basis(flat, TERMS) @ _COMPLEX
    return np.where(np.isfinite(u), terms.reshape(len(TERMS), *u.shape), np.nan)


def _without_similarity(xy_mm: Floats) -> Floats:
    """(2 F, 2 F) projector that takes shift, turn and scale off displacements of places (F, 2)."""
    x, y = ((xy_mm - xy_mm.mean(axis=0)) / np.hypot(*xy_mm.T).max()).T
    one, none = np.ones(len(x)), np.zeros(len(x))
    patterns = np.stack(
        [np.column_stack(p).ravel() for p in ((one, none), (none, one), (x, y), (-y, x))], axis=-1
    )
    q, _ = np.linalg.qr(patterns)
    free: Floats = np.eye(len(patterns)) - q @ q.T
    return free
