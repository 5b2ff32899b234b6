"""What a micrometre costs: light lost by decentre, and how many corrections pay for their time.

A point source of Moffat shape (beta 3.5), a round fibre, light relative to a centred fibre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from fiberloom.errors import InputError
from fiberloom.typing import Floats

MOFFAT_BETA = 3.5
"""DESI's model; 2.5 changes a loss by less than 11 %."""
MOST_CORRECTIONS = 8


@dataclass(frozen=True)
class FibreOptics:
    """A fibre on the sky."""

    core_um: float
    """Diameter."""
    scale_um_arcsec: float
    seeing_arcsec: float = 1.0
    """Full width at half maximum."""

    def __post_init__(self) -> None:
        for name in ("core_um", "scale_um_arcsec", "seeing_arcsec"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InputError(f"throughput: {name} {getattr(self, name):g}: must be above 0")

    @property
    def core_radius_um(self) -> float:
        """Of the Moffat profile (1 + (r/a)^2)^-beta."""
        half = 0.5 * self.seeing_arcsec * self.scale_um_arcsec
        return half / math.sqrt(math.pow(2.0, 1.0 / MOFFAT_BETA) - 1.0)

    @property
    def centred(self) -> float:
        """Share of the light in a centred fibre, 0 to 1."""
        edge = 0.5 * self.core_um / self.core_radius_um
        return 1.0 - math.pow(1.0 + edge**2, 1.0 - MOFFAT_BETA)

    def share(self, decentre_um: ArrayLike) -> Floats:
        """Share of the light in a fibre at decentres (n,) in um."""
        node, weight = np.polynomial.legendre.leggauss(48)
        radius = 0.25 * self.core_um * (node + 1.0)
        turn = np.linspace(0.0, math.pi, 48, endpoint=False) + math.pi / 96.0
        d = np.atleast_1d(np.asarray(decentre_um, dtype=np.float64))[:, None, None]
        far2 = radius[:, None] ** 2 + d**2 + 2.0 * radius[:, None] * d * np.cos(turn)
        a = self.core_radius_um
        density = (MOFFAT_BETA - 1.0) / (math.pi * a**2) * (1.0 + far2 / a**2) ** -MOFFAT_BETA
        ring = density.mean(axis=2) * 2.0 * math.pi * radius
        found: Floats = ring @ weight * 0.25 * self.core_um
        return found

    def loss(self, decentre_um: ArrayLike) -> Floats:
        """(n,) share lost against a centred fibre, at decentres in um."""
        return 1.0 - self.share(decentre_um) / self.share(0.0)

    @property
    def k_per_um2(self) -> float:
        """Loss over decentre squared, for small ones: below 15 um loss = K e^2."""
        small_um = 0.02 * self.core_um
        return float(self.loss(small_um)[0]) / small_um**2

    def blurred_share(self, radius_um: float) -> float:
        """Share of the light in a centred fibre, of a point that is spread over a disc of `radius_um`."""
        inside_um = radius_um * np.sqrt((np.arange(_QUANTILES) + 0.5) / _QUANTILES)
        return float(self.share(inside_um).mean())

    def defocus_loss(self, defocus_um: ArrayLike, focal_ratio: float) -> Floats:
        """(n,) share lost by fibres that are `defocus_um` along the beam from the focus, in a beam of F.

        A telescope without obstruction: the blur is an even disc of the diameter defocus/F.
        """
        if not focal_ratio > 0.0:
            raise InputError(f"throughput: focal ratio {focal_ratio:g}: must be above 0")
        away_um = np.abs(np.atleast_1d(np.asarray(defocus_um, dtype=np.float64)))
        kept = [self.blurred_share(0.5 * um / focal_ratio) for um in away_um]
        return 1.0 - np.array(kept) / self.blurred_share(0.0)

    def mean_defocus_loss(self, rms_um: float, focal_ratio: float) -> float:
        """Mean share lost where the defocus is normal with this rms, in a beam of this focal ratio."""
        probability = 0.5 + 0.5 * (np.arange(_STEPS) + 0.5) / _STEPS
        return float(self.defocus_loss(rms_um * ndtri(probability), focal_ratio).mean())

    def mean_loss(self, rms_um: float) -> float:
        """Mean share lost where errors are normal in x and y with this two-dimensional rms."""
        return float((self.loss(_rayleigh(rms_um))).mean())

    def speed(self, rms_um: float) -> float:
        """Speed of a survey that the sky limits, against centred fibres, a ratio: the mean of light
        squared."""
        return float(((1.0 - self.loss(_rayleigh(rms_um))) ** 2).mean())


_QUANTILES = 150
_STEPS = 50
"""Of a defocus."""


def _rayleigh(rms_um: float) -> Floats:
    """Distances of equal probability."""
    probability = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    far: Floats = rms_um * np.sqrt(-np.log1p(-probability))
    return far


@dataclass(frozen=True)
class CorrectionCosts:
    """How errors shrink: e_k^2 = (rho^k e_0)^2 + s^2 for k >= 1, and what time each costs."""

    blind_um: float
    """e_0, two-dimensional rms of the blind move."""
    remains: float = 0.24
    """rho: share of an error that a correction leaves (from Kronig 2020, Fig. 19: 10.36 and 1.12 um)."""
    floor_um: float = 0.67
    """s: what the camera's noise leaves."""
    each_s: float = 9.5
    """Image 6.5 s and move 3 s."""

    def __post_init__(self) -> None:
        if not (self.blind_um > 0.0 and 0.0 <= self.remains < 1.0):
            raise InputError(
                f"corrections: blind error {self.blind_um:g} um must be above 0, what remains "
                f"{self.remains:g} in 0 to 1"
            )
        if self.floor_um < 0.0 or self.each_s < 0.0:
            raise InputError(f"corrections: floor {self.floor_um:g} um and time {self.each_s:g} s: 0 or more")

    def rms_um(self, k: int) -> float:
        """True error after k corrections."""
        return self.blind_um if k == 0 else math.hypot(self.remains**k * self.blind_um, self.floor_um)

    def beyond(self, k: int, requirement_um: float) -> float:
        """Share of the fibres farther off than the requirement."""
        return math.exp(-((requirement_um / self.rms_um(k)) ** 2))


def speeds(
    optics: FibreOptics, moves: CorrectionCosts, exposure_s: float, overhead_s: float = 60.0
) -> Floats:
    """(9,) survey speed after 0 to 8 corrections, a ratio; 1: no overhead and every fibre centred.

    `optics`: the fibre on the sky; `moves`: how errors shrink; `exposure_s`, `overhead_s`.

    Raises
    ------
    InputError
        An exposure that is not above 0, or a negative overhead, in s.
    """
    if not exposure_s > 0.0 or overhead_s < 0.0:
        raise InputError(f"exposure {exposure_s:g} s must be above 0, overhead {overhead_s:g} s not below")
    return np.array(
        [
            exposure_s / (exposure_s + overhead_s + k * moves.each_s) * optics.speed(moves.rms_um(k))
            for k in range(MOST_CORRECTIONS + 1)
        ]
    )


def best_corrections(
    optics: FibreOptics, moves: CorrectionCosts, exposure_s: float, overhead_s: float = 60.0
) -> int:
    """The number of corrections with the highest speed.

    `optics`: the fibre on the sky; `moves`: how errors shrink; `exposure_s`, `overhead_s`: of one exposure.
    """
    return int(speeds(optics, moves, exposure_s, overhead_s).argmax())


def needed_corrections(moves: CorrectionCosts, requirement_um: float, share: float = 0.99) -> int | None:
    """Fewest corrections with a `share`, 0 to 1, of the fibres within `requirement_um`; None: not with 8.

    `moves`: how errors shrink.
    """
    for k in range(MOST_CORRECTIONS + 1):
        if 1.0 - moves.beyond(k, requirement_um) >= share:
            return k
    return None
