"""What the air adds to an image, as the fibres that stand tell: it moves neighbours alike.

Fibres that did not move since the image before are where they were believed to be. What the image shows of
them beside that is the air above the focal plane and noise; the part that neighbours share is the air's.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fiberloom.typing import Flags, Floats

LENGTH_MM = 25.0
"""[A] Of the weights: half of the length over which the air is alike."""
NEAREST = 40
"""So many standing fibres at most tell of one place."""
FEWEST = 3.0
"""[A] So many standing fibres weigh as much as the belief that the air does nothing."""
MOST_MM = 0.02
"""One that is seen farther from where it stood was taken for another."""


def air_mm(seen_mm: Floats, believed_mm: Floats, stands: Flags) -> Floats:
    """(n, 2) mm by which the air shifts each of n fibres in an image.

    `seen_mm` (n, 2): NaN where not seen; `believed_mm` (n, 2): before the image; `stands` (n,): did not move
    since the image before. A fibre does not tell of its own air.
    """
    off_mm = seen_mm - believed_mm
    tells = np.flatnonzero(stands & (np.hypot(*off_mm.T) < MOST_MM))
    air = np.zeros_like(believed_mm)
    if len(tells) == 0:
        return air
    nearest = min(NEAREST, len(tells))
    gap_mm, which = cKDTree(believed_mm[tells]).query(believed_mm, k=np.arange(1, nearest + 1))
    weight = np.exp(-0.5 * (gap_mm / LENGTH_MM) ** 2)
    weight[tells[which] == np.arange(len(believed_mm))[:, None]] = 0.0
    shift = (weight[..., None] * off_mm[tells][which]).sum(axis=1)
    air[:] = shift / (weight.sum(axis=1) + FEWEST)[:, None]
    return air
