"""Where the fit of a dithered field begins: offsets of all stars by trial, then seeing and transparency.

A star that is far off makes more than one valley; least squares alone would stay in the wrong one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fiberloom.calibration.fibres.descent import settled, start_weight
from fiberloom.calibration.fibres.model import OF_EXPOSURE, OF_STAR, FieldModel, Unknowns
from fiberloom.calibration.fibres.throughput import light_share
from fiberloom.typing import Floats, Ints

FARTHEST_UM = 105.0
"""Offsets that are tried; of SDSS-V's fibres the worst changed by some 60 um in 20 months."""
_STEP_UM = 15.0
_SEEING = (0.45, 0.6, 0.8, 1.1, 1.5)
"""FWHM that are tried, over the core."""
_TABLE_STEP_UM = 2.0
_TABLE_UM = np.arange(0.0, 401.0, _TABLE_STEP_UM)
_OWN_STEPS = 4
_LEAST_SHARE = 0.02
"""Of the light, for the transparency: fluxes below it tell nothing of it."""


class _Far(NamedTuple):
    """Distances on the table, (E, N, G) each; what is beyond it counts as its end."""

    step: Ints
    """Rows of the table below them."""
    beyond: Floats
    """And how far they are from there to the next one: 0 to 1."""


def begin(model: FieldModel) -> Unknowns:
    """Unknowns near enough to the best ones."""
    far = _far(model)
    tried = [_tried(model, share * model.settings.core_um, far) for share in _SEEING]
    return min(tried, key=lambda one: one[0])[1]


def _tried(model: FieldModel, fwhm_um: float, far: _Far) -> tuple[float, Unknowns]:
    """The misfit with this seeing (the median star counts for all), and the unknowns that belong to it."""
    n_e, n = model.flux.shape
    exposure = np.zeros((n_e, OF_EXPOSURE))
    exposure[:, 1] = np.log(fwhm_um)
    shares = _shares(model, fwhm_um, far)
    for _ in range(2):
        star, share = _best(model, shares, np.exp(exposure[:, 0]))
        exposure[:, 0] += _transparency(model, np.exp(star[:, 0]) * share, exposure[:, 0])
        exposure[:, 0] -= exposure[:, 0].mean()
    at = Unknowns(star, exposure)
    # the places that were tried are too coarse for bright stars
    at = settled(model, at, start_weight(model, at), _OWN_STEPS)
    light_lost = (exposure[:, 0] ** 2).sum() / model.settings.transparency_spread**2
    return n * float(np.median((model.residuals(at) ** 2).sum(axis=0))) + float(light_lost), at


def grid_um() -> Floats:
    """(G, 2) um: the offsets that are tried, a disc, the nearest first."""
    line = np.arange(-FARTHEST_UM, FARTHEST_UM + 1.0, _STEP_UM)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    far = np.hypot(*grid.T)
    order = np.argsort(far, kind="stable")
    kept: Floats = grid[order][far[order] <= FARTHEST_UM]
    return kept


def _far(model: FieldModel) -> _Far:
    """How far each fibre is from its star, with every offset that is tried."""
    s = model.field.dither_um[:, None, None] + model.apart_um[None, :, None] - grid_um()
    steps = np.minimum(np.hypot(s[..., 0], s[..., 1]) / _TABLE_STEP_UM, len(_TABLE_UM) - 1.0)
    step = np.minimum(steps.astype(np.intp), len(_TABLE_UM) - 2)
    return _Far(step, steps - step)


def _shares(model: FieldModel, fwhm_um: float, far: _Far) -> Floats:
    """(E, N, G) of the light, with every offset that is tried."""
    settings = model.settings
    table = light_share(settings.profile, _TABLE_UM, np.full_like(_TABLE_UM, fwhm_um), settings.core_um)
    shares: Floats = np.diff(table)[far.step]
    shares *= far.beyond
    shares += table[far.step]
    return shares


def _best(model: FieldModel, shares: Floats, bright: Floats) -> tuple[Floats, Floats]:
    """Stars (N, 3), and the shares (E, N) of the light with the best offset of each."""
    weight = model.seen / model.error**2
    expected = bright[:, None, None] * shares
    both = np.einsum("en,eng,en->ng", weight, expected, model.flux, optimize=True)
    square = np.einsum("en,eng,eng->ng", weight, expected, expected, optimize=True)
    gain = np.maximum(both, 0.0) ** 2 / np.maximum(square, 1e-300)
    best = gain.argmax(axis=1)
    rows = np.arange(len(best))
    flux = np.maximum(both[rows, best] / np.maximum(square[rows, best], 1e-300), 1e-300)
    star = np.empty((len(best), OF_STAR))
    star[:, 0], star[:, 1:] = np.log(flux), grid_um()[best]
    return star, shares[:, rows, best]


def _transparency(model: FieldModel, expected: Floats, so_far: Floats) -> Floats:
    """(E,) logarithm by which the stars of each exposure are brighter than expected; 0 where none tells."""
    full = expected * np.exp(so_far)[:, None]
    bright = expected / np.exp(so_far).mean() > _LEAST_SHARE * expected.max(axis=0)
    good = model.seen & bright & (model.flux > 0.0) & (full > 0.0)
    ratio = np.where(good, np.log(np.where(good, model.flux / np.where(good, full, 1.0), 1.0)), np.nan)
    return np.array([np.nanmedian(row) if np.isfinite(row).any() else 0.0 for row in ratio])
