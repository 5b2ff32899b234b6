"""Guide stars in an observation: where the telescope points, before each exposure.

Stars of the list, or those that the guide cameras have of their own, are looked at after the blind move. What
they tell, offset, rotation and scale, moves the goals of the fibres: the next correction goes there.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fiberloom.assignment import Assignment
from fiberloom.errors import InputError
from fiberloom.hardware import Guider
from fiberloom.instruments import FocalPlane
from fiberloom.operation.move import Goals
from fiberloom.operation.series.reach import to_the_end
from fiberloom.operation.series.steps import followed
from fiberloom.report.tables import guide_line
from fiberloom.sky.chain import Chain
from fiberloom.sky.guiding import FieldOffset, GuideFit, fit_guiding
from fiberloom.sky.on_sky import OnSky
from fiberloom.sky.pointed import guide_report, offset_report
from fiberloom.sky.sky_targets import SkyTargets
from fiberloom.typing import Flags, Floats

IMAGES = 4
"""Of the guide cameras, whose mean is fitted."""
FARTHEST_MM = 0.5
"""So far corrections take a fibre at most: a telescope that is further off is to be pointed anew."""
MOST_CHI2 = 25.0
"""Per degree of freedom: stars that are five times as far from the fit as they are known do not agree."""
FEWEST_SHARE = 0.5
"""Of the stars that are seen, which must agree."""


@dataclass(frozen=True, eq=False)
class Guided:
    """What guide stars have told before an exposure."""

    exposure: int
    """From 1."""
    chain: Chain
    """For which they were predicted."""
    stars: SkyTargets
    seen: Flags
    """(n,) stars that were seen."""
    star_um: float
    """Error of the place of a star, um per axis, as the guider tells."""
    fit: GuideFit | None
    why_not: str = ""
    """Why nothing is applied; empty: the fit is."""
    truth: FieldOffset | None = None
    """Of a twin."""
    out_of_reach: tuple[int, ...] = ()
    """Positioners whose targets are out of reach now."""

    @property
    def applied(self) -> GuideFit | None:
        """What moves the goals."""
        return None if self.why_not else self.fit

    @property
    def text(self) -> str:
        """For the record and the operator."""
        return guide_line(self.about())

    def about(self) -> dict[str, Any]:
        """For result files."""
        names = self.stars.target_id
        told: dict[str, Any] = {"exposure": self.exposure, "applied": not self.why_not}
        told |= {"why_not": self.why_not, "seen": int(self.seen.sum()), "stars": len(names)}
        told |= {"not_seen": names[~self.seen].tolist()}
        if self.fit is not None:
            told |= guide_report(self.chain, self.fit) | self._quality(self.fit)
        if self.out_of_reach:
            told["out_of_reach"] = list(self.out_of_reach)
        if self.truth is not None:
            told["truth"] = offset_report(self.chain, self.truth)
        return told

    def _quality(self, fit: GuideFit) -> dict[str, Any]:
        left_out = self.stars.target_id[self.seen & ~fit.used].tolist()
        chi2 = fit.chi2(self.star_um)
        return {"stars": len(self.seen), "left_out": left_out, "chi2": chi2, "freedom": fit.freedom}


@dataclass
class Guiding:
    """Looks at guide stars, and moves goals by what they tell."""

    guider: Guider
    sky: OnSky
    plane: FocalPlane
    """Of N positioners."""
    assignment: Assignment
    found: list[Guided] = field(default_factory=list)

    @classmethod
    def of(
        cls, guider: Guider | None, sky: OnSky | None, plane: FocalPlane, assignment: Assignment
    ) -> Guiding | None:
        """None where there is nothing to look with, or at.

        `guider`: of the hardware; `sky`: of the list; `plane`: N positioners with their `assignment`.
        """
        if guider is None or sky is None:
            return None
        if sky.guides is None and guider.stars(sky.chain) is None:
            return None
        return cls(guider, sky, plane, assignment)

    def look(self, number: int) -> Guided:
        """The guide stars before exposure `number`, from 0, at the places of its middle."""
        chain = self.sky.then(number * self.sky.field.cadence_s)
        stars = self.sky.guides or self.guider.stars(chain)
        assert stars is not None
        images_mm = np.array([self.guider.look(stars, chain) for _ in range(IMAGES)])
        seen = np.isfinite(images_mm).all(axis=(0, 2))
        seen_mm = np.where(seen[:, None], images_mm.mean(axis=0), np.nan)
        star_um = self.guider.star_um(chain) / float(np.sqrt(IMAGES))
        found = Guided(number + 1, chain, stars, seen, star_um, None, truth=self.guider.truth(chain))
        self.found.append(self._judged(found, seen_mm))
        return self.found[-1]

    def left_alone(self, why: str) -> Guided:
        """The last look, not applied; `why`: for the operator."""
        self.found[-1] = replace(self.found[-1], why_not=self.found[-1].why_not or why)
        return self.found[-1]

    def _judged(self, found: Guided, seen_mm: Floats) -> Guided:
        """With the fit, and why it is not applied."""
        try:
            fit = fit_guiding(found.chain.place(found.stars).xy_mm, seen_mm)
        except InputError as error:
            return replace(found, why_not=str(error).removeprefix("guiding: "))
        return replace(found, fit=fit, why_not=_doubt(found, fit) or self._too_far(fit))

    def _too_far(self, fit: GuideFit) -> str:
        places_mm = self._places_mm(0)
        farthest_mm = float(np.nanmax(np.hypot(*(fit.applied(places_mm) - places_mm).T), initial=0.0))
        if farthest_mm <= FARTHEST_MM:
            return ""
        return (
            f"the telescope points off by {farthest_mm:.1f} mm at a fibre, corrections take "
            f"{FARTHEST_MM:g} mm; point it anew"
        )

    def _places_mm(self, number: int) -> Floats:
        """(N, 2) where targets are in an exposure, on a telescope that points as it should."""
        after_s = number * self.sky.field.cadence_s
        return self.sky.places_mm(self.assignment.target, self.assignment.fibre, after_s)

    def truly(self, goals: Goals, number: int) -> Goals:
        """The `goals` with where their stars are in truth, where that is known; `number` of the exposure."""
        truth = self.guider.truth(self.sky.then(number * self.sky.field.cadence_s))
        return goals if truth is None else replace(goals, star_mm=truth.applied(self._places_mm(number)))

    def aimed(self, goals: Goals, found: Guided) -> Goals:
        """The `goals` where the stars of an exposure are, by what was `found`."""
        number = found.exposure - 1
        goals = self.truly(goals, number)
        if (fit := found.applied) is None:
            return replace(goals, pointed=None)
        target_mm = fit.applied(self._places_mm(number))
        shift_mm = target_mm - self._places_mm(0)
        angles_deg = followed(self.plane, self.assignment, shift_mm)
        reached = to_the_end(self.plane, self.assignment, shift_mm, angles_deg)
        short = (reached.short_mm != 0.0).any(axis=1)
        self.found[number] = replace(found, out_of_reach=tuple(self.plane.positioner_id[short].tolist()))
        return replace(goals.gone(target_mm, reached.angles_deg, reached.short_mm), pointed=fit)

    def about(self) -> list[dict[str, Any]]:
        """For result files: each look."""
        return [one.about() for one in self.found]


def _doubt(found: Guided, fit: GuideFit) -> str:
    """Why a fit is not believed; empty where it is."""
    used, seen = int(fit.used.sum()), int(found.seen.sum())
    if used < FEWEST_SHARE * seen:
        return f"only {used} of {seen} guide stars agree; check that the list is of this field"
    if fit.freedom > 0 and (chi2 := fit.chi2(found.star_um) / fit.freedom) > MOST_CHI2:
        return (
            f"guide stars do not agree: they are {found.star_um * np.sqrt(chi2):.0f} um from the fit, and "
            f"known to {found.star_um:.1f} um; check that the list is of this field"
        )
    return ""
