"""What the air between camera and focal plane does to an image."""

from __future__ import annotations

import numpy as np

from fiberloom._core import metrology as _core
from fiberloom.typing import Floats
from fiberloom.units import MM_PER_UM

_WAVES = 500
"""Of one axis: so many that their sum is Gaussian."""


def air_shift_mm(xy_mm: Floats, rms_um: float, length_mm: float, rng: np.random.Generator) -> Floats:
    """(n, 2) mm by which one exposure sees points at `xy_mm` (n, 2) beside where they are.

    A Gaussian field with squared-exponential correlation over `length_mm`, `rms_um` per coordinate, drawn
    by `rng` as a sum of random waves. Where a place is NaN its shift is NaN.
    """
    if rms_um == 0.0 or not len(xy_mm):
        return np.zeros_like(xy_mm)
    waves = rng.normal(0.0, 1.0 / length_mm, (2, _WAVES, 2))
    phase = rng.uniform(0.0, 2 * np.pi, (2, _WAVES))
    sums = [_core.wave_sums(xy_mm, np.column_stack(wave)) for wave in zip(waves, phase, strict=True)]
    shift: Floats = rms_um * MM_PER_UM * np.sqrt(2.0 / _WAVES) * np.column_stack(sums)
    return shift
