"""What a fit of guide stars says of the telescope, in words of the sky."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fiberloom.sky.chain import Chain
from fiberloom.sky.drift import beside, field_grid, guide_stars
from fiberloom.sky.guiding import FieldOffset, GuideFit, fit_guiding
from fiberloom.sky.sky_targets import SkyTargets
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

_STEP_DEG = 0.01
_ARCSEC_PER_DEG = 3600.0


def guide_report(chain: Chain, fit: GuideFit) -> dict[str, Any]:
    """For people and machines.

    `chain`: at the time of the stars; `fit`: of their places. Offsets in um and arcsec, rotation in arcsec
    (positive: the true position angle is larger), scale in ppm, each with its standard error.
    """
    sigma = np.sqrt(np.diag(fit.covariance))
    told = offset_report(chain, fit)
    return {
        "stars": len(fit.used),
        "used": int(fit.used.sum()),
        "star_sigma_um": fit.sigma_um,
        "offset_x_um": told["offset_x_um"],
        "offset_y_um": told["offset_y_um"],
        "offset_error_um": UM_PER_MM * float(np.hypot(*sigma[:2]) / np.sqrt(2.0)),
        "points_off_ra_arcsec": told["points_off_ra_arcsec"],
        "points_off_dec_arcsec": told["points_off_dec_arcsec"],
        "rotation_arcsec": told["rotation_arcsec"],
        "rotation_error_arcsec": _ARCSEC_PER_DEG * float(np.degrees(sigma[2])),
        "scale_ppm": told["scale_ppm"],
        "scale_error_ppm": 1e6 * float(sigma[3]),
        "error_at_edge_um": float(fit.error_um(_edge_mm(chain))),
        "position_angle_deg": chain.pointing.pa_deg + told["rotation_arcsec"] / _ARCSEC_PER_DEG,
        "scale": chain.view.scale / fit.scale,
    }


def offset_report(chain: Chain, off: FieldOffset) -> dict[str, float]:
    """How a telescope points `off`: um in the focal plane, arcsec on the sky, ppm of scale.

    `chain`: at the time of it.
    """
    p = chain.pointing
    centre_mm = chain.place(SkyTargets.at(p.ra_deg, p.dec_deg), "metrology").xy_mm
    here, there = (chain.sky(centre_mm - by, chain.guide_A)[0] for by in (np.zeros(2), off.offset_mm))
    off_arcsec = _ARCSEC_PER_DEG * ((there - here + 180.0) % 360.0 - 180.0)
    return {
        "offset_x_um": UM_PER_MM * float(off.offset_mm[0]),
        "offset_y_um": UM_PER_MM * float(off.offset_mm[1]),
        "points_off_ra_arcsec": float(off_arcsec[0] * np.cos(np.radians(p.dec_deg))),
        "points_off_dec_arcsec": float(off_arcsec[1]),
        "rotation_arcsec": _ARCSEC_PER_DEG * off.rotation_deg * _sense(chain),
        "scale_ppm": 1e6 * (off.scale - 1.0),
    }


def plate_um_arcsec(chain: Chain) -> float:
    """Of the focal plane at its centre, um an arcsec."""
    step_deg = np.array([[0.0, 0.0], [_STEP_DEG, 0.0], [0.0, _STEP_DEG]])
    places: Floats = chain.place(beside(chain, step_deg, chain.guide_A)).xy_mm
    area_mm2 = abs(float(np.linalg.det(places[1:] - places[0])))
    return UM_PER_MM * math.sqrt(area_mm2) / (_STEP_DEG * _ARCSEC_PER_DEG)


def _sense(chain: Chain) -> float:
    """Which way places turn in the focal plane where the position angle grows: 1 counter-clockwise, or -1."""
    stars = guide_stars(chain)
    turned = chain.turned(_STEP_DEG)
    fit = fit_guiding(chain.place(stars).xy_mm, turned.place(stars).xy_mm)
    return math.copysign(1.0, fit.rotation_deg)


def _edge_mm(chain: Chain) -> float:
    """Radius of the field in the focal plane."""
    edge_mm = chain.place(field_grid(chain, rings=(1.0,)), "metrology").xy_mm
    return float(np.hypot(*(edge_mm - edge_mm.mean(axis=0)).T).mean())
