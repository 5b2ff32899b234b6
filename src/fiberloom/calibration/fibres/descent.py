"""Least squares of a dithered field: all unknowns together, and every star once more by itself.

A few stars far from their best place would hold up a common step: after each, every star takes steps of its
own while the exposures rest, each with its own damping.
"""

from __future__ import annotations

import numpy as np

from fiberloom.calibration.fibres.model import OF_STAR, FieldModel, Unknowns, squared
from fiberloom.typing import Flags, Floats

_DOWNWEIGHT = 9.0
"""Cauchy's weight is a half at this squared residual, as long as outliers are not known yet."""
_OUTLIER = 25.0
"""Squared residual of a flux that is left out: 1 in 1.7 million of Gaussian ones."""
_ROUNDS, _STEPS, _OWN_STEPS = 4, 30, 3
_DAMPING = 1e-6
"""At first; a ratio."""
_MOST_DAMPING = 1e4
_SMALL = 1e-3
"""Of all squared residuals together: what no unknown notices."""
_LONGEST = np.array([1.0, 30.0, 30.0])
"""No star goes farther in one step: logarithm of its flux, um."""


def start_weight(model: FieldModel, at: Unknowns) -> Floats:
    """(E, N) weights of fluxes, small where they do not fit."""
    weights: Floats = model.seen / (1.0 + model.residuals(at) ** 2 / _DOWNWEIGHT)
    return weights


def fitted(model: FieldModel, at: Unknowns, robust: bool = True) -> tuple[Unknowns, Flags]:
    """The best unknowns from those given, and (E, N) which fluxes count.

    `robust`: those given may be far from the best, so that outliers are not known yet.
    """
    for _ in range(_ROUNDS if robust else 0):
        at = _descended(model, at, start_weight(model, at))
    used = model.seen.copy()
    for _ in range(_ROUNDS):
        before, used = used, model.seen & (model.residuals(at) ** 2 < _OUTLIER)
        at = _descended(model, at, used.astype(float))
        if np.array_equal(before, used):
            break
    return at, used


def _descended(model: FieldModel, at: Unknowns, weight: Floats) -> Unknowns:
    """Levenberg and Marquardt."""
    damping, cost = _DAMPING, model.cost(at, weight)
    for _ in range(_STEPS):
        step = model.normal(at, weight, damping).step
        tried = at.moved(np.clip(step[0], -_LONGEST, _LONGEST), step[1])
        new = model.cost(tried, weight)
        if not new <= cost - _SMALL:
            tried = settled(model, tried, weight, _OWN_STEPS)
            new = model.cost(tried, weight)
        if new <= cost:
            done = cost - new < _SMALL and damping <= _DAMPING
            at, cost, damping = tried, new, max(damping * 0.1, _DAMPING)
            if done:
                break
        elif damping > _MOST_DAMPING:
            break
        else:
            damping *= 10.0
    return at


def settled(model: FieldModel, at: Unknowns, weight: Floats, steps: int) -> Unknowns:
    """Every star in the best place while the exposures rest.

    `model`; `at`: the unknowns; `weight` (E, N): of the fluxes; `steps`: how many each star tries.
    """
    star, damping = at.star, np.full(len(at.star), _DAMPING)
    root = np.sqrt(weight) * model.seen / model.error
    flux, slope = model.by_stars(at)
    for _ in range(steps):
        j, left = slope * root[..., None], (model.flux - flux) * root
        square = squared(j) + 1e-9 * np.eye(OF_STAR)
        np.einsum("npp->np", square)[:] *= 1.0 + damping[:, None]
        step = np.linalg.solve(square, np.einsum("enp,en->np", j, left)[..., None])[..., 0]
        tried = Unknowns(star + np.clip(step, -_LONGEST, _LONGEST), at.exposure)
        new_flux, new_slope = model.by_stars(tried)
        better = (((model.flux - new_flux) * root) ** 2).sum(axis=0) <= (left**2).sum(axis=0)
        star = np.where(better[:, None], tried.star, star)
        flux, slope = np.where(better, new_flux, flux), np.where(better[:, None], new_slope, slope)
        damping = np.clip(np.where(better, damping * 0.1, damping * 100.0), _DAMPING, None)
    return Unknowns(star, at.exposure)
