"""In-focal-plane calibration: centre, arms and zeros of every positioner. Kronig 2020, Eq. 26.

Least squares over configurations, all positioners at once, each with its own unknowns:

    z = centre + l_alpha exp(i a) + l_beta exp(i (a + beta + beta_off + phi)),  a = alpha + alpha_off

with phi the angle of the metrology fibre in the frame of the beta arm, and l_beta its distance from the
beta axis. Eq. 26 weighs all measurements alike; here each has its covariance: the camera's, and that
of the angles, which are only known as well as the transmission maps. An angle moves the fibre across
its lever and never along it, so the folded and the stretched arm tell lengths and centre almost
whatever the maps are wrong by. How large the angles' errors are the residuals themselves tell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.instruments.arms import ALPHA_OFF, BETA_OFF, CENTRE, L_ALPHA
from fiberloom.metrology.noise import WORKSPACE_UM
from fiberloom.timing import part
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import MM_PER_UM, deg_to_rad

PARAMETERS = (
    "centre_x_mm",
    "centre_y_mm",
    "l_alpha_mm",
    "l_beta_mm",
    "alpha_off_rad",
    "beta_off_rad",
)
N_GEOMETRY = len(PARAMETERS)
_CX, _CY, _LA, _LB, _A0, _B0 = range(N_GEOMETRY)

_STEPS = 8
_ROUNDS = 4
_OUTLIER = 25.0
"""Squared residual over its variance: 1 in 270 000 of two Gaussian numbers."""
_DOWNWEIGHT = 9.0
"""Cauchy's weight is a half at this squared residual, as long as outliers are not known yet."""
_LEAST_SIGMA_DEG = 2e-4
_RANK_TOLERANCE = 1e-5
_MOST_OUTLIERS = 0.3
_POOL = 400
"""Measurements from which the angles' errors can be told; with fewer the given ones are kept."""


@dataclass(frozen=True)
class FitSettings:
    """What is known of the measurements. 2-D rms in um, sigmas in deg."""

    camera_um: float = WORKSPACE_UM
    angles_deg: tuple[float, float] = (0.023, 0.014)
    """Errors of alpha and beta: what maps of 200 points leave (docs/calibration.md)."""
    fit_angles: bool = True
    """Find them from the residuals, where there are enough."""
    harmonics: int = 0
    """Orders of the transmission, per axis, to be fitted too: 1 to this many cycles a turn."""


@dataclass(frozen=True)
class FocalPlaneFit:
    """The result, row by row; lengths in mm, angles in rad."""

    positioner_id: Ints
    parameters: Floats
    """(N, P): PARAMETERS, then cos and sin of each order for alpha, then for beta. A positioner with
    a reason keeps the layout's."""
    covariance: Floats
    """(N, P, P); NaN for a positioner with a reason."""
    rank: Ints
    """(N,) how many of the P the measurements determine."""
    reason: list[str]
    """Why a positioner could not be calibrated; empty where it could."""
    used: Flags
    """(N, S) measurements that count: seen, and no outliers."""
    n_outliers: Ints
    rms_um: Floats
    """(N,) 2-D rms of the residuals of those."""
    chi2_dof: Floats
    angles_deg: tuple[float, float]
    """Errors of the angles that the weights assume."""

    @property
    def ok(self) -> Flags:
        """(N,) True where calibrated."""
        return np.array([not reason for reason in self.reason])

    @property
    def sigma(self) -> Floats:
        """(N, P) standard errors."""
        errors: Floats = np.sqrt(np.einsum("nii->ni", self.covariance))
        return errors

    def plane(self, layout: FocalPlane) -> FocalPlane:
        """The layout with what was calibrated in place of what was assumed."""
        arms, points = layout.arms.copy(), {k: v.copy() for k, v in layout.points.items()}
        good, p = self.ok, self.parameters
        arms[good, CENTRE] = p[good, _CX : _CY + 1]
        arms[good, L_ALPHA] = p[good, _LA]
        arms[good, ALPHA_OFF], arms[good, BETA_OFF] = p[good, _A0], p[good, _B0]
        longer = (p[:, _LB] - layout.l_beta_mm)[good, None]
        unit = points[METROLOGY][good] / layout.l_beta_mm[good, None]
        # all fibres sit in one head: what the arm is longer by moves them all
        points = {k: _moved(xy, good, longer * unit) for k, xy in points.items()}
        return replace(layout, arms=arms, points=points)

    @property
    def arms_covariance_mm2(self) -> Floats:
        """(N, 4, 4) of centre x, y, l_alpha, l_beta, as `AdaptiveCalibration` takes it."""
        return self.covariance[:, : _LB + 1, : _LB + 1]


def _moved(xy: Floats, rows: Flags, by: Floats) -> Floats:
    out = xy.copy()
    out[rows] += by
    return out


def layout_parameters(plane: FocalPlane, harmonics: int = 0) -> Floats:
    """(N, P) as the layout has them, in mm and rad."""
    p = np.zeros((plane.n, N_GEOMETRY + 4 * harmonics))
    p[:, _CX : _CY + 1] = plane.centres_mm
    p[:, _LA], p[:, _LB] = plane.l_alpha_mm, plane.l_beta_mm
    p[:, _A0], p[:, _B0] = plane.alpha_off_rad, plane.beta_off_rad
    return p


def model(p: Floats, theta_deg: Floats, phi: Floats, slopes: bool = True) -> tuple[Floats, Floats]:
    """Fibres (N, S, 2) in mm and, with `slopes`, their derivatives (N, S, 2, P).

    `p` (N, P): parameters in mm and rad; `theta_deg` (N, S, 2): angles; `phi` (N,): direction of the
    metrology fibre in the frame of its arm, rad.
    """
    harmonics = (p.shape[1] - N_GEOMETRY) // 4
    waves = _waves(theta_deg, harmonics)
    alpha, beta = np.moveaxis(deg_to_rad(theta_deg), -1, 0)
    for k in range(2 * harmonics):
        alpha = alpha + p[:, N_GEOMETRY + k, None] * waves[0][..., k]
        beta = beta + p[:, N_GEOMETRY + 2 * harmonics + k, None] * waves[1][..., k]
    first = np.exp(1j * (alpha + p[:, _A0, None]))
    second = first * np.exp(1j * (beta + (p[:, _B0] + phi)[:, None]))
    both = p[:, _LA, None] * first + p[:, _LB, None] * second
    z = (p[:, _CX] + 1j * p[:, _CY])[:, None] + both
    xy = np.stack([z.real, z.imag], axis=-1)
    if not slopes:
        return xy, np.empty(0)
    ones = np.ones_like(z)
    swing = [1j * both, 1j * p[:, _LB, None] * second]
    columns = [ones, 1j * ones, first, second, *swing]
    columns += [waves[axis][..., k] * swing[axis] for axis in range(2) for k in range(2 * harmonics)]
    slope = np.stack(columns, axis=-1)
    return xy, np.stack([slope.real, slope.imag], axis=2)


def _waves(theta_deg: Floats, harmonics: int) -> list[Floats]:
    """Per axis (N, S, 2 H): cosines, then sines."""
    orders = np.arange(1, harmonics + 1)
    turn = deg_to_rad(theta_deg)[..., None] * orders  # (N, S, 2, H)
    both = np.concatenate([np.cos(turn), np.sin(turn)], axis=-1)
    return [both[:, :, axis] for axis in range(2)]


def measurement_covariance(slopes: Floats, camera_um: float, angles_deg: tuple[float, float]) -> Floats:
    """(N, S, 2, 2) mm^2 of the camera and both angles, from the derivatives (N, S, 2, P)."""
    swing = slopes[..., _A0 : _B0 + 1] * deg_to_rad(angles_deg)
    camera = 0.5 * (camera_um * MM_PER_UM) ** 2 * np.eye(2)
    return camera + swing @ swing.swapaxes(-1, -2)


@part("fit")
def fit_focal_plane(
    plane: FocalPlane, theta_deg: Floats, xy_mm: Floats, settings: FitSettings | None = None
) -> FocalPlaneFit:
    """Eq. 26: centres, arms and zeros of all positioners from configurations S.

    `theta_deg` (N, S, 2): angles by the maps; `xy_mm` (N, S, 2): measured places, NaN where not seen;
    `settings`: camera noise and what is fitted. The layout `plane` is the first guess (within some 0.2
    mm and 1 deg) and defines the place of the metrology fibre on its arm. Positioners that were hardly
    seen, or whose spots fit no arms, keep the layout's values.
    """
    settings = settings or FitSettings(camera_um=plane.instrument.metrology.noise_rms_um)
    fit = _Fit(plane, theta_deg, xy_mm, settings)
    for _ in range(_ROUNDS):
        fit.iterate(robust=True)
        fit.cut_outliers()
        fit.iterate(robust=False)
        fit.cut_outliers()
        fit.find_angle_errors()
    fit.iterate(robust=False)
    return fit.result()


class _Fit:
    """State of the iteration."""

    def __init__(self, plane: FocalPlane, theta_deg: Floats, xy_mm: Floats, settings: FitSettings) -> None:
        self.plane, self.settings, self.angles_deg = plane, settings, settings.angles_deg
        self.seen = np.asarray(np.isfinite(xy_mm + theta_deg).all(axis=-1), dtype=np.bool_)
        self.theta, self.xy = np.nan_to_num(theta_deg), np.nan_to_num(xy_mm)
        self.phi = plane.metrology_phi_rad
        self.p = layout_parameters(plane, settings.harmonics)
        self.used: Flags = self.seen.copy()
        # a column of unit size for each parameter, so that the rank is one of numbers alike
        self.scale = np.where(np.arange(self.p.shape[1]) < _A0, 1.0, 0.1)

    def whitened(self) -> tuple[Floats, Floats, Floats]:
        """Residuals (N, S, 2) and derivatives (N, S, 2, P) in sigmas, and residuals in mm."""
        expected, slopes = model(self.p, self.theta, self.phi)
        covariance = measurement_covariance(slopes, self.settings.camera_um, self.angles_deg)
        root = np.linalg.cholesky(covariance)
        left = self.xy - expected
        both = np.concatenate([left[..., None], slopes * self.scale], axis=-1)
        white = np.linalg.solve(root, both)
        return white[..., 0], white[..., 1:], left

    def iterate(self, robust: bool) -> None:
        for _ in range(_STEPS):
            residual, design, _ = self.whitened()
            weight = self.used.astype(float)
            if robust:
                weight = self.seen / (1.0 + (residual**2).sum(axis=-1) / _DOWNWEIGHT)
            normal = np.einsum("nscp,nscq,ns->npq", design, design, weight, optimize=True)
            right = np.einsum("nscp,nsc,ns->np", design, residual, weight, optimize=True)
            inverse = np.linalg.pinv(normal, rcond=_RANK_TOLERANCE**2, hermitian=True)
            step = (inverse @ right[..., None])[..., 0] * self.scale
            self.p += step
            if np.abs(step).max() < 1e-10:
                break

    def cut_outliers(self) -> None:
        square = (self.whitened()[0] ** 2).sum(axis=-1)
        self.used = self.seen & (square < _OUTLIER)

    def find_angle_errors(self) -> None:
        """Moments of the residuals, pooled over all positioners, against camera and both levers.

        E[r r^T] = camera + sigma_alpha^2 a a^T + sigma_beta^2 b b^T, by weighted least squares.
        """
        if not self.settings.fit_angles or self.used.sum() < _POOL:
            return
        _, slopes = model(self.p, self.theta, self.phi)
        left = self.xy - model(self.p, self.theta, self.phi, slopes=False)[0]
        count = self.used.sum(axis=1)
        freedom = np.maximum(2 * count - self.p.shape[1], 1) / np.maximum(2 * count, 1)
        levers = slopes[..., _A0 : _B0 + 1]  # (N, S, 2, 2 axes)
        unit = levers / np.linalg.norm(levers, axis=2, keepdims=True)
        camera = 0.5 * (self.settings.camera_um * MM_PER_UM) ** 2
        # two numbers of each residual: along both levers; their variances are linear in the sigmas
        along = np.einsum("nsca,nsc->nsa", unit, left) ** 2 / freedom[:, None, None] - camera
        felt = np.einsum("nsca,nscb->nsab", unit, levers) ** 2
        sizes = np.square(deg_to_rad(self.angles_deg))
        weight = 1.0 / (camera + np.einsum("nsab,b->nsa", felt, sizes)) ** 2 * self.used[..., None]
        normal = np.einsum("nsab,nsac,nsa->bc", felt, felt, weight, optimize=True)
        right = np.einsum("nsab,nsa,nsa->b", felt, along, weight, optimize=True)
        found = np.sqrt(np.maximum(np.linalg.solve(normal, right), 0.0))
        alpha, beta = np.maximum(np.rad2deg(found), _LEAST_SIGMA_DEG)
        self.angles_deg = (float(alpha), float(beta))

    def result(self) -> FocalPlaneFit:
        residual, design, left = self.whitened()
        design = design * self.used[..., None, None]
        n, s, _, size = design.shape
        _, singular, vh = np.linalg.svd(design.reshape(n, 2 * s, size), full_matrices=False)
        known = singular > _RANK_TOLERANCE * np.maximum(singular[:, :1], 1e-300)
        rank = known.sum(axis=1)
        inverse = np.where(known, 1.0 / np.where(known, singular, 1.0) ** 2, 0.0)
        covariance = np.einsum("nkp,nk,nkq->npq", vh, inverse, vh) * np.outer(self.scale, self.scale)
        count = self.used.sum(axis=1)
        dof = np.maximum(2 * count - rank, 1)
        chi2 = ((residual**2).sum(axis=-1) * self.used).sum(axis=1) / dof
        # a gear worse than all others shows; scatter of the sum itself does not count
        worse = chi2 > 1.0 + 4.0 * np.sqrt(2.0 / dof)
        covariance *= np.where(worse, chi2, 1.0)[:, None, None]
        square = ((left**2).sum(axis=-1) * self.used).sum(axis=1)
        reason = self._reasons(rank, count)
        bad = np.array([bool(r) for r in reason])
        self.p[bad] = layout_parameters(self.plane, self.settings.harmonics)[bad]
        covariance[bad] = np.nan
        return FocalPlaneFit(
            positioner_id=self.plane.positioner_id,
            parameters=self.p,
            covariance=covariance,
            rank=rank,
            reason=reason,
            used=self.used,
            n_outliers=(self.seen & ~self.used).sum(axis=1),
            rms_um=np.sqrt(square / np.maximum(count, 1)) / MM_PER_UM,
            chi2_dof=chi2,
            angles_deg=self.angles_deg,
        )

    def _reasons(self, rank: Ints, count: Ints) -> list[str]:
        n_seen, total = self.seen.sum(axis=1), self.seen.shape[1]
        size = self.p.shape[1]
        out = []
        for row in range(len(rank)):
            cut = n_seen[row] - count[row]
            if 2 * n_seen[row] < size + 2:
                out.append(f"seen in {n_seen[row]} of {total} configurations, {size // 2 + 1} needed")
            elif cut > _MOST_OUTLIERS * n_seen[row]:
                out.append(f"{cut} of {n_seen[row]} positions fit no arms of this layout")
            elif rank[row] < size:
                out.append(f"its configurations determine {rank[row]} of {size} parameters")
            else:
                out.append("")
        return out
