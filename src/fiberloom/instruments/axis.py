"""One rotation axis, and the drive that turns both."""

from collections.abc import Iterable
from typing import Any, Literal, Self

from pydantic import model_validator

from fiberloom.instruments.table import Finite, NotNegative, Positive, Table
from fiberloom.units import GEAR

Range = tuple[Finite, Finite]
Protocol = Literal["sdssv", "desi", "pfs", "none"]

OVER_BACKLASH = 1.2
"""The shortest approach over the largest backlash. Where the slope of the gear is 0.15 too small, the worst
that acceptance lets pass, 1 / 0.85 of the backlash is needed at the output; gears of the twin need 1.16."""


class Axis(Table):
    """One rotation axis: how far it turns and what turns it."""

    target_range_deg: Range
    """Angles that targets may ask for."""
    hard_stop_deg: Range
    """Angles at which the mechanism ends."""
    kind: Literal["bldc", "stepper", "piezo"]
    gear: Positive
    """Motor turns per output turn (1 for a direct drive)."""
    closed_loop: bool
    """Does the motor know its own angle?"""
    step_deg: NotNegative = 0.0
    """Smallest step at the output, of which corrections are made; 0: continuous."""
    speed_deg_s: Positive
    acceleration_deg_s2: Positive
    backlash_deg: NotNegative = 0.0
    """Largest backlash at the output."""
    motor_torque_uNm: Positive | None = None
    """Of the motor at full voltage, nominal; identification of torques needs it."""
    motor_torque_tolerance: NotNegative = 0.03
    """Standard deviation of single motors about it, relative."""
    approach_deg: NotNegative = 0.0
    """Overshoot from which the last move comes, in the negative direction; 0: no such approach."""

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        for key in ("target_range_deg", "hard_stop_deg"):
            low, high = getattr(self, key)
            if not low < high:
                raise ValueError(f"{key} {[low, high]}: low must be below high")
        (low, high), (stop_low, stop_high) = self.target_range_deg, self.hard_stop_deg
        if low < stop_low or high + self.approach_deg > stop_high:
            raise ValueError(
                f"hard_stop_deg {[stop_low, stop_high]} must contain target_range_deg "
                f"{[low, high]} and the approach of {self.approach_deg} deg above it"
            )
        if 0 < self.approach_deg < self.backlash_deg:
            raise ValueError(f"approach_deg {self.approach_deg} must exceed backlash_deg {self.backlash_deg}")
        if high - low > 720.0:
            raise ValueError(f"target_range_deg {[low, high]}: more than two turns are not supported")
        return self

    @property
    def least_approach_deg(self) -> float:
        """The shortest approach that still closes the largest backlash; never above the usual one.

        Where no backlash is known, no approach may be shortened.
        """
        if self.backlash_deg == 0.0:
            return self.approach_deg
        return min(self.approach_deg, OVER_BACKLASH * self.backlash_deg)


class Drive(Table):
    """What commands the motors."""

    protocol: Protocol = "none"
    """Whose frames positioners understand; none: there is no bus for them here."""


def protocol_of(axes: Iterable[Any]) -> Protocol:
    """The protocol of axes that name none: "sdssv" where all are motors of its kind, else "none"."""
    wanted = {"kind": "bldc", "closed_loop": True, "gear": GEAR}
    alike = all(isinstance(a, dict) and all(a.get(k) == v for k, v in wanted.items()) for a in axes)
    return "sdssv" if alike else "none"
