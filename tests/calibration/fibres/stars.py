"""Fields of stars with a Gaussian profile, by scipy's chi square: nothing of the package but the class."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import ncx2

from fiberloom.calibration.fibres.dithered import DitheredField, hexagon
from fiberloom.calibration.fibres.model import FieldSettings
from fiberloom.calibration.fibres.throughput import StarProfile

CORE_UM = 120.0
GAUSSIAN = FieldSettings(profile=StarProfile(np.inf))
SIGMA_PER_FWHM = 1.0 / np.sqrt(8.0 * np.log(2.0))


def share(far_um, fwhm_um):
    sigma = SIGMA_PER_FWHM * fwhm_um
    return ncx2.cdf((0.5 * CORE_UM / sigma) ** 2, 2, (far_um / sigma) ** 2)


@dataclass(frozen=True)
class Conditions:
    sn: float = 100.0
    guide_um: float = 3.0
    seeing_um: float = 85.0
    spread: float = 0.1


def turned(arm_deg):
    a = np.deg2rad(arm_deg)
    return np.moveaxis(np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]), -1, 0)


def drawn_offsets(rng, n, rms_um=12.0):
    return rms_um * rng.standard_normal((n, 2))


def drawn_field(rng, offset_um, conditions=None, dither_um=None, name="a field"):
    """A field whose fibres are off by (N, 2) um in the frames of arms that point anywhere."""
    c, n = conditions or Conditions(), len(offset_um)
    dither_um = hexagon() if dither_um is None else dither_um
    n_e = len(dither_um)
    xy_mm, arm_deg = rng.uniform(-300.0, 300.0, (n, 2)), rng.uniform(0.0, 360.0, n)
    off = np.einsum("nij,nj->ni", turned(arm_deg), offset_um)
    guide = c.guide_um * rng.standard_normal((n_e, 2))
    s = dither_um[:, None] + guide[:, None] - off
    seeing = c.seeing_um * np.exp(c.spread * rng.standard_normal(n_e))
    clear = np.exp(c.spread * rng.standard_normal(n_e))
    mean = c.sn**2 * clear[:, None] * share(np.hypot(*np.moveaxis(s, -1, 0)), seeing[:, None])
    flux = rng.poisson(mean / share(0.0, c.seeing_um)).astype(float)
    return DitheredField(
        name=name,
        positioner_id=np.arange(1, n + 1),
        fibre=np.full(n, "BOSS"),
        star_mm=xy_mm,
        fibre_mm=xy_mm,
        arm_deg=arm_deg,
        dither_um=dither_um,
        flux=flux,
        flux_error=np.sqrt(np.maximum(flux, 1.0)),
    )


def without_modes(found, error_um):
    """Errors (n, 2) of the fibres that were found, less the four patterns that a field cannot tell."""
    flat = found.modes[found.ok].reshape(-1, 4)
    error = error_um[found.ok].ravel()
    return (error - flat @ np.linalg.lstsq(flat, error, rcond=None)[0]).reshape(-1, 2)


def rms(vectors):
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))


def formal(covariance):
    return float(np.sqrt(np.einsum("nii->n", covariance).mean()))
