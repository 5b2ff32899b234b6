"""Targets with the field that places them: what a list in mm remembers of the sky."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fiberloom.sky.chain import Chain
from fiberloom.sky.drift import LIMIT_UM, SkyDrift, drift, guide_stars, longest_s
from fiberloom.sky.guiding import fit_guiding
from fiberloom.sky.sky_field import SkyField
from fiberloom.sky.sky_targets import SkyTargets
from fiberloom.typing import Array, Floats, Ints


@dataclass(frozen=True, eq=False)
class OnSky:
    """n targets, rows as in the list in mm."""

    targets: SkyTargets
    chain: Chain
    """At the moment for which fibres are placed."""
    field: SkyField
    guides: SkyTargets | None = None
    """Guide stars of the list; None: it has none."""

    def select(self, rows: Array) -> OnSky:
        """Some of the targets, by numbers or a mask (`rows`)."""
        return replace(self, targets=self.targets.select(rows))

    def asked(self, target: Ints, fibre: Array) -> SkyTargets:
        """(M,) targets that are taken, each asking for the fibre that takes it.

        `target` (N,): row of the target of each positioner, -1 for none; `fibre` (N,): its fibre.
        """
        has = target >= 0
        return replace(self.targets.select(target[has]), fibre=np.asarray(fibre)[has].astype(np.str_))

    def places_mm(self, target: Ints, fibre: Array, after_s: float = 0.0) -> Floats:
        """(N, 2) mm where the fibres of an assignment must be, some s after the moment of placing.

        `target` (N,): row of the target of each positioner, -1 for none (NaN); `fibre` (N,): its fibre;
        `after_s`: s.
        """
        xy = np.full((len(target), 2), np.nan)
        xy[target >= 0] = self.then(after_s).place(self.asked(target, fibre)).xy_mm
        return xy

    def guided_mm(self, target: Ints, fibre: Array, reference_s: float, after_s: float) -> Floats:
        """(N, 2) mm where targets are on a telescope that has guided since the guide stars were at rest.

        `target` (N,): row of the target of each positioner, -1 for none (NaN); `fibre` (N,): its fibre;
        `reference_s`: when offset, rotation and scale were 0, s after the moment of placing; `after_s`: the
        time asked for, s after it.
        """
        xy = self.places_mm(target, fibre, after_s)
        stars = guide_stars(self.chain)
        before, then = (self.then(t).place(stars).xy_mm for t in (reference_s, after_s))
        has = target >= 0
        xy[has] = fit_guiding(before, then).removed(xy[has])
        return xy

    def then(self, after_s: float) -> Chain:
        """The chain some s after the moment of placing."""
        return self.chain.at(self.chain.pointing.time.later(after_s)) if after_s else self.chain

    def about(self) -> dict[str, Any]:
        """The field, for result files."""
        chain, air = self.chain, self.chain.weather
        return {
            "ra_deg": chain.pointing.ra_deg,
            "dec_deg": chain.pointing.dec_deg,
            "position_angle_deg": chain.pointing.pa_deg,
            "placed_for_utc": chain.pointing.time.iso,
            "exposure_s": self.field.exposure_s,
            "site": chain.site.name,
            "airmass": chain.airmass,
            "scale": chain.view.scale,
            "pressure_hPa": air.pressure_hPa,
            "temperature_C": air.temperature_C,
            "humidity": air.humidity,
        }

    def drift_of(self, target: Ints, fibre: Array, exposure_s: float | None = None) -> SkyDrift:
        """What an exposure (s; the field's when left out) does to the targets of an assignment, um.

        `target` (N,): row of the target of each positioner, -1 for none; `fibre` (N,): its fibre.
        """
        seconds_s = self.field.exposure_s if exposure_s is None else exposure_s
        return drift(self.chain, self.asked(target, fibre), seconds_s)

    def drift_about(self, target: Ints, fibre: Array, limit_um: float = LIMIT_UM) -> dict[str, Any]:
        """The drift of an assignment, and when to re-position, for result files.

        `target` (N,): row of the target of each positioner, -1 for none; `fibre` (N,): its fibre; `limit_um`:
        what may be left after guiding.
        """
        if not (target >= 0).any():
            return {}
        plain, guided = self.drift_of(target, fibre).largest_um
        longest = longest_s(self.chain, self.asked(target, fibre), limit_um)
        return {
            "drift_um": plain,
            "drift_guided_um": guided,
            "drift_limit_um": limit_um,
            "reposition_every_s": longest,
        }
