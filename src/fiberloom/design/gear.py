"""The reduction ratio: accurate enough, and fast enough (Kronig 2020, Section 2 and Table 1)."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from fiberloom.design.lattice import Lattice
from fiberloom.errors import InputError
from fiberloom.instruments import AXES, Instrument, generate
from fiberloom.instruments.axis import Axis
from fiberloom.planning import bound_s, plan, random_pair
from fiberloom.units import DEG_PER_RAD, GEAR, MM_PER_UM, UM_PER_MM, deg_s_to_rpm

MOTOR_ERROR_DEG = 5.0
"""Of a controlled motor (Kronig 2020, Section 2)."""


@dataclass(frozen=True)
class GearWindow:
    """One axis: the ratios that suit, and the one that it has."""

    axis: str
    lever_mm: float
    """The longest, of the fibre about the axis."""
    requirement_um: float
    output_deg: float
    """Angle that uses up the requirement at that lever."""
    ratio: float
    """Motor turns per output turn, as the instrument has it."""
    least: float
    """From here on the motor's error is within the requirement."""
    most: float
    """Up to here the largest way takes no longer than is allowed; infinite where no time is asked for."""
    motor_deg_um: float
    """Motor degrees to a micrometre at the lever."""
    step_um: float
    """Smallest step of the motor at the lever; 0: continuous."""
    play_um: float
    """Largest backlash at the lever, which no ratio divides."""
    motor_rpm: float
    """At the axis' speed."""
    range_s: float
    """For the whole range, from rest to rest, at the axis' speed and acceleration."""

    needed_rpm: float
    """Of the motor, to make the range in time by this ratio; 0 where no time is asked for."""
    geared: bool = True
    """Has the motor a ratio to be held against the window? A piezo turns its arm itself."""

    @property
    def fits(self) -> bool:
        """Is the ratio in the window? True without one: `geared`."""
        return not self.geared or self.least <= self.ratio <= self.most

    def advice(self) -> str:
        """What would help, with numbers; or that it fits."""
        if not self.geared:
            return "no gear: images correct what the motor makes of a way"
        if self.fits:
            return "fits"
        if self.least > self.most:
            faster = self.needed_rpm * self.least / self.ratio
            return (
                f"no window: {self.least} or more for {self.requirement_um:g} um, {self.most:.0f} or less "
                f"for the time; a motor of {faster:.0f} rpm opens it"
            )
        if self.ratio < self.least:
            return f"a gear of {self.least} or more, for {self.requirement_um:g} um"
        return f"a gear of {self.most:.0f} or less, or a motor of {self.needed_rpm:.0f} rpm"


def gear_verdict(windows: Sequence[GearWindow]) -> str:
    """Of both axes, for titles; `windows`: of alpha and beta."""
    if not any(one.geared for one in windows):
        return "no gear to be held against a window"
    outside = [one.axis for one in windows if not one.fits]
    return f"{' and '.join(outside)} outside the window" if outside else "both ratios are in their windows"


def twin_knows(axis: Axis) -> bool:
    """Does the twin draw motors such as that of an `axis`: friction, spring, errors?"""
    return axis.kind == "bldc" and axis.gear == GEAR


def output_deg(requirement_um: float, lever_mm: float) -> float:
    """Angle in deg that moves a fibre at a lever in mm by the requirement in um."""
    return DEG_PER_RAD * requirement_um * MM_PER_UM / lever_mm


def least_ratio(requirement_um: float, lever_mm: float, motor_error_deg: float = MOTOR_ERROR_DEG) -> int:
    """Motor turns per output turn from which a motor error in deg is within the requirement."""
    return math.ceil(motor_error_deg / output_deg(requirement_um, lever_mm))


def move_s(way_deg: float, speed_deg_s: float, acceleration_deg_s2: float) -> float:
    """Shortest time of a move from rest to rest: way/speed + speed/acceleration, or a triangle if short."""
    if way_deg < speed_deg_s**2 / acceleration_deg_s2:
        return 2.0 * math.sqrt(way_deg / acceleration_deg_s2)
    return way_deg / speed_deg_s + speed_deg_s / acceleration_deg_s2


def speed_for(way_deg: float, within_s: float, acceleration_deg_s2: float) -> float | None:
    """Lowest top speed in deg/s that makes the way in time; None: the acceleration is too small."""
    root = (acceleration_deg_s2 * within_s) ** 2 - 4.0 * acceleration_deg_s2 * way_deg
    if root < 0.0:
        return None
    return 0.5 * (acceleration_deg_s2 * within_s - math.sqrt(root))


def gear_window(
    instrument: Instrument,
    axis: int,
    motor_error_deg: float = MOTOR_ERROR_DEG,
    motor_rpm: float | None = None,
    within_s: float | None = None,
) -> GearWindow:
    """The window of an `axis` of an `instrument`, 0 alpha or 1 beta; `motor_error_deg` of a controlled motor.

    `motor_rpm`: what the motor can do, default what the axis' speed asks of it; `within_s`: time for the
    whole range.

    Raises
    ------
    InputError
        A motor error, speed or time that is not above 0, or a time that no ratio can keep: with the
        acceleration that would.
    """
    for name, value in (("motor error", motor_error_deg), ("motor rpm", motor_rpm), ("time", within_s)):
        if value is not None and not 0.0 < value < math.inf:
            raise InputError(f"gear: {name} {value:g}: must be above 0")
    own = (instrument.alpha, instrument.beta)[axis]
    lever_mm = _lever_mm(instrument, axis)
    requirement_um = instrument.operation.requirement_um
    tolerance_deg = output_deg(requirement_um, lever_mm)
    way_deg = own.target_range_deg[1] - own.target_range_deg[0]
    used_rpm = deg_s_to_rpm(own.speed_deg_s, own.gear)
    um_deg = lever_mm * UM_PER_MM / DEG_PER_RAD
    most = _most(AXES[axis], way_deg, within_s, own.acceleration_deg_s2, motor_rpm or used_rpm)
    return GearWindow(
        axis=AXES[axis],
        lever_mm=lever_mm,
        requirement_um=requirement_um,
        output_deg=tolerance_deg,
        ratio=own.gear,
        least=least_ratio(requirement_um, lever_mm, motor_error_deg),
        most=most,
        motor_deg_um=own.gear / um_deg,
        step_um=own.smallest_step_deg * um_deg,
        play_um=own.backlash_deg * um_deg,
        motor_rpm=used_rpm,
        range_s=move_s(way_deg, own.speed_deg_s, own.acceleration_deg_s2),
        needed_rpm=0.0 if math.isinf(most) else (motor_rpm or used_rpm) * own.gear / most,
        geared=own.kind != "piezo",
    )


def _most(axis: str, way_deg: float, within_s: float | None, acceleration: float, motor_rpm: float) -> float:
    if within_s is None:
        return math.inf
    speed_deg_s = speed_for(way_deg, within_s, acceleration)
    if speed_deg_s is None:
        raise InputError(
            f"{axis}: {way_deg:g} deg in {within_s:g} s at {acceleration:g} deg/s2: no ratio can, the least "
            f"time is {2.0 * math.sqrt(way_deg / acceleration):.2f} s; "
            f"{4.0 * way_deg / within_s**2:.1f} deg/s2 would do"
        )
    return 6.0 * motor_rpm / speed_deg_s


def _lever_mm(instrument: Instrument, axis: int) -> float:
    lattices = [Lattice.of(instrument, fibre) for fibre in instrument.science_fibres]
    return max(one.l_beta_mm if axis else one.reach_mm for one in lattices)


@dataclass(frozen=True)
class Reconfiguration:
    """Plans between random fields, as the planner makes them: means, with standard errors over the fields."""

    positioners: int
    fields: int
    motion_s: float
    motion_error_s: float
    over_least: float
    """Over the time of the longest way of one axis, approach included."""
    refused: float
    """Positioners of a field that do not arrive."""


def reconfiguration(instrument: Instrument, n: int, fields: int, seed: int = 0) -> Reconfiguration:
    """Time from field to field of the `n` inner positioners, planned and verified.

    `instrument`: whose motors follow trajectories; `fields`: pairs of random fields, drawn by `seed`.

    Raises
    ------
    InputError
        Fewer than two pairs, or motors that make ways of their own.
    """
    if fields < 2:
        raise InputError(f"gear: {fields} pairs of fields have no error; give 2 or more")
    other = [AXES[k] for k, axis in enumerate(instrument.axes) if axis.kind != "bldc" or not axis.closed_loop]
    if other:
        raise InputError(
            f"{instrument.name}: {other[0]} does not follow trajectories; its time is that of its own drive: "
            f"fiberloom observe --instrument {instrument.name}"
        )
    plane = generate(instrument, seed, n_positioners=min(n, instrument.layout.n_positioners))
    times, least, refused = [], [], 0
    for pair in range(fields):
        start_deg, goal_deg = random_pair(plane, seed=seed + pair)
        made = plan(plane, start_deg, goal_deg, seed=seed)
        times.append(made.duration_s)
        least.append(bound_s(plane, start_deg, goal_deg, refused=made.refused))
        refused += len(made.refused)
    return Reconfiguration(
        len(plane),
        fields,
        statistics.mean(times),
        statistics.stdev(times) / math.sqrt(fields),
        statistics.mean(times) / statistics.mean(least),
        refused / fields,
    )
