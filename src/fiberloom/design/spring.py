"""The spring against backlash: it closes the play everywhere, and neither motor nor friction gives way to it.

At the output, over the whole range (Kronig 2020, Section 3.3): the load is less than the weakest torque of
the spring, and the strongest torque and the load together are less than the friction of the gear, n c_C.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.design.gear import twin_knows
from fiberloom.errors import InputError
from fiberloom.instruments import AXES, FocalPlane, Instrument, generate
from fiberloom.twin import draw_units
from fiberloom.twin.draw import firmware_truth
from fiberloom.typing import Floats
from fiberloom.units import GEAR, deg_to_rad

LOADS_MNM = (1.45, 0.12)
"""Assumed: 20 g at 7.4 mm about alpha, 1.5 g at 8 mm about beta, axes horizontal."""
FACTOR = 2.0
"""Assumed, for scatter and cold grease."""
UNITS = 500


@dataclass(frozen=True)
class SpringWindow:
    """One axis of N units; torques at the output in mNm."""

    axis: str
    range_deg: tuple[float, float]
    """From the lowest target to the highest and its approach."""
    ends_mNm: Floats
    """(N, 2) torque of the spring at both ends of the range."""
    friction_mNm: Floats
    """(N,) n c_C: what the gear holds."""
    motor_mNm: Floats
    """(N,) full motor torque times n."""
    load_mNm: float
    factor: float

    @property
    def weakest_mNm(self) -> Floats:
        """(N,) the spring's least over the range."""
        least: Floats = self.ends_mNm.min(axis=1)
        return least

    @property
    def strongest_mNm(self) -> Floats:
        """(N,) its most."""
        most: Floats = self.ends_mNm.max(axis=1)
        return most

    @property
    def closes(self) -> Floats:
        """(N,) weakest spring over the load: above 1 the play stays closed."""
        return self.weakest_mNm / self.load_mNm

    @property
    def holds(self) -> Floats:
        """(N,) friction over strongest spring and load: above 1 nothing is turned back."""
        return self.friction_mNm / (self.strongest_mNm + self.load_mNm)

    @property
    def turns(self) -> Floats:
        """(N,) full motor torque over friction, strongest spring and load: above 1 the motor turns all."""
        return self.motor_mNm / (self.friction_mNm + self.strongest_mNm + self.load_mNm)

    @property
    def low_mNm(self) -> float:
        """The spring must not be weaker anywhere."""
        return self.factor * self.load_mNm

    @property
    def high_mNm(self) -> float:
        """Nor stronger, median unit."""
        return float(np.median(self.friction_mNm)) / self.factor - self.load_mNm

    @property
    def good_share(self) -> float:
        """Of the units: every condition by the factor."""
        least = np.minimum(np.minimum(self.closes, self.holds), self.turns)
        return float((least >= self.factor).mean())

    @property
    def good_error(self) -> float:
        """Standard error of that share, by the number of units; not 0 where none or all are outside."""
        n = len(self.closes)
        share = (self.good_share * n + 1.0) / (n + 2.0)
        return float(np.sqrt(share * (1.0 - share) / n))

    def advice(self) -> str:
        """What is wrong for the median unit, with numbers, and what would help; or that it fits."""
        if self.high_mNm <= self.low_mNm:
            most = float(np.median(self.friction_mNm)) / self.factor / (1.0 + self.factor)
            return (
                f"no window: the spring must exceed {self.low_mNm:.2f} and stay below "
                f"{self.high_mNm:.2f} mNm; a load below {most:.2f} mNm, or more friction, opens it"
            )
        weak, strong = float(np.median(self.weakest_mNm)), float(np.median(self.strongest_mNm))
        wrong = []
        if weak < self.low_mNm:
            wrong.append(
                f"weakest {weak:.2f} mNm, {self.low_mNm:.2f} are needed: wind it {self._more():.0f} deg more"
            )
        if strong > self.high_mNm:
            wrong.append(f"strongest {strong:.2f} mNm, {self.high_mNm:.2f} at most: take a softer spring")
        return "; ".join(wrong) or "fits"

    def _more(self) -> float:
        """Degrees of preload that the weakest end lacks."""
        span_deg = self.range_deg[1] - self.range_deg[0]
        per_deg = float(np.median(self.strongest_mNm - self.weakest_mNm)) / span_deg
        return (self.low_mNm - float(np.median(self.weakest_mNm))) / per_deg if per_deg > 0.0 else np.inf


def spring_window(
    instrument: Instrument,
    axis: int,
    load_mNm: float | None = None,
    factor: float = FACTOR,
    seed: int = 0,
    n: int | None = None,
) -> SpringWindow:
    """The window of an `axis` of an `instrument`, 0 alpha or 1 beta, over `n` units of the twin drawn by
    `seed`; None: 500.

    `load_mNm`: largest outside torque, None: assumed; `factor`: margin asked for. Tables `[twin.alpha]`
    count.

    Raises
    ------
    InputError
        An axis without a gear that the twin knows, or numbers that are not above 0.
    """
    load_mNm = LOADS_MNM[axis] if load_mNm is None else load_mNm
    own = (instrument.alpha, instrument.beta)[axis]
    if not twin_knows(own):
        raise InputError(
            f"{instrument.name}: {AXES[axis]} is a {own.kind} of gear {own.gear:g}; springs and friction are "
            f"known of bldc motors of gear {GEAR:g}"
        )
    if not load_mNm > 0.0 or not factor >= 1.0:
        raise InputError(f"spring: load {load_mNm:g} mNm must be above 0, factor {factor:g} at least 1")
    return _of_units(
        generate(instrument, seed, n_positioners=min(n or UNITS, instrument.layout.n_positioners)),
        axis,
        load_mNm,
        factor,
        seed,
    )


def _of_units(plane: FocalPlane, axis: int, load_mNm: float, factor: float, seed: int) -> SpringWindow:
    own = (plane.instrument.alpha, plane.instrument.beta)[axis]
    low, high = own.target_range_deg
    ends_deg = (low + min(own.approach_deg, 0.0), high + max(own.approach_deg, 0.0))
    plant = draw_units(plane, seed).plant[:, axis]
    torque_Nm = plant["spring_rate"][:, None] * (plant["spring_free"][:, None] - deg_to_rad(ends_deg))
    told = [firmware_truth(one) for one in plant]
    coulomb_Nm, full_Nm = np.array([(t["coulomb"], t["torque_per_volt"] * t["u_dc"]) for t in told]).T
    return SpringWindow(
        axis=AXES[axis],
        range_deg=ends_deg,
        ends_mNm=1e3 * torque_Nm,
        friction_mNm=1e3 * own.gear * coulomb_Nm,
        motor_mNm=1e3 * own.gear * full_Nm,
        load_mNm=load_mNm,
        factor=factor,
    )
