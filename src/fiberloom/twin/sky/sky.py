"""Stars above the focal plane: what a spectrograph counts while the telescope dithers.

The sky knows where fibres truly are; who estimates offsets gets fluxes, commanded dithers and what the host
believes. Seeing, profile, transparency and guiding of every exposure are drawn and told to no one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fiberloom.calibration.fibres.dithered import CORE_UM, DitheredField, hexagon
from fiberloom.calibration.fibres.guider import places_of
from fiberloom.calibration.fibres.throughput import StarProfile, light
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM


@dataclass(frozen=True)
class SkyConditions:
    """What is drawn; rms where nothing else is said."""

    sn: tuple[float, float] = (30.0, 100.0)
    """Of a star in the middle of its fibre, an exposure in mean conditions: from, to; even in logarithm."""
    seeing_um: float = 85.0
    """FWHM: 1.4 arcsec at 60 um/arcsec."""
    seeing_spread: float = 0.10
    """Relative, from exposure to exposure."""
    exponents: tuple[float, float] = (2.8, 4.8)
    """Of Moffat's profile, one for each field, from, to."""
    transparency_spread: float = 0.10
    """Relative, from exposure to exposure."""
    guide_um: float = 5.0
    """Per coordinate, from exposure to exposure: 0.08 arcsec."""
    field_guide_um: float = 5.0
    """The same for all exposures of a field."""
    turn_um: float = 1.0
    """Rotation and scale, at the rms radius, from exposure to exposure and for a field."""
    background_e: float = 30.0
    """Under the light of a star, electrons; its noise stays."""
    doubles: float = 0.02
    """Share of stars with a companion of 5 to 50 % of its light, 20 to 150 um away."""
    cosmics: float = 0.002
    """Share of fluxes with a cosmic ray of 3 to 100 sigmas."""

    def put_in(self) -> dict[str, str]:
        """For reports: sizes, all assumed."""
        return {
            "stars": f"S/N {self.sn[0]:g} to {self.sn[1]:g} an exposure, {self.doubles:.0%} double",
            "seeing": f"{self.seeing_um:g} um FWHM, {self.seeing_spread:.0%} rms between exposures, Moffat "
            f"exponents {self.exponents[0]:g} to {self.exponents[1]:g}",
            "transparency": f"{self.transparency_spread:.0%} rms between exposures",
            "guiding": f"{self.guide_um:g} um rms per coordinate and exposure, {self.field_guide_um:g} um a "
            f"field; rotation and scale {self.turn_um:g} um at the rms radius",
            "cosmic rays": f"{self.cosmics:.1%} of the fluxes",
        }


@dataclass(frozen=True, eq=False)
class Believed:
    """What the host knows of N fibres on stars."""

    name: str
    positioner_id: Any
    fibre: Any
    star_mm: Floats
    """(N, 2)"""
    fibre_mm: Floats
    """(N, 2)"""
    arm_deg: Floats
    """(N,)"""


class Sky:
    """A sky of its own for each field."""

    def __init__(self, seed: int, number: int, conditions: SkyConditions | None = None) -> None:
        """`seed`: of everything random; `number`: of the field; `conditions`: what is drawn."""
        self.conditions = conditions or SkyConditions()
        self._rng = np.random.default_rng([seed, number, 0x5C1])

    def expose(
        self, believed: Believed, true_mm: Floats, dither_um: Floats | None = None, core_um: float = CORE_UM
    ) -> DitheredField:
        """Exposures of a field.

        Parameters
        ----------
        believed : Believed
            What the host knows of the N fibres.
        true_mm : (N, 2) float
            Where the science fibres truly are, mm; NaN for one that gets no light.
        dither_um : (E, 2) float, optional
            Commanded moves of the stars, um; the hexagon of 13 when left out.
        core_um : float
            Diameter of the fibres' cores, um.

        Returns
        -------
        DitheredField
            Fluxes in electrons.
        """
        dither_um = hexagon() if dither_um is None else dither_um
        rng, c, n = self._rng, self.conditions, len(true_mm)
        apart_um = UM_PER_MM * (believed.star_mm - true_mm)
        moved = dither_um[:, None] + self._guided(len(dither_um), believed.fibre_mm)
        lit = np.asarray(np.isfinite(apart_um).all(axis=1))
        s = moved + np.where(lit[:, None], apart_um, 0.0)
        fwhm_um = c.seeing_um * np.exp(c.seeing_spread * rng.standard_normal(len(dither_um)))
        clear = np.exp(c.transparency_spread * rng.standard_normal(len(dither_um)))
        profile = StarProfile(float(rng.uniform(*c.exponents)))
        sn = np.exp(rng.uniform(np.log(c.sn[0]), np.log(c.sn[1]), n))
        middle = float(light(profile, np.array(0.0), np.array(c.seeing_um), core_um).share)
        # S/N = flux / sqrt(flux + background)
        bright = 0.5 * (sn**2 + np.sqrt(sn**4 + 4.0 * c.background_e * sn**2)) / middle

        def share(at_um: Floats) -> Floats:
            far = np.hypot(at_um[..., 0], at_um[..., 1])
            return light(profile, far, fwhm_um[:, None], core_um).share

        mean = clear[:, None] * bright * (share(s) + self._companions(n, s, share)) * lit
        flux, error = self._counted(mean)
        return DitheredField(
            believed.name,
            believed.positioner_id,
            believed.fibre,
            believed.star_mm,
            believed.fibre_mm,
            believed.arm_deg,
            dither_um,
            flux,
            error,
        )

    def _guided(self, n_exposures: int, fibre_mm: Floats) -> Floats:
        """(E, N, 2) um by which stars are elsewhere than commanded."""
        rng, c = self._rng, self.conditions
        shift = c.field_guide_um * rng.standard_normal(2) + c.guide_um * rng.standard_normal((n_exposures, 2))
        turn = c.turn_um * (rng.standard_normal(2) + rng.standard_normal((n_exposures, 2)))
        guided: Floats = shift[:, None] + np.einsum("nck,ek->enc", places_of(fibre_mm), turn)
        return guided

    def _companions(self, n: int, s: Floats, share: Any) -> Floats:
        """(E, N) light of second stars, over that of the first."""
        rng, c = self._rng, self.conditions
        double = np.asarray(rng.random(n) < c.doubles)
        size = np.where(double, rng.uniform(0.05, 0.5, n), 0.0)
        far, angle = rng.uniform(20.0, 150.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
        beside = s + (far * np.array([np.cos(angle), np.sin(angle)])).T
        companions: Floats = size * share(beside)
        return companions

    def _counted(self, mean: Floats) -> tuple[Floats, Floats]:
        """Electrons with noise and cosmic rays, and the error that a pipeline would tell."""
        rng, c = self._rng, self.conditions
        counted = rng.poisson(mean + c.background_e).astype(np.float64)
        error = np.sqrt(np.maximum(counted, 1.0))
        hit = np.asarray(rng.random(mean.shape) < c.cosmics)
        flux = counted - c.background_e + np.where(hit, error * rng.uniform(3.0, 100.0, mean.shape), 0.0)
        return flux, error
