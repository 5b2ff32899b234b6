"""Whose spot is it? Fibres that came far from where they should, by what is known of their motors.

The camera pairs spots with fibres that are nearly where they are expected. A cobra may end millimetres away:
then its spot is left over. Here each left-over spot is weighed against the poses that a cobra may have.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from fiberloom.drive.piezo.cobras import CobraArms
from fiberloom.typing import Flags, Floats, Ints

DRAWS = 200
BLUR_MM = 0.25
"""Of the cloud of drawn poses."""
FLOOR_MM2 = 0.002
"""Density of a spot anywhere in reach: some motors scatter much more than they are believed to."""
UNSEEN = 0.05
"""Probability that an unpaired fibre is dark or hidden."""
SURE = 2.0
"""A pair counts where the next best has a probability smaller by exp of this."""
REACH_MARGIN_MM = 0.1
IMPOSSIBLE = 1e6


def pair_loose(
    arms: CobraArms, expected_deg: Floats, sigma_deg: Floats, unseen: Flags, loose_mm: Floats, seed: int = 0
) -> Floats:
    """Places (n, 2) in mm of fibres that were not paired, NaN where no spot is theirs for certain.

    `arms` of n cobras; `expected_deg` and `sigma_deg` (n, 2): of their motors; `unseen` (n,): without a spot;
    `loose_mm` (m, 2): spots without a fibre; `seed` of what is drawn.
    """
    found = np.full((len(arms), 2), np.nan)
    rows = np.flatnonzero(unseen)
    if len(rows) == 0 or len(loose_mm) == 0:
        return found
    price = _prices(arms, expected_deg, sigma_deg, rows, loose_mm, np.random.default_rng(seed))
    none = np.full((len(rows), len(rows)), IMPOSSIBLE)
    np.fill_diagonal(none, -np.log(UNSEEN))
    whole = np.hstack([price, none])
    mine, spot = linear_sum_assignment(whole)
    for k, m in zip(mine.tolist(), spot.tolist(), strict=True):
        if m < len(loose_mm) and _is_sure(price, k, m):
            found[rows[k]] = loose_mm[m]
    return found


def _prices(
    arms: CobraArms, expected: Floats, sigma: Floats, rows: Ints, loose_mm: Floats, rng: np.random.Generator
) -> Floats:
    """(r, m) minus the logarithm of the density of each spot for each cobra."""
    draws = expected[rows, None] + sigma[rows, None] * rng.standard_normal((len(rows), DRAWS, 2))
    draws = np.clip(draws, 0.0, arms.range_deg[rows, None])
    at = arms.segments_mm(draws.reshape(-1, 2), np.repeat(rows, DRAWS))[:, 2:].reshape(len(rows), DRAWS, 2)
    away = np.hypot(*np.moveaxis(loose_mm[None] - arms.centre_mm[rows, None], 2, 0))
    inside = away < arms.link_mm[rows].sum(axis=1)[:, None] + REACH_MARGIN_MM
    price = np.full(away.shape, IMPOSSIBLE)
    for k, m in np.argwhere(inside):
        gap2 = ((at[k] - loose_mm[m]) ** 2).sum(axis=1) / BLUR_MM**2
        density = np.mean(np.exp(-0.5 * gap2)) / (2.0 * np.pi * BLUR_MM**2)
        price[k, m] = -np.log(density + FLOOR_MM2)
    return price


def _is_sure(price: Floats, k: int, m: int) -> bool:
    """No other cobra wants this spot, and this one no other spot, nearly as much."""
    others, own = np.delete(price[:, m], k), np.delete(price[k], m)
    best = min(others.min(initial=IMPOSSIBLE), own.min(initial=IMPOSSIBLE))
    return bool(best - price[k, m] > SURE)
