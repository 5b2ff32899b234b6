"""How far targets move over their fibres during an exposure: refraction changes, and the field turns with it.

Pointing and rotator are ideal, fibres are placed for the middle. What a guider takes off is offset, rotation
and scale by guide stars at the edge of the field.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiberloom.errors import InputError
from fiberloom.sky.chain import Chain
from fiberloom.sky.guiding import fit_guiding
from fiberloom.sky.sky_targets import SkyTargets
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

GUIDE_PLACES = 6
"""Guide cameras on a ring at the edge of the field, the first at 30 deg."""
_FIRST_DEG = 30.0
_STARS_DEG = 0.05
"""Stars of one guide camera lie so far around its middle."""
LIMIT_UM = 5.0
_LONGEST_S = 6.0 * 3600.0
_SHORTEST_S = 10.0


@dataclass(frozen=True, eq=False)
class SkyDrift:
    """Of n targets over an exposure: the larger displacement of begin and end."""

    exposure_s: float
    plain_um: Floats
    """(n,) without guiding; pointing and rotator are ideal."""
    guided_um: Floats
    """(n,) once guiding has taken off offset, rotation and scale."""

    @property
    def largest_um(self) -> tuple[float, float]:
        """Without and with guiding, um."""
        return float(self.plain_um.max()), float(self.guided_um.max())


def drift(chain: Chain, targets: SkyTargets, exposure_s: float, fibre: str | None = None) -> SkyDrift:
    """What an exposure does to targets that were placed for its middle.

    Parameters
    ----------
    chain : Chain
        At the middle of the exposure.
    targets : SkyTargets
        n targets.
    exposure_s : float
        Of the whole exposure, s.
    fibre : str, optional
        For which they are placed; their own when left out.

    Returns
    -------
    SkyDrift
        um for each target.
    """
    stars = guide_stars(chain)
    middle, guides = chain.place(targets, fibre).xy_mm, chain.place(stars).xy_mm
    plain, guided = np.zeros((2, len(targets)))
    for part in (-0.5, 0.5):
        then = chain.at(chain.pointing.time.later(part * exposure_s))
        there = then.place(targets, fibre).xy_mm
        fit = fit_guiding(guides, then.place(stars).xy_mm)
        plain = np.maximum(plain, _apart_um(there, middle))
        guided = np.maximum(guided, _apart_um(fit.removed(there), middle))
    return SkyDrift(exposure_s, plain, guided)


def _apart_um(a: Floats, b: Floats) -> Floats:
    apart: Floats = UM_PER_MM * np.hypot(*(a - b).T)
    return apart


def longest_s(
    chain: Chain, targets: SkyTargets, limit_um: float = LIMIT_UM, fibre: str | None = None
) -> float:
    """The longest exposure whose guided drift stays below a limit.

    Parameters
    ----------
    chain : Chain
        At its middle.
    targets : SkyTargets
        n targets.
    limit_um : float
        For the largest of them, um.
    fibre : str, optional
        For which they are placed; their own when left out.

    Returns
    -------
    float
        s, to 1 %; from 10 s to six hours, and less where the field sets.

    Raises
    ------
    InputError
        A limit that is not above 0.
    """
    if not limit_um > 0.0:
        raise InputError(f"limit {limit_um:g} um: must be above 0")

    def within(exposure_s: float) -> bool:
        try:
            return drift(chain, targets, exposure_s, fibre).largest_um[1] <= limit_um
        except InputError:  # the field is below the horizon by then
            return False

    low, high = _SHORTEST_S, _LONGEST_S
    if within(high):
        return high
    while high / low > 1.01:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if within(middle) else (low, middle)
    return low


def guide_stars(chain: Chain, share: float = 1.0) -> SkyTargets:
    """Stars at the guide wavelength: four about each of six places at the edge of the field, deg.

    `share` of the field's radius at which these places are, a ratio.
    """
    edge_deg = share * chain.optics(chain.guide_A)[1]
    around = np.radians(_FIRST_DEG + 360.0 / GUIDE_PLACES * np.arange(GUIDE_PLACES))
    step = _STARS_DEG * edge_deg * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    offsets = edge_deg * np.column_stack([np.cos(around), np.sin(around)])
    return beside(chain, (offsets[:, None] + step).reshape(-1, 2), chain.guide_A)


def field_grid(chain: Chain, rings: Sequence[float] = (0.0, 0.5, 1.0), n: int = 24) -> SkyTargets:
    """Places all over the field, without a fibre: rings at shares of its radius (ratios), `n` on each."""
    _, edge_deg = chain.optics(chain.guide_A)
    around = 2.0 * np.pi * np.arange(n) / n
    ring = np.column_stack([np.cos(around), np.sin(around)])
    return beside(chain, edge_deg * np.concatenate([share * ring for share in rings]))


def beside(chain: Chain, offset_deg: Floats, wavelength_A: float = np.nan) -> SkyTargets:
    """Targets (n, 2) deg to the east and north of the centre of the field, on great circles.

    `wavelength_A`: A, of all.
    """
    p = chain.pointing
    distance, toward = np.radians(np.hypot(*offset_deg.T)), np.arctan2(*offset_deg.T)
    dec0 = np.radians(p.dec_deg)
    sin_dec = np.sin(dec0) * np.cos(distance) + np.cos(dec0) * np.sin(distance) * np.cos(toward)
    across = np.sin(toward) * np.sin(distance)
    north = np.cos(dec0) * np.cos(distance) - np.sin(dec0) * np.sin(distance) * np.cos(toward)
    ra = p.ra_deg + np.degrees(np.arctan2(across, north))
    names = np.arange(len(ra)).astype(np.str_)
    dec = np.degrees(np.arcsin(np.clip(sin_dec, -1.0, 1.0)))
    return SkyTargets(names, ra % 360.0, dec, wavelength_A=np.full(len(ra), wavelength_A))
