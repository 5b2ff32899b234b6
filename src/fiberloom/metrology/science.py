"""From the fibre that the camera sees to the fibre that the target needs, by the arm's kinematics.

    (alpha, beta) = inverse(p_metrology)      p_science = forward(alpha, beta)
    C_science = T C_metrology T^T,   T = J_science J_metrology^-1

with J = d(x, y)/d(alpha, beta) of either point (Kronig 2020, Eq. 1 and 2). Where the arm is stretched or
folded J_metrology is singular: the camera does not tell the angles, and the covariance grows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.typing import Floats


def science_positions(
    plane: FocalPlane,
    xy_mm: ArrayLike,
    covariance_mm2: ArrayLike,
    fibre: str,
    index: ArrayLike | None = None,
) -> tuple[Floats, Floats]:
    """Positions (n, 2) in mm of a science `fibre`, and covariances (n, 2, 2) in mm^2.

    From measured metrology fibres `xy_mm` (n, 2) with `covariance_mm2` (n, 2, 2), of the positioners
    `index` of the `plane` (all when left out). NaN where the metrology fibre is outside the reach, not
    seen, or the positioner lacks the fibre.
    """
    xy, covariance = np.asarray(xy_mm, dtype=np.float64), np.asarray(covariance_mm2, dtype=np.float64)
    found = plane.inverse(xy, METROLOGY, index=index)
    angles = (found.alpha_deg, found.beta_deg)
    science = plane.forward(*angles, fibre, index=index)
    seen = plane.jacobian(*angles, METROLOGY, index=index)
    carried = plane.jacobian(*angles, fibre, index=index) @ _inverse(seen)
    known = found.reachable & np.isfinite(xy).all(axis=1) & np.isfinite(science).all(axis=1)
    spread = carried @ covariance @ carried.transpose(0, 2, 1)
    return np.where(known[:, None], science, np.nan), np.where(known[:, None, None], spread, np.nan)


def _inverse(matrix: Floats) -> Floats:
    """Of (n, 2, 2); infinite where singular."""
    a, b, c, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 0], matrix[:, 1, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([np.stack([d, -b], 1), np.stack([-c, a], 1)], 1) / (a * d - b * c)[:, None, None]
