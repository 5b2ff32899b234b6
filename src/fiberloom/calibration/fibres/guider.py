"""What a guider takes of the fibres' errors: shift, rotation and scale of the whole field.

The telescope follows what its stars tell it. Fibres that are all off by the same vector, or by a rotation or
a growth of the field, are on their stars after that.
"""

from __future__ import annotations

import numpy as np

from fiberloom.typing import Flags, Floats

_FEWEST = 3
"""Fibres, below which four patterns leave nothing to judge."""
_FAR = 5.0
"""Robust standard deviations beyond which a fibre does not count for the guider."""
_ROUNDS = 5
_MEDIAN = 1.177
"""Of the length of a two-dimensional Gaussian, over its sigma per coordinate."""


def places_of(xy_mm: Floats) -> Floats:
    """(N, 2, 2) directions in which fibres (N, 2) move where the field turns, and where it grows.

    A ratio: by how much against the rms radius of the field.
    """
    if not len(xy_mm):
        return np.empty((0, 2, 2))
    apart = xy_mm - xy_mm.mean(axis=0)
    radius = np.sqrt((apart**2).sum(axis=1).mean())
    x, y = (apart / max(float(radius), 1e-9)).T
    return np.stack([np.stack([-y, x], axis=-1), np.stack([x, y], axis=-1)], axis=-1)


def patterns_of(place: Floats) -> Floats:
    """(N, 2, 4) shift x and y, rotation, scale, of no unit; `place`: (N, 2, 2) of `places_of`, a ratio."""
    shifts: Floats = np.broadcast_to(np.eye(2), place.shape)
    return np.concatenate([shifts, place], axis=-1)


def size_of(vectors: Floats, patterns: Floats) -> Floats:
    """(4,) um of each pattern in vectors (N, 2), um, by least squares; `patterns`: (N, 2, 4), ratios."""
    flat = patterns.reshape(-1, patterns.shape[-1])
    return np.asarray(np.linalg.lstsq(flat, vectors.ravel(), rcond=None)[0], dtype=np.float64)


def guided(apart: Floats, xy_mm: Floats, counted: Flags) -> Floats:
    """What a guider leaves of the errors of fibres.

    Parameters
    ----------
    apart : (N, 2) float
        From each star to its fibre, in any unit of length; NaN without one.
    xy_mm : (N, 2) float
        Places in the focal plane, mm.
    counted : (N,) bool
        Fibres by whose light it guides: a lone one that is far off does not count.

    Returns
    -------
    (N, 2) float
        In the unit of `apart`; as it is where fewer than three fibres count.
    """
    patterns = patterns_of(places_of(xy_mm))
    used = counted & np.isfinite(apart).all(axis=1)
    left: Floats = apart
    for _ in range(_ROUNDS):
        if used.sum() < _FEWEST:
            return apart
        left = apart - patterns @ size_of(apart[used], patterns[used])
        far = np.hypot(*left.T)
        again = used & (far <= _FAR * float(np.median(far[used])) / _MEDIAN)
        if (again == used).all():
            break
        used = again
    return left
