"""Random numbers of many units at once, the same for a unit in whatever company it is drawn."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from fiberloom.typing import Floats

_STEP = np.uint64(0x9E3779B97F4A7C15)
_MIX = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_SHIFT = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


def _mix(z: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The finalizer of splitmix64: any change of a bit changes half of the others."""
    z = (z ^ (z >> _SHIFT[0])) * _MIX[0]
    z = (z ^ (z >> _SHIFT[1])) * _MIX[1]
    return z ^ (z >> _SHIFT[2])


class UnitNoise:
    """One stream for each unit: splitmix64 on (seed, purpose, unit, count). Every draw takes one count.

    Numbers depend on the seed, the purpose, the unit's number and how many draws of that size came
    before, not on the other units: chunks of a campaign may be cut anywhere.
    """

    def __init__(self, seed: int, purpose: int, number: ArrayLike) -> None:
        units = np.atleast_1d(np.asarray(number)).astype(np.uint64)
        root = _mix(np.array([seed], dtype=np.uint64) * _STEP + np.uint64(purpose))
        self._key = _mix(root ^ _mix(units + np.uint64(1)))
        self._count = 0

    def uniform(self, *shape: int) -> Floats:
        """(N, *shape) in the open interval (0, 1)."""
        size = int(np.prod(shape, dtype=np.int64))
        count = np.arange(self._count + 1, self._count + 1 + size, dtype=np.uint64) * _STEP
        self._count += size
        bits = _mix(self._key[:, None] + count[None]) >> _SHIFT[3]  # 53 of them
        flat = (bits.astype(np.float64) + 0.5) * 2.0**-53
        return flat.reshape(len(self._key), *shape)

    def normal(self, *shape: int) -> Floats:
        """(N, *shape) standard normal."""
        normal: Floats = ndtri(self.uniform(*shape))
        return normal
