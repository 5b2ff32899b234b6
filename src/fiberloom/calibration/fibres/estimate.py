"""Offsets of the science fibres from one dithered field: robust least squares, covariance, refusals.

What the guider shares with the offsets. If all fibres of a field were off by the same vector in the focal
plane, or by a rotation or a growth of it, the guider would have to be off by the opposite: a field cannot
tell. `estimate` takes these four patterns out of the offsets (their mean, and so on, over the fibres is 0)
and keeps them as `modes`, with the size that N offsets at random would give them. They are patterns in the
focal plane and the offsets are fixed to the arms, which point elsewhere in the next field: `combine` finds
them from the differences between fields.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from fiberloom.calibration.fibres.descent import fitted
from fiberloom.calibration.fibres.dithered import DitheredField
from fiberloom.calibration.fibres.guider import patterns_of, places_of, size_of
from fiberloom.calibration.fibres.model import (
    MODES,
    OF_EXPOSURE,
    OF_STAR,
    FieldModel,
    FieldSettings,
    Normal,
    Unknowns,
)
from fiberloom.calibration.fibres.start import begin
from fiberloom.errors import InputError
from fiberloom.timing import part
from fiberloom.typing import Flags, Floats, Ints

_FEWEST_FIBRES, _FEWEST_EXPOSURES = 3, 4
_LEAST_SPREAD_UM = 10.0
"""Of the dithers in the narrower direction, rms."""
_LEAST_SN = 8.0
"""Of all fluxes of a fibre together, at the best offset: the chance of noise alone, tried at 150 places in
500 fibres, is below 1e-9."""
_SEEING = (0.2, 1.8)
"""FWHM over the fibre's core, in between which a fibre feels where its star is."""
_LEAST_LOSS, _LEAST_FOLLOWED = 0.1, 0.5
"""Rms of the logarithm of the light by dither, and the share of it that the fluxes must show."""
_PASSES = 3
"""To find how much seeing, transparency and guider scatter."""
_LEAST_SPREAD = (0.003, 0.01, 0.3)
"""Of transparency, seeing, and guider in um: none is better, whatever one field looks like."""
_MOST_CUT = 0.35
"""Share of its fluxes that a fibre may lose as outliers."""
_UNLIKELY = 1e-6
"""Chance below which the fluxes of a fibre are not those of a star."""


@dataclass(frozen=True, eq=False)
class FieldOffsets:
    """Offsets of N fibres, truth less belief, in the frame of each beta arm, from one field (or night)."""

    name: str
    positioner_id: Ints
    fibre: NDArray[np.str_]
    offset_um: Floats
    """(N, 2); 0 for a fibre with a reason."""
    covariance_um2: Floats
    """(N, 2, 2) without what is common to all (`modes`); NaN for a fibre with a reason."""
    reason: list[str]
    """Why nothing was found of a fibre; empty where it was."""
    fibre_mm: Floats
    """(N, 2) where the host believed the fibre."""
    turned: Floats
    """(N, 2, 2) from the frame of the arm to the focal plane: a ratio."""
    modes: Floats
    """(N, 2, 4) patterns that a field cannot tell, each of rms 1: um per um."""
    mode_um: float
    """Expected rms of each pattern's size, um."""
    chi2_dof: Floats
    """(N,) of the fluxes; NaN for a fibre with a reason."""
    n_outliers: Ints
    """(N,) fluxes that were left out."""
    exposures: Floats
    """(E, 6) unknowns of the exposures: model.py."""

    @property
    def ok(self) -> Flags:
        """(N,) True where found."""
        return np.array([not reason for reason in self.reason], dtype=bool)

    def covariance_with_modes_um2(self) -> Floats:
        """(N, 2, 2) um^2: of a field that is used alone."""
        total: Floats = self.covariance_um2 + self.mode_um**2 * self.modes @ self.modes.swapaxes(-1, -2)
        return total


@part("fit")
def estimate(field: DitheredField, settings: FieldSettings | None = None) -> FieldOffsets:
    """Offsets of all fibres of a field.

    Parameters
    ----------
    field : DitheredField
        Fluxes of N fibres in E exposures.
    settings : FieldSettings, optional
        Core of the fibres, profile of the stars, rms of the guider.

    Returns
    -------
    FieldOffsets
        In um; a fibre without light, whose fluxes fit no star, or whose offset its light does not tell has
        a reason and no offset.

    Raises
    ------
    InputError
        The field tells nothing: too few exposures or fibres, dithers that do not spread, no light.
    """
    settings = settings or FieldSettings()
    _check_dithers(field)
    whole = FieldModel(field, settings)
    reason = np.array(_dark(whole), dtype=object)
    lit = np.flatnonzero(reason == "")
    _check_left(field, len(lit), reason)
    found = _fit(whole, lit)
    reason[lit] = found.reasons()
    _check_left(field, int((reason == "").sum()), reason)
    if (reason[lit] != "").any():  # once more without those: they are no part of the common unknowns
        lit = np.flatnonzero(reason == "")
        found = _fit(whole, lit)
        reason[lit] = found.reasons()
        _check_left(field, int((reason == "").sum()), reason)
    return found.offsets(field, lit, [str(r) for r in reason])


def _fit(whole: FieldModel, rows: Ints) -> _Result:
    """Fits some of the fibres, then again with the guider's errors as large as they turned out."""
    model = whole.select(rows)
    at, used = fitted(model, begin(model))
    _check_falloff(model, at)
    for _ in range(_PASSES):
        model.settings = as_found(model.settings, at.exposure, model.normal(at, used.astype(float)).exposure)
        at, used = fitted(model, at, robust=False)
        _check_falloff(model, at)
    return _Result(model, at, used)


def as_found(settings: FieldSettings, exposures: Floats, covariance: Floats) -> FieldSettings:
    """With spreads of seeing, transparency and guider as they turned out: one step of EM.

    `settings`: before; `exposures` (E, 6): the unknowns, um and logarithms; `covariance` (6 E, 6 E): of
    them. The variance that is left counts too: what the fit cannot tell stays as wide as it was.
    """
    n_e = len(exposures)
    apart = exposures - exposures.mean(axis=0)
    blocks = covariance.reshape(n_e, OF_EXPOSURE, n_e, OF_EXPOSURE)
    left = np.einsum("ekek->k", blocks) - np.einsum("ekfk->k", blocks) / n_e
    t, w, *guider = np.sqrt(((apart**2).sum(axis=0) + left) / (n_e - 1))
    least = _LEAST_SPREAD
    return replace(
        settings,
        transparency_spread=float(max(t, least[0])),
        seeing_spread=float(max(w, least[1])),
        guide_um=float(max(np.sqrt(0.5 * (guider[0] ** 2 + guider[1] ** 2)), least[2])),
        turn_um=float(max(np.sqrt(0.5 * (guider[2] ** 2 + guider[3] ** 2)), least[2])),
    )


def _check_dithers(field: DitheredField) -> None:
    if field.n_exposures < _FEWEST_EXPOSURES:
        raise InputError(
            f"{field.name}: {field.n_exposures} exposures; a star's flux and place, and the seeing, need "
            f"{_FEWEST_EXPOSURES} with different dithers"
        )
    spread = np.sqrt(max(float(np.linalg.eigvalsh(np.cov(field.dither_um.T, bias=True))[0]), 0.0))
    if spread < _LEAST_SPREAD_UM:
        raise InputError(
            f"{field.name}: the dithers spread by {spread:.1f} um in their narrower direction, "
            f"{_LEAST_SPREAD_UM:g} are needed; move the stars by some 45 um in both directions"
        )


def _check_falloff(model: FieldModel, at: Unknowns) -> None:
    """Light that is the same wherever the telescope looks is no star's.

    It fits stars that are spread over everything, and also stars in the middle of their fibres, with a
    transparency that makes up for what each dither loses.
    """
    fwhm_um = float(np.exp(at.exposure[:, 1].mean()))
    share = model.fluxes(at)[0] / np.exp(at.star[:, 0] + at.exposure[:, :1])
    loss = np.log(np.maximum(np.median(share, axis=1), 1e-6))
    loss -= loss.mean()
    followed = 1.0 + float(loss @ at.exposure[:, 0]) / max(float(loss @ loss), 1e-12)
    plain = loss.std() < _LEAST_LOSS or not _SEEING[0] < fwhm_um / model.settings.core_um < _SEEING[1]
    if plain or not followed > _LEAST_FOLLOWED:
        raise InputError(
            f"{model.field.name}: tells nothing of the fibres: the light does not change with the dithers as "
            f"that of stars does (FWHM {fwhm_um:.0f} um, {max(followed, 0.0):.0%} of the expected change); "
            "are fluxes, dithers and core (um) right?"
        )


def _check_left(field: DitheredField, n: int, reason: NDArray[np.object_]) -> None:
    if n < _FEWEST_FIBRES:
        said = [str(r) for r in reason if r]
        most = max(set(said), key=said.count) if said else "no fibre has a star"
        raise InputError(
            f"{field.name}: tells nothing of the fibres: {n} of {len(reason)} are left, {_FEWEST_FIBRES} are "
            f"needed ({most})"
        )


def _dark(model: FieldModel) -> list[str]:
    """Why a fibre cannot be used at all, before anything is fitted."""
    n_seen = model.seen.sum(axis=0)
    weight = model.seen / model.error**2
    total = (weight * np.maximum(model.flux, 0.0) * model.flux.clip(0.0)).sum(axis=0)
    noise = (weight * np.minimum(model.flux, 0.0) ** 2).sum(axis=0)
    sn = np.sqrt(np.maximum(total - noise, 0.0))
    out = []
    for seen, of in zip(n_seen, sn, strict=True):
        if seen < _FEWEST_EXPOSURES:
            out.append(f"measured in {seen} exposures, {_FEWEST_EXPOSURES} needed")
        else:
            out.append("" if of >= _LEAST_SN else f"no light: all exposures together have S/N {of:.1f}")
    return out


class _Result:
    """Covariances and reasons at the end of a fit."""

    def __init__(self, model: FieldModel, at: Unknowns, used: Flags) -> None:
        self.model, self.at, self.used = model, at, used
        self.normal: Normal = model.normal(at, used.astype(float))
        square = np.where(used, model.residuals(at), 0.0) ** 2
        self.count = used.sum(axis=0)
        n_e, n = used.shape
        shared = (n_e * (OF_STAR + 2) - MODES) / max(n, 1)
        self.dof = np.maximum(self.count - OF_STAR - shared, 1.0)
        self.chi2 = square.sum(axis=0)
        half = chdtri(self.dof, 0.5)
        # what all fibres have in common, e.g. scintillation or another profile, counts as noise
        self.noisier = max(float(np.median(self.chi2 / half)), 1.0)

    def spread_um2(self) -> Floats:
        """(N, 2, 2) covariance of v with everything common in it but the four patterns."""
        own = self.normal.star[:, 1:, 1:]
        felt = self.normal.felt[:, 1:]
        modes = patterns_of(self.model.place)
        gram = np.linalg.pinv(np.einsum("ncj,nck->jk", modes, modes))
        back = modes @ gram  # (N, 2, 4)
        common = np.einsum("ncj,nck->jk", modes, felt)
        felt = felt - back @ common
        seen = own @ modes  # (N, 2, 4)
        total = np.einsum("ncj,nck->jk", modes, seen)
        cross = back @ seen.swapaxes(-1, -2)
        block = own - cross - cross.swapaxes(-1, -2) + back @ total @ back.swapaxes(-1, -2)
        shared = np.einsum("nck,kl,ndl->ncd", felt, self.normal.exposure, felt, optimize=True)
        covariance: Floats = self.noisier * (block + shared)
        return covariance

    def reasons(self) -> list[str]:
        """By fibre of the model; empty where its offset is found."""
        n_seen = self.model.seen.sum(axis=0)
        cut = n_seen - self.count
        sigma = np.sqrt(np.linalg.eigvalsh(self.spread_um2())[:, 1])
        unlikely = chdtri(self.dof, _UNLIKELY) * self.noisier
        most = self.model.settings.most_sigma_um
        out = []
        for k in range(len(cut)):
            if self.count[k] < _FEWEST_EXPOSURES or cut[k] > _MOST_CUT * n_seen[k]:
                out.append(f"{cut[k]} of {n_seen[k]} fluxes do not fit a star")
            elif self.chi2[k] > unlikely[k]:
                out.append(f"its fluxes fit no star (chi2 {self.chi2[k]:.0f} of {self.dof[k]:.0f})")
            elif not sigma[k] <= most:
                out.append(f"its light tells its offset to {sigma[k]:.3g} um only")
            else:
                out.append("")
        return out

    def offsets(self, field: DitheredField, lit: Ints, reason: list[str]) -> FieldOffsets:
        """For all fibres of the `field`; `lit`: rows of it in this fit; `reason`: of all."""
        n, turned = len(field.positioner_id), field.turned()
        modes = patterns_of(places_of(field.fibre_mm))
        good = np.array([not r for r in reason], dtype=bool)
        v, wide = np.zeros((n, 2)), np.full((n, 2, 2), np.nan)
        v[lit], wide[lit] = self.at.star[:, 1:], self.spread_um2()
        v[~good], wide[~good] = 0.0, np.nan
        v[good] -= modes[good] @ size_of(v[good], modes[good])
        back = turned.swapaxes(-1, -2)
        chi2, outliers = np.full(n, np.nan), np.zeros(n, dtype=np.int64)
        chi2[lit] = self.chi2 / self.dof
        outliers[lit] = (self.model.seen & ~self.used).sum(axis=0)
        return FieldOffsets(
            name=field.name,
            positioner_id=field.positioner_id,
            fibre=field.fibre,
            offset_um=np.einsum("nij,nj->ni", back, v),
            covariance_um2=back @ wide @ turned,
            reason=reason,
            fibre_mm=field.fibre_mm,
            turned=turned,
            modes=back @ modes,
            mode_um=float(np.sqrt((v[good] ** 2).mean() / good.sum())),
            chi2_dof=np.where(good, chi2, np.nan),
            n_outliers=outliers,
            exposures=self.at.exposure,
        )
