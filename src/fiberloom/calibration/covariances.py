"""Which matrices of a file can be covariances."""

from __future__ import annotations

import numpy as np

from fiberloom.typing import Flags, Floats


def are_covariances(matrices: Floats, most: float) -> Flags:
    """(N,) which of `matrices` (N, k, k) are finite, symmetric and positive definite.

    `most`: of the sum of a diagonal; in any unit of a variance, such as mm2 or rad2, as the matrices are.
    """
    sound: Flags = np.all(np.isfinite(matrices), axis=(1, 2))
    wide = np.where(sound[:, None, None], matrices, 0.0)
    trace = np.trace(wide, axis1=1, axis2=2)
    skew = np.abs(wide - wide.transpose(0, 2, 1)).max(axis=(1, 2))
    sound &= np.asarray((skew <= 1e-6 * trace) & (trace <= most))
    return sound & (np.linalg.eigvalsh(wide) > 0.0).all(axis=1)
