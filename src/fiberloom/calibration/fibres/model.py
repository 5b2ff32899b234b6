"""Fluxes of a dithered field as its unknowns give them, and one step of least squares.

    flux_en = exp(a_n + t_e) T(|s_en|; fwhm_e)
    s_en    = star_n - fibre_n + dither_e + guide_e + turn_e J x_n + scale_e x_n - v_n

Unknown per star n: its flux a_n (logarithm) and v_n, the fibre's offset in the focal plane, um. Unknown per
exposure e: transparency t_e and FWHM (logarithms), and how the guider was off: shift, rotation, scale, the
last two in um at the rms radius of the field (x_n is the place in the field in that unit, J turns by 90 deg).

Of these the mean shift, rotation and scale over all exposures cannot be told from a pattern of offsets
that all fibres share, nor the mean transparency from the stars' fluxes: they are held at 0 here, and
`estimate` then says what of the offsets is left open.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fiberloom.calibration.fibres.dithered import CORE_UM, DitheredField
from fiberloom.calibration.fibres.guider import places_of
from fiberloom.calibration.fibres.throughput import StarProfile, light, light_share
from fiberloom.typing import Floats, Ints
from fiberloom.units import UM_PER_MM

OF_STAR, OF_EXPOSURE, MODES = 3, 6, 4
"""Numbers of unknowns, and of patterns that the guider shares with the offsets."""
_HELD = 1e-3
"""A mean over exposures that is held at 0 is so within this."""
_SEEING, _SEEING_MEAN = 0.7, 0.5
"""FWHM over the core that is expected before the fit, and the rms of the logarithm of the mean about it."""


@dataclass(frozen=True)
class FieldSettings:
    """What is known of telescope and stars before the fit."""

    core_um: float = CORE_UM
    """Diameter of the fibres' cores."""
    profile: StarProfile = field(default_factory=StarProfile)
    """Of the stars; its width is fitted."""
    guide_um: float = 3.0
    """Rms per coordinate by which a dither may differ from what is told, at first. How much guider, seeing
    and transparency really scatter the fit finds, and begins with little: where all fibres are near their
    stars, any seeing fits with exposures that differ enough (and offsets that are larger in proportion)."""
    turn_um: float = 1.0
    """The same of rotation and scale, at the rms radius of the field."""
    seeing_spread: float = 0.05
    """Rms of the logarithm of the FWHM among the exposures of a field, at first."""
    transparency_spread: float = 0.05
    """The same of the transparency. The light that outer dithers lose tells the seeing, as far as the
    transparency does not change."""
    most_sigma_um: float = 10.0
    """Of an offset that still counts as found, per coordinate."""


@dataclass(frozen=True)
class Unknowns:
    """Where the fit is."""

    star: Floats
    """(N, 3): logarithm of the flux, v_x and v_y in um."""
    exposure: Floats
    """(E, 6): logarithms of transparency and FWHM in um; shift x, y, rotation, scale in um."""

    def moved(self, star: Floats, exposure: Floats) -> Unknowns:
        """Further by a step: `star` (N, 3) and `exposure` (E, 6), logarithms and um."""
        return Unknowns(self.star + star, self.exposure + exposure)


@dataclass(frozen=True)
class Normal:
    """Normal equations, with the stars' unknowns taken out (Schur)."""

    star: Floats
    """(N, 3, 3) inverse of each star's own block."""
    felt: Floats
    """(N, 3, 6 E) that inverse times what stars and exposures share."""
    exposure: Floats
    """(6 E, 6 E) covariance of the exposures' unknowns."""
    step: tuple[Floats, Floats]
    """Of stars (N, 3) and exposures (E, 6)."""


class FieldModel:
    """Fluxes, residuals and steps of one field."""

    def __init__(self, field: DitheredField, settings: FieldSettings) -> None:
        self.field, self.settings = field, settings
        self.apart_um = UM_PER_MM * (field.star_mm - field.fibre_mm)
        self.place = places_of(field.fibre_mm)
        self.seen = field.measured
        self.flux = np.where(self.seen, field.flux, 0.0)
        self.error = np.where(self.seen, field.flux_error, 1.0)

    def offsets_um(self, at: Unknowns) -> Floats:
        """(E, N, 2) um from each fibre to its star."""
        guide = at.exposure[:, 2:4, None] + np.einsum("nck,ek->ecn", self.place, at.exposure[:, 4:6])
        moved = self.field.dither_um[:, :, None] + guide
        shifted: Floats = np.swapaxes(moved, 1, 2) + self.apart_um - at.star[:, 1:]
        return shifted

    def fluxes(self, at: Unknowns) -> tuple[Floats, Floats, Floats]:
        """Fluxes (E, N), and their derivatives by stars (E, N, 3) and exposures (E, N, 6), per um or none."""
        flux, by_star, by_fwhm = self._of_stars(at)
        slope = -by_star[..., 1:]
        turned = np.einsum("enc,nck->enk", slope, self.place)
        by_exposure = np.concatenate([flux[..., None], by_fwhm[..., None], slope, turned], axis=-1)
        return flux, by_star, by_exposure

    def by_stars(self, at: Unknowns) -> tuple[Floats, Floats]:
        """Fluxes (E, N), and their derivatives by stars (E, N, 3), per um or none."""
        flux, by_star, _ = self._of_stars(at)
        return flux, by_star

    def _of_stars(self, at: Unknowns) -> tuple[Floats, Floats, Floats]:
        """The same, and (E, N) by the logarithm of the FWHM."""
        s, r, fwhm, bright = self._seen_from(at)
        found = light(self.settings.profile, r, fwhm, self.settings.core_um)
        flux = bright * found.share
        slope = (bright * found.per_um)[..., None] * s / np.maximum(r, 1e-9)[..., None]
        return flux, np.concatenate([flux[..., None], -slope], axis=-1), bright * found.per_fwhm

    def _seen_from(self, at: Unknowns) -> tuple[Floats, Floats, Floats, Floats]:
        """Offsets (E, N, 2) and their lengths (E, N), um; FWHM (E, 1), um; fluxes (E, N) of whole stars."""
        s = self.offsets_um(at)
        bright = np.exp(at.star[:, 0] + at.exposure[:, 0, None])
        return s, np.hypot(s[..., 0], s[..., 1]), np.exp(at.exposure[:, 1, None]), bright

    def residuals(self, at: Unknowns) -> Floats:
        """(E, N) in sigmas; 0 where nothing was measured."""
        _, r, fwhm, bright = self._seen_from(at)
        flux = bright * light_share(self.settings.profile, r, fwhm, self.settings.core_um)
        return np.where(self.seen, (self.flux - flux) / self.error, 0.0)

    def cost(self, at: Unknowns, weight: Floats) -> float:
        """Half of it is minus the logarithm of the probability: a number of sigmas squared.

        `at`: the unknowns; `weight` (E, N): of the fluxes.
        """
        value = (weight * self.residuals(at) ** 2).sum()
        off = (at.exposure - self._expected(at)).ravel()
        return float(value + off @ self._prior() @ off)

    def normal(self, at: Unknowns, weight: Floats, damping: float = 0.0) -> Normal:
        """Normal equations at a place; `weight` (E, N): of the fluxes; `damping`: a ratio, Marquardt's."""
        flux, by_star, by_exposure = self.fluxes(at)
        root = np.sqrt(weight) * self.seen / self.error
        js, je = by_star * root[..., None], by_exposure * root[..., None]
        left = (self.flux - flux) * root
        n_e, n = left.shape
        d = squared(js)
        b = np.einsum("enp,enq->npeq", js, je).reshape(n, OF_STAR, n_e * OF_EXPOSURE)
        a = self._prior()
        pull = -a @ (at.exposure - self._expected(at)).ravel()
        blocks = a.reshape(n_e, OF_EXPOSURE, n_e, OF_EXPOSURE)
        blocks[np.arange(n_e), :, np.arange(n_e)] += je.swapaxes(1, 2) @ je
        right_star = np.einsum("enp,en->np", js, left)
        right_exposure = (je.swapaxes(1, 2) @ left[..., None]).ravel() + pull
        d = _damped(d, damping) + 1e-9 * np.eye(OF_STAR)
        a = _damped(a[None], damping)[0]
        inverse = np.asarray(np.linalg.inv(d), dtype=np.float64)
        felt: Floats = inverse @ b
        schur: Floats = np.linalg.inv(a - np.einsum("npk,npl->kl", b, felt, optimize=True))
        exposure = schur @ (right_exposure - np.einsum("npk,np->k", felt, right_star, optimize=True))
        star = np.einsum("npq,nq->np", inverse, right_star) - felt @ exposure
        return Normal(inverse, felt, schur, (star, exposure.reshape(n_e, OF_EXPOSURE)))

    def _expected(self, at: Unknowns) -> Floats:
        expected = np.zeros_like(at.exposure)
        expected[:, 1] = np.log(_SEEING * self.settings.core_um)
        return expected

    def _prior(self) -> Floats:
        """(6 E, 6 E) weights of the exposures' unknowns among themselves."""
        n_e, s = self.field.n_exposures, self.settings
        spread = np.array([s.transparency_spread, s.seeing_spread, *[s.guide_um] * 2, *[s.turn_um] * 2])
        mean = np.array([_HELD, _SEEING_MEAN, *[_HELD] * MODES])
        alike = np.full((n_e, n_e), 1.0 / n_e)
        # apart from their mean by the spread, and the mean within its own
        each = [
            (np.eye(n_e) - alike) / u**2 + alike / (n_e * m**2) for u, m in zip(spread, mean, strict=True)
        ]
        blocks = np.zeros((n_e, OF_EXPOSURE, n_e, OF_EXPOSURE))
        for k, weights in enumerate(each):
            blocks[:, k, :, k] = weights
        return blocks.reshape(n_e * OF_EXPOSURE, n_e * OF_EXPOSURE)

    def select(self, rows: Ints) -> FieldModel:
        """The model of some of the fibres; their places in the field stay."""
        part = FieldModel(self.field.select(rows), self.settings)
        part.place = self.place[rows]
        return part


def squared(by_star: Floats) -> Floats:
    """(N, p, p) of each star, none or 1/um: derivatives times each other, summed over the exposures.

    `by_star`: (E, N, p) in sigmas, per um or none.
    """
    square: Floats = by_star.transpose(1, 2, 0) @ by_star.transpose(1, 0, 2)
    return square


def _damped(blocks: Floats, damping: float) -> Floats:
    out = blocks.copy()
    diagonal = np.einsum("nii->ni", out)
    diagonal *= 1.0 + damping
    return out
