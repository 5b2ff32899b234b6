"""What a full voltage is worth as torque, and what a trace tells about torque against motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.bus.trace import Trace
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.typing import Flags, Floats

AT_SPEED = 0.995
"""Share of the speed asked for from which a motor counts as running at it."""


@dataclass(frozen=True)
class TorqueScale:
    """Motor torque at full voltage, Eq. 19: (3/2)(lambda/R)(sqrt(3)/2) u_dc."""

    full_uNm: Floats | float
    """(N,) or one for all."""
    relative_error: Floats | float
    """Its standard error: every torque, and inertia, carries it."""


def data_sheet_scale(plane: FocalPlane, axis: int) -> TorqueScale:
    """The instrument's nominal motor; units differ from it by its tolerance."""
    motor = plane.instrument.axes[axis]
    if motor.motor_torque_uNm is None:
        raise InputError(
            f"{plane.instrument.name}: {AXES[axis]}.motor_torque_uNm is missing; torques need it "
            "(the motor's torque at full voltage)"
        )
    return TorqueScale(motor.motor_torque_uNm, motor.motor_torque_tolerance)


@dataclass(frozen=True, eq=False)
class Windows:
    """Stretches of time in which N motors turned: a row per positioner, NaN where nothing is known."""

    voltage: Floats
    """(N, M) mean share of the full voltage, as torque: what the field's lag took is taken off."""
    motor_deg: Floats
    """(N, M) motor angle in the middle."""
    rotor_deg: Floats
    """(N, M, 2) the rotor's own angle at both ends."""
    speed_rad_s: Floats
    """(N, M) mean."""

    def __getitem__(self, part: slice | Flags) -> Windows:
        return Windows(
            self.voltage[:, part], self.motor_deg[:, part], self.rotor_deg[:, part], self.speed_rad_s[:, part]
        )


def windows_of(trace: Trace, skip_deg: float, slowest_rpm: float) -> Windows:
    """The windows of one move, without those in which it may not yet have pushed the gear.

    skip_deg: motor angle from the start of the move that does not count, larger than the backlash and
    how far a rotor at rest may have fallen back. Windows slower than slowest_rpm do not count either:
    on a ramp the inertia would be taken for friction, and for a spring, since ramps are at the ends.
    """
    if trace.motor_deg.shape[1] < 2:
        return Windows(*(np.full((len(trace.zero_deg), 1, *more), np.nan) for more in ((), (), (2,), ())))
    start, end = trace.motor_deg[:, :-1], trace.motor_deg[:, 1:]
    speed = np.deg2rad(end - start) / trace.period_s
    way = np.abs(start - trace.motor_deg[:, :1])
    good = (way > skip_deg) & (np.abs(speed) > slowest_rpm * np.pi / 30.0)
    lag = np.sinc(speed * _HALF_TICK_S / np.pi)
    voltage = np.where(good, trace.voltage[:, :-1] * lag, np.nan)
    zero = trace.zero_deg[:, None]
    return Windows(voltage, 0.5 * (start + end), np.stack([start - zero, end - zero], axis=-1), speed)


_HALF_TICK_S = 0.25e-3
"""The field is constant for a tick while the rotor turns from half behind to half ahead of it: the
mean torque is sin(x)/x of the full one, x the angle of half a tick."""


def together(parts: list[Windows]) -> Windows:
    """One after the other."""
    return Windows(
        *(
            np.concatenate([getattr(p, name) for p in parts], axis=1)
            for name in ("voltage", "motor_deg", "rotor_deg", "speed_rad_s")
        )
    )


def mean_wave(rotor_deg: Floats, cycles: int) -> tuple[Floats, Floats]:
    """Means of sin and cos of `cycles` times the rotor's angle between its two ends (..., 2)."""
    first, last = np.deg2rad(rotor_deg[..., 0]) * cycles, np.deg2rad(rotor_deg[..., 1]) * cycles
    middle, half = 0.5 * (first + last), 0.5 * (last - first)
    share = np.sinc(half / np.pi)
    return share * np.sin(middle), share * np.cos(middle)
