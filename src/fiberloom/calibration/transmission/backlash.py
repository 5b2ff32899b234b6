"""Backlash from calibrated maps: the gap between both contacts, and what the slope of the gear does to it.

At one motor angle the arm stands at theta+ in positive contact and at theta- in negative contact. The gap
n (theta- - theta+) is the backlash B divided by the local slope of T-/n between the two: a ripple of
amplitude a and m cycles a turn makes it wrong by up to m a, relative. The scatter of the gap has the size
of the ripple's slope even where B is constant, and its largest value over a gear is too large.

B itself is n (wire - T-(theta+)), Eq. 7, if T- is known between its knots: where the ripple has more than
two knots a cycle. With fewer no interpolation helps, and both functions are wrong alike.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.typing import Floats


def gap_motor_deg(maps: TransmissionMaps) -> Floats:
    """(N, 2, K) gap between the contacts at the knots of the `maps`, motor deg: backlash over slope."""
    gap: Floats = maps.provenance.gear * (maps.output_deg[:, :, 0] - maps.output_deg[:, :, 1])
    return gap


def backlash_at_knots_deg(maps: TransmissionMaps) -> Floats:
    """(N, 2, K) backlash B in motor deg at the positive contact's knots of the `maps`; Kronig 2020, Eq. 7.

    T- is taken between its knots by a cubic spline; NaN outside its knots.
    """
    out = np.full(maps.output_deg[:, :, 1].shape, np.nan)
    for row, axis in np.ndindex(out.shape[:2]):
        minus, plus = maps.output_deg[row, axis]
        wire_minus, wire_plus = maps.wire_deg[row, axis]
        negative = CubicSpline(minus, wire_minus, extrapolate=False)
        out[row, axis] = maps.provenance.gear * (wire_plus - negative(plus))
    return out
