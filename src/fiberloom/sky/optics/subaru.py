"""Prime focus of Subaru with its wide-field corrector, prisms and rotator, as PFS uses it.

Subaru-PFS/pfs_utils d723ff6, `CoordTransp.py` and `Subaru_POPT2_PFS.py`: the numbers are facts of that
source, at its fixed wavelength of 0.62 um. The first polynomials are of the ray trace, the two corrections of
measured fields. Places X, Y are mm at the focus before the rotator.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fiberloom.sky.optics.newton import inverse
from fiberloom.sky.optics.view import View
from fiberloom.typing import Floats
from fiberloom.units import RAD_PER_DEG, wrap_deg

_UNIT = 0.014
"""Tangent of the field angle at x = 1."""
_A = (262.7888753, 3.361911046, 0.2351457291, 0.01476724027, -5.483674768e-3, 2.652717872e-3)
_BX = (-1.771571e-6, -1.189729e-8, -3.878046e-8, -2.190314e-8, -4.056720e-8, 7.11622e-10)
_BY = (-8.740574e-6, -6.592585e-7, -1.757825e-7, -1.844848e-7, -1.125060e-7, 4.546287e-8)
_GX = (-4.242924e-4, 3.240717e-6)
_GY = (4.258414e-4, 7.804959e-6, 2.290958e-5, 3.766170e-5, 2.976411e-5)
_ADC_MM = (0.0027, 12.6755, -0.0992, 0.2141, -0.0901)
"""Shift of the prisms, of powers of the tangent of the zenith distance."""
_SIZE = (1 - 3 * 1.01546e-4) * (1 - 5e-5)
_RADIUS_MM = 270.0
_FIRST_UM = np.array(
    [
        [0.0596, 2.4211, 3.8109, -2.7563, -1.3575, 0.0212, -0.0924],
        [-0.2065, -3.4517, 4.0909, 3.4100, 0.1630, -1.0181, 0.2074],
    ]
)
_SECOND_UM = np.array(
    [
        [6.1368, -13.0386, 23.8638, -7.1225, 14.3990, 17.1600, 0.6465, -0.0983, 29.2435, -0.1752, 1.0101],
        [-3.2947, 15.5728, -15.9170, 11.7915, -7.6217, 11.5574, 9.0294, 19.0820, -2.6863, 5.2060, -1.9031],
    ]
)
_X_MM = 0.006
_ROTATOR_DEG = 0.124
_ORIGIN_MM = np.array([0.115, -0.030])
_MM_PER_UM = 1e-3


def adc_mm(zenith_deg: float) -> float:
    """Shift of the prisms in mm at a zenith distance without refraction in deg."""
    t = np.tan(zenith_deg * RAD_PER_DEG)
    return float(np.polynomial.polynomial.polyval(t, _ADC_MM))


@dataclass(frozen=True)
class PrimeFocus:
    """From directions to the plane of the cobras (PFI mm), and back."""

    def focal_mm(self, directions: Floats, view: View) -> Floats:
        """(n, 2) mm before the rotator, of directions (n, 3); the `view` sets the prisms."""
        return self._bent(view)(view.horizontal(directions[:, :2] / directions[:, 2:]))

    def directions(self, focal_mm: Floats, view: View) -> Floats:
        """(n, 3) unit vectors of places (n, 2) in mm before the rotator, for the same `view`."""
        start = focal_mm * np.array([1.0, -1.0]) * _UNIT / _A[0]
        tangent = view.equatorial(inverse(self._bent(view), focal_mm, start))
        vectors = np.column_stack([tangent, np.ones(len(tangent))])
        unit: Floats = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        return unit

    def plane_mm(self, focal_mm: Floats, view: View) -> Floats:
        """(n, 2) PFI mm: `focal_mm` (n, 2) turned by the rotator of the `view`."""
        plane: Floats = (focal_mm @ self._turn(view).T + _ORIGIN_MM) / view.scale
        return plane

    def from_plane_mm(self, plane_mm: Floats, view: View) -> Floats:
        """(n, 2) mm before the rotator, of PFI `plane_mm` (n, 2), for the same `view`."""
        focal: Floats = (plane_mm * view.scale - _ORIGIN_MM) @ self._turn(view)
        return focal

    @staticmethod
    def _turn(view: View) -> Floats:
        rotator_deg = float(wrap_deg(view.pole_deg + view.pa_deg)) + _ROTATOR_DEG
        turn = (90.0 - rotator_deg) * RAD_PER_DEG
        return np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    @staticmethod
    def _bent(view: View) -> Callable[[Floats], Floats]:
        shift_mm = adc_mm(view.zenith_deg)

        def bent(horizontal: Floats) -> Floats:
            """Tangents along azimuth and altitude to mm."""
            x, y = horizontal.T / _UNIT * np.array([[1.0], [-1.0]])
            return _corrected(_traced(x, y, shift_mm))

        return bent


def _traced(x: Floats, y: Floats, shift_mm: float) -> Floats:
    """The ray trace: (n, 2) mm."""
    q = x**2 + y**2
    across, along = _distorted(q, _BX, shift_mm) * x, _distorted(q, _BY, shift_mm) * y
    across += shift_mm * (_GX[0] + _GX[1] * (4 * q - 3)) * 2 * x * y
    shift = _GY[2] + _GY[3] * (2 * q - 1) + _GY[4] * (6 * q**2 - 6 * q + 1)
    along += shift_mm * ((_GY[0] + _GY[1] * (4 * q - 3)) * (x**2 - y**2) + shift)
    return _SIZE * np.column_stack([across, along])


def _distorted(q: Floats, b: tuple[float, ...], shift_mm: float) -> Floats:
    """Sum over the radial polynomials, of the squared radius q."""
    radial = (
        np.ones_like(q),
        3 * q - 2,
        10 * q**2 - 12 * q + 3,
        35 * q**3 - 60 * q**2 + 30 * q - 4,
        126 * q**4 - 280 * q**3 + 210 * q**2 - 60 * q + 5,
        462 * q**5 - 1260 * q**4 + 1260 * q**3 - 560 * q**2 + 105 * q - 6,
    )
    terms = [(one + two * shift_mm**2) * p for one, two, p in zip(_A, b, radial, strict=True)]
    total: Floats = np.sum(terms, axis=0)
    return total


def _corrected(mm: Floats) -> Floats:
    """The two corrections by measured fields, and the shift of the origin."""
    x, y = mm.T / _RADIUS_MM
    q = x**2 + y**2
    first = [np.ones_like(q), 2 * q - 1, x**2 - y**2, 2 * x * y, (3 * q - 2) * x, (3 * q - 2) * y]
    mm = mm + _MM_PER_UM * (_FIRST_UM @ np.array([*first, 6 * q**2 - 6 * q + 1])).T
    x, y = mm.T / _RADIUS_MM
    q = x**2 + y**2
    second = [
        *(np.ones_like(q), y, x, 2 * x * y, 2 * q - 1, x**2 - y**2, (3 * q - 4 * y**2) * y),
        *((3 * q - 2) * y, (3 * q - 2) * x, (4 * x**2 - 3 * q) * x, 6 * q**2 - 6 * q + 1),
    ]
    corrected: Floats = mm - _MM_PER_UM * (_SECOND_UM @ np.array(second)).T + np.array([_X_MM, 0.0])
    return corrected
