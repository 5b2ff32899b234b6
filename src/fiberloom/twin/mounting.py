"""How well a layout is known before anything was measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.units import MM_PER_UM, RAD_PER_DEG


def misplaced(plane: FocalPlane, by_um: float, by_deg: float, seed: int) -> FocalPlane:
    """The layout of a `plane` as it is known before anything was measured.

    Centres and alpha arms are wrong by `by_um`, zeros by `by_deg`, rms, drawn from the `seed`.
    """
    rng = np.random.default_rng([seed, 0x3015])
    sigmas = np.array([*[by_um * MM_PER_UM] * 3, *[by_deg * RAD_PER_DEG] * 2])
    return replace(plane, arms=plane.arms + rng.normal(size=plane.arms.shape) * sigmas)
