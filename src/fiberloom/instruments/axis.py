"""How far an axis turns and what turns it: of an instrument, and ranges of single units."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from fiberloom.errors import InputError
from fiberloom.instruments.table import Finite, NotNegative, Positive, Table
from fiberloom.typing import Floats, Ints
from fiberloom.units import AXES, GEAR

Range = tuple[Finite, Finite]
Protocol = Literal["sdssv", "desi", "pfs", "megara", "moons", "lamost", "none"]

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
    steps_per_turn: Positive | None = None
    """Steps of the motor a turn of it; None: it has none, or nothing counts them."""
    step_deg: NotNegative = 0.0
    """Smallest step at the output; 0: by `steps_per_turn`, or continuous."""
    speed_deg_s: Positive
    acceleration_deg_s2: Positive
    backlash_deg: NotNegative = 0.0
    """Largest backlash at the output."""
    motor_torque_uNm: Positive | None = None
    """Of the motor at full voltage, nominal; identification of torques needs it."""
    motor_torque_tolerance: NotNegative = 0.03
    """Standard deviation of single motors about it, relative."""
    approach_deg: Finite = 0.0
    """Overshoot from which the last move comes: above 0 from above, in the negative direction; below 0 from
    below; 0: no such approach."""

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        for key in ("target_range_deg", "hard_stop_deg"):
            low, high = getattr(self, key)
            if not low < high:
                raise ValueError(f"{key} {[low, high]}: low must be below high")
        (low, high), (stop_low, stop_high) = self.target_range_deg, self.hard_stop_deg
        if low + min(self.approach_deg, 0.0) < stop_low or high + max(self.approach_deg, 0.0) > stop_high:
            where = "below" if self.approach_deg < 0.0 else "above"
            raise ValueError(
                f"hard_stop_deg {[stop_low, stop_high]} must contain target_range_deg "
                f"{[low, high]} and the approach of {abs(self.approach_deg)} deg {where} it"
            )
        if 0 < abs(self.approach_deg) < self.backlash_deg:
            raise ValueError(f"approach_deg {self.approach_deg} must exceed backlash_deg {self.backlash_deg}")
        if high - low > 720.0:
            raise ValueError(f"target_range_deg {[low, high]}: more than two turns are not supported")
        return self

    @property
    def least_approach_deg(self) -> float:
        """The shortest approach that still closes the largest backlash, without its sign; never above the
        usual one.

        Where no backlash is known, no approach may be shortened.
        """
        if self.backlash_deg == 0.0:
            return abs(self.approach_deg)
        return min(abs(self.approach_deg), OVER_BACKLASH * self.backlash_deg)

    @property
    def smallest_step_deg(self) -> float:
        """At the output, of which corrections are made; 0: continuous."""
        if self.step_deg > 0.0 or self.steps_per_turn is None:
            return self.step_deg
        return 360.0 / (self.steps_per_turn * self.gear)

    @property
    def side(self) -> float:
        """From which side of its goal it comes: 1 from above, -1 from below, dimensionless."""
        return -1.0 if self.approach_deg < 0.0 else 1.0


@dataclass(frozen=True, eq=False)
class Ranges:
    """How far the axes of N single positioners turn, deg.

    Raises
    ------
    InputError
        Numbers that are not finite, a range whose low end is not below the high one, or targets beyond stops.
    """

    targets_deg: Floats
    """(N, 2, 2): of alpha and beta the lowest and the highest angle that targets may ask for."""
    stops_deg: Floats
    """(N, 2, 2): where the mechanism ends."""

    def __post_init__(self) -> None:
        low, high = np.moveaxis(self.targets_deg, -1, 0)
        stop_low, stop_high = np.moveaxis(self.stops_deg, -1, 0)
        good = (stop_low <= low) & (low < high) & (high <= stop_high)  # False where one is not a number
        for row, axis in np.argwhere(~(good & np.isfinite(stop_high - stop_low)))[:1]:
            raise InputError(
                f"ranges: row {row}, {AXES[axis]}: targets {self.targets_deg[row, axis].tolist()} must rise "
                f"and lie within the stops {self.stops_deg[row, axis].tolist()} deg"
            )

    def select(self, rows: Ints) -> "Ranges":
        """Of some positioners, by row."""
        return Ranges(self.targets_deg[rows], self.stops_deg[rows])

    @property
    def arrays(self) -> dict[str, Floats]:
        """Both by name."""
        return {"targets_deg": self.targets_deg, "stops_deg": self.stops_deg}


class DriveTable(Table):
    """What commands the motors, and how good their moves are. The defaults are those of SDSS-V."""

    protocol: Protocol = "none"
    """Whose frames positioners understand; none: there is no bus for them here."""
    blind_um: Positive = 10.0
    """Of a blind move, 2-D rms."""
    arrival_um: NotNegative = 0.2
    """Scatter of arrivals at the same command, 2-D rms."""
    place_um: NotNegative = 6.0
    """What a fibre is off that no offset of its angles explains: lengths of the arms, the camera's frame.
    On the twin 6 and 10 um do as well, with arms that are calibrated and with arms of a table."""
    drift_um: NotNegative = 0.0
    """By which the offset of an arm changes from move to move, 2-D rms."""
    slope: NotNegative = 0.1
    """By which it changes over the way of a correction, as a share of that way, rms: the derivative of what
    the transmission map does not know. SDSS-V accepts gears up to 0.15."""
    astray_mm: Positive = 0.5
    """Beyond this from where it is believed after a move, a positioner is not there: a blind move misses by
    tens of micrometres; half a millimetre is no error of calibration."""
    astray_share: NotNegative = 0.0
    """Of its way, added to that."""
    still_share: Annotated[float, Field(gt=0, lt=1)] = 0.05
    """A positioner that moved less than this share of the way asked for did not move."""
    scatter_mm: Positive = 0.05
    """Of healthy positioners about where they are believed to be, per coordinate: maps and image together."""
    allowed_mm: Positive = 0.5
    """How far an arm may be from where it is believed, anywhere in its range, to be let move. The collision
    buffer of two arms leaves twice that between the bodies of SDSS-V (2.0 mm of 1.5 mm bodies)."""

    @property
    def by_maps(self) -> bool:
        """Whether the host turns arm angles into motor angles by transmission maps."""
        return self.protocol in ("sdssv", "none")


def protocol_of(axes: Iterable[Any]) -> Protocol:
    """The protocol where none is named: "sdssv" for tables of axes that are its motors, else "none"."""
    wanted = {"kind": "bldc", "closed_loop": True, "gear": GEAR}
    alike = (isinstance(a, dict) and wanted.items() <= {k: a.get(k) for k in wanted}.items() for a in axes)
    return "sdssv" if all(alike) else "none"
