"""Where fibres stand after a move: by their maps, and by every image since, as long as they rest."""

from __future__ import annotations

import numpy as np
from scipy.special import erfc

from fiberloom.drive.desi.maps.learned import LearnedMaps
from fiberloom.typing import Flags, Floats
from fiberloom.units import UM_PER_MM

SURE_SIGMA = 3.0
"""[A] One rests whose place keeps the requirement by so many sigma of an axis."""


class StandingPlaces:
    """Places of N fibres, and how well these are known.

    A map says where a move ends, but for the scatter of that move. This scatter does not change while an arm
    rests, so every image tells more of it; the next move draws another one.
    """

    def __init__(self, maps: LearnedMaps) -> None:
        """`maps`: of N units, which tell where a move ends."""
        self._maps = maps
        self.xy_mm = np.full((len(maps.plane), 2), np.nan)
        """(N, 2) of fibres in the focal plane; NaN where no image has shown one since the begin."""
        self.covariance_mm2 = np.full((len(maps.plane), 2, 2), np.nan)
        """(N, 2, 2)."""
        self.fresh = np.ones(len(maps.plane), dtype=bool)
        """(N,) that have moved since the last image of them."""

    def went(self, moved: Flags) -> None:
        """Those `moved` (N,) are elsewhere now."""
        self.fresh |= moved

    def see(self, xy_mm: Floats, sigma_mm: Floats | float, seen: Flags) -> None:
        """An image, before maps learn from it: `xy_mm` (N, 2), those `seen` (N,), `sigma_mm` per coordinate.

        A fibre that is where neither its map nor its rest can have it is believed to be where it is seen.
        """
        told = seen & np.isfinite(xy_mm).all(axis=1)
        noise = np.broadcast_to(np.asarray(sigma_mm) ** 2, (len(told),))[:, None, None] * np.eye(2)
        new = (self.fresh | ~np.isfinite(self.xy_mm).all(axis=1))[:, None]
        before = np.where(new, self._maps.expected_mm(), self.xy_mm)
        spread = np.where(new[..., None], self._maps.spread_mm2(), self.covariance_mm2)
        off = np.where(told[:, None], xy_mm - before, 0.0)
        inverse = np.linalg.inv(spread + noise)
        lost = np.einsum("nc,ncd,nd->n", off, inverse, off) > self._maps.GATE_SIGMA**2
        gain = np.where(lost[:, None, None], np.eye(2), spread @ inverse)
        after = np.where(lost[:, None, None], noise, spread - gain @ spread)
        self.xy_mm = np.where(told[:, None], before + np.einsum("ncd,nd->nc", gain, off), self.xy_mm)
        self.covariance_mm2 = np.where(told[:, None, None], after, self.covariance_mm2)
        self.fresh &= ~told

    def best_kept(self, goal_mm: Floats, within_um: float) -> Flags:
        """(N,) fibres that another move would less likely bring `within_um` of their goals (N, 2) in mm."""
        off_um, sigma_um = self._off_um(goal_mm)
        with np.errstate(invalid="ignore", divide="ignore"):
            beyond_now = 0.5 * erfc((within_um - off_um) / (np.sqrt(2.0) * sigma_um))
        moved_um2 = UM_PER_MM**2 * np.einsum("ncc->n", self._maps.spread_mm2())
        return np.asarray(~self.fresh & (beyond_now <= np.exp(-(within_um**2) / moved_um2)))

    def arrived(self, goal_mm: Floats, within_um: float) -> Flags:
        """(N,) fibres surely `within_um` of their goals (N, 2) in mm; none that no image has shown."""
        off_um, sigma_um = self._off_um(goal_mm)
        return np.asarray(~self.fresh & (off_um + SURE_SIGMA * sigma_um <= within_um))

    def _off_um(self, goal_mm: Floats) -> tuple[Floats, Floats]:
        """(N,) distances from goals (N, 2) in mm, and (N,) sigma of an axis of these, um."""
        off_um: Floats = UM_PER_MM * np.hypot(*(self.xy_mm - goal_mm).T)
        sigma_um: Floats = UM_PER_MM * np.sqrt(0.5 * np.einsum("ncc->n", self.covariance_mm2))
        return off_um, sigma_um
