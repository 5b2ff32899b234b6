"""The one module that converts units.

Public Python, files and command line speak mm, deg, um, s; `_core` speaks rad, mm, s; the wire
speaks integers. Everything that changes from one to another is here.

Wire (SDSS-V positioner protocol): positions are counts of the *motor* angle as seen at the output,
2**30 for one output turn of a linear gear; times are ticks of 0.5 ms.
"""

import math
from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.typing import Floats, Ints

DEG_PER_RAD = 180.0 / math.pi
RAD_PER_DEG = math.pi / 180.0
UM_PER_MM = 1000.0
MM_PER_UM = 1e-3

COUNTS_PER_TURN = 2**30
"""Position counts for one turn of the output (sdss/jaeger: constants of the trajectory)."""
COUNTS_PER_DEG = COUNTS_PER_TURN / 360.0
COUNTS_PER_MOTOR_TURN = 2**20
"""The firmware counts the motor so; a test compares this and TICK_S with `_core`."""
AXES: tuple[Literal["alpha"], Literal["beta"]] = ("alpha", "beta")
"""Names of the two axes, in the order of every array over axes."""

GEAR = COUNTS_PER_TURN / COUNTS_PER_MOTOR_TURN
"""Motor turns per output turn as the wire counts them. The gear of an instrument is that of its axes;
this is what firmware and twin drive, and they refuse another."""
TICK_S = 0.5e-3
"""Unit of time on the wire, and period of the firmware's control."""
TICKS_PER_S = 1.0 / TICK_S
RUN_UP_MOTOR_DEG = 840.0
"""Back and forth before a precise arrival, more than any backlash (Kronig 2020, Fig. 17); the
firmware's default and, rounded at the output, the approach of SDSS-V's preset: a test compares them."""


def deg_to_rad(angle_deg: ArrayLike) -> Floats:
    """Degrees to radians."""
    return np.asarray(angle_deg, dtype=np.float64) * RAD_PER_DEG


def rad_to_deg(angle_rad: ArrayLike) -> Floats:
    """Radians to degrees."""
    return np.asarray(angle_rad, dtype=np.float64) * DEG_PER_RAD


def mm_to_um(length_mm: ArrayLike) -> Floats:
    """Millimetres to micrometres."""
    return np.asarray(length_mm, dtype=np.float64) * UM_PER_MM


def um_to_mm(length_um: ArrayLike) -> Floats:
    """Micrometres to millimetres."""
    return np.asarray(length_um, dtype=np.float64) * MM_PER_UM


def deg_to_counts(wire_deg: ArrayLike) -> Ints:
    """Wire degrees to counts, rounded to the nearest (ties to even)."""
    return np.rint(np.asarray(wire_deg, dtype=np.float64) * COUNTS_PER_DEG).astype(np.int64)


def counts_to_deg(counts: ArrayLike) -> Floats:
    """Counts to wire degrees."""
    return np.asarray(counts, dtype=np.float64) / COUNTS_PER_DEG


def s_to_ticks(time_s: ArrayLike) -> Ints:
    """Seconds to ticks of 0.5 ms, rounded to the nearest (ties to even)."""
    return np.rint(np.asarray(time_s, dtype=np.float64) * TICKS_PER_S).astype(np.int64)


def ticks_to_s(ticks: ArrayLike) -> Floats:
    """Ticks of 0.5 ms to seconds."""
    return np.asarray(ticks, dtype=np.float64) * TICK_S


@overload
def rpm_to_deg_s(motor_rpm: float, gear: float) -> float: ...
@overload
def rpm_to_deg_s(motor_rpm: Floats, gear: float) -> Floats: ...
def rpm_to_deg_s(motor_rpm: float | Floats, gear: float) -> float | Floats:
    """Motor speed to output speed; `gear` is motor turns per output turn (2000 rpm: 11.7 deg/s)."""
    return motor_rpm * 6.0 / gear


@overload
def deg_s_to_rpm(output_deg_s: float, gear: float) -> float: ...
@overload
def deg_s_to_rpm(output_deg_s: Floats, gear: float) -> Floats: ...
def deg_s_to_rpm(output_deg_s: float | Floats, gear: float) -> float | Floats:
    """Output speed to motor speed; `gear` is motor turns per output turn."""
    return output_deg_s * gear / 6.0


@overload
def motor_to_output_deg(motor_deg: float, gear: float) -> float: ...
@overload
def motor_to_output_deg(motor_deg: Floats, gear: float) -> Floats: ...
def motor_to_output_deg(motor_deg: float | Floats, gear: float) -> float | Floats:
    """Motor degrees to degrees at the output of a linear gear."""
    return motor_deg / gear


def wrap_deg(angle_deg: ArrayLike) -> Floats:
    """The same direction in [-180, 180). For differences only: axes have limits and do not wrap."""
    return np.mod(np.asarray(angle_deg, dtype=np.float64) + 180.0, 360.0) - 180.0
