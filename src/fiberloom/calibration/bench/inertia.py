"""The inertia that a motor has to turn, from steps of torque. Kronig 2020, Section 2.6, Fig. 14, Eq. 12.

Eq. 12 is the balance of momentum between two moments,

    integral of (T - c_tot w - c_coulomb sgn w - T_spring - T_cog) dt = J (w2 - w1),

and needs the speed, which a position sensor does not give. Integrated once more from any moment on it
does not:

    double integral of T = J theta + c_tot integral of theta + (c_coulomb sgn + T_spring) t^2/2
                           + double integral of T_cog + a + b t,

linear in all unknowns, a and b being what there was at the beginning. A step of torque tells J from c_tot;
both directions tell Coulomb friction from the spring. All pushes of a positioner are fitted together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.calibration.bench.bench import APPROACH_DEG, Operator, Progress, joined
from fiberloom.calibration.bench.estimate import (
    Estimate,
    Fit,
    Fitted,
    Residuals,
    estimate,
    least_squares,
    standard_errors,
)
from fiberloom.calibration.bench.torque import _HALF_TICK_S, TorqueScale
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.metrology import Camera
from fiberloom.typing import Flags, Floats
from fiberloom.units import TICK_S

SKIP_DEG = 130.0
"""Motor angle at the start of a push that does not count: how far a rotor at rest may have fallen back
inside the backlash (90 deg), and the blow when it closes."""
_LAG = 10
_LEAST_GAIN = 3.0
"""The speed must grow at least so many times from the first torque to the second."""


@dataclass(frozen=True)
class InertiaSettings:
    """Two torques, one after the other, as shares of the full voltage: 70 and 490 uNm for alpha."""

    low: float = 0.139
    high: float = 0.9725
    low_s: float = 0.1
    high_s: float = 0.03
    pushes: int = 6
    """Half of them upward."""

    def __post_init__(self) -> None:
        if self.pushes < 2:
            raise InputError(f"pushes = {self.pushes}: one in each direction at least")


@dataclass(frozen=True, eq=False)
class InertiaData:
    """K pushes of one axis of N positioners, sampled every tick."""

    axis: int
    voltage: Floats
    """(N, K, M) share of the full voltage during a tick, sign included; NaN beyond the push."""
    motor_deg: Floats
    """(N, K, M) motor angle at its start."""
    zero_deg: Floats
    """(N, K) motor angle of rotor angle zero."""
    trouble: list[str]
    period_s: float = TICK_S


@dataclass(frozen=True, eq=False)
class Inertia:
    """Estimates of one axis of N positioners."""

    axis: int
    inertia: Estimate
    """J of motor and gear, as the motor sees them."""
    drag: Estimate
    """c_tot from the same pushes: a check of the other way to it."""
    rise_s: Floats
    """(N,) from 10 to 90 % of the change of speed after the step; NaN where not seen."""
    speeds_rpm: Floats
    """(N, 2) before the step and at the end."""


def identify_inertia(data: InertiaData, scale: TorqueScale) -> Inertia:
    """Least squares of the twice integrated balance of momentum; vectorised over positioners.

    InputError when no positioner's data support it.
    """
    use = _pushing(data)
    design, right = _balance(data, use)
    flat = design.reshape(len(use), -1, design.shape[-1])
    fit = least_squares(flat, right.reshape(len(use), -1), lag=_LAG)
    speeds, rise_s = _speeds(data, use)
    reason = joined(data.trouble, _refusals(data, use, fit, speeds))
    full_Nm = np.broadcast_to(np.asarray(scale.full_uNm), len(use)) * 1e-6
    # how far the fitted rotor is from the measured one
    off_deg = np.rad2deg(fit.residuals / np.maximum(fit.value[:, :1], 1e-30))
    error = standard_errors(fit)

    def make(what: str, unit: str, column: int, factor: float) -> Estimate:
        value = fit.value[:, column] * full_Nm * factor
        fitted = Fitted(
            value,
            error[:, column] * full_Nm * factor,
            np.abs(value) * scale.relative_error,
            fit.freedom,
        )
        return estimate(f"{AXES[data.axis]} {what}", unit, fitted, Residuals(off_deg, "motor deg"), reason)

    return Inertia(
        data.axis,
        make("inertia", "kg m^2", 0, 1.0),
        make("drag", "uNm s/rad", 1, 1e6),
        rise_s,
        speeds,
    )


def _pushing(data: InertiaData) -> Flags:
    """(N, K, M) samples under voltage, after the blow of closing the backlash."""
    way = np.abs(data.motor_deg - data.motor_deg[..., :1])
    pushing: Flags = (way > SKIP_DEG) & (data.voltage != 0.0) & np.isfinite(data.voltage)
    return pushing


def _balance(data: InertiaData, use: Flags) -> tuple[Floats, Floats]:
    """Design (N, K, M, 8 + 2 K) and right side (N, K, M) in SI, torque in shares of the full one."""
    n, pushes, _ = use.shape
    dt = data.period_s
    theta = np.deg2rad(np.nan_to_num(data.motor_deg))
    phi = np.deg2rad(np.nan_to_num(data.motor_deg - data.zero_deg[..., None]))
    speed = np.gradient(theta, dt, axis=-1)
    torque = np.nan_to_num(data.voltage) * np.sinc(speed * _HALF_TICK_S / np.pi)
    time = np.arange(use.shape[-1]) * dt
    side = np.sign(np.nansum(data.voltage, axis=-1))[..., None]
    half_square = np.broadcast_to(0.5 * time**2, use.shape)
    columns = [
        theta - theta[..., :1],
        summed(theta - theta[..., :1], dt),
        half_square * side,
        half_square,
        *(summed(summed(wave(k * phi), dt), dt) for k in (2, 4) for wave in (np.sin, np.cos)),
    ]
    for k in range(pushes):
        mine = np.zeros((n, pushes, 1))
        mine[:, k] = 1.0
        columns += [np.broadcast_to(mine, use.shape), mine * time]
    right = summed(_held(torque, dt), dt)
    return np.stack(columns, axis=-1), np.where(use, right, np.nan)


def summed(values: Floats, dt: float) -> Floats:
    """Integral (..., M) up to each sample by trapezes.

    `values` (..., M) in rad, rad s or shares of a torque, `dt` s from one to the next.
    """
    out = np.zeros_like(values)
    out[..., 1:] = np.cumsum(0.5 * (values[..., 1:] + values[..., :-1]), axis=-1) * dt
    return out


def _held(values: Floats, dt: float) -> Floats:
    """Integral up to the start of each sample of what is held during samples."""
    out = np.zeros_like(values)
    out[..., 1:] = np.cumsum(values[..., :-1], axis=-1) * dt
    return out


def _speeds(data: InertiaData, use: Flags) -> tuple[Floats, Floats]:
    """Mean over pushes of the speeds before the step and at the end (rpm), and of the rise time."""
    n, pushes, _ = use.shape
    speeds, rise = np.full((n, pushes, 2), np.nan), np.full((n, pushes), np.nan)
    for row, k in np.ndindex(n, pushes):
        if use[row, k].sum() > 12:
            speeds[row, k], rise[row, k] = _rise(data.motor_deg[row, k], data.voltage[row, k], data.period_s)
    with np.errstate(invalid="ignore"):
        seen = np.maximum(np.isfinite(rise).sum(axis=1), 1)
        gone = ~np.isfinite(rise).any(axis=1)
        mean = np.nansum(speeds, axis=1) / np.maximum(np.isfinite(speeds).sum(axis=1), 1)
    return mean, np.where(gone, np.nan, np.nansum(rise, axis=1) / seen)


def _rise(motor_deg: Floats, voltage: Floats, dt: float) -> tuple[Floats, float]:
    level = np.abs(np.nan_to_num(voltage))
    on = np.flatnonzero(level > 0.0)
    step = int(on[np.argmax(np.diff(level[on], prepend=level[on[0]]))])
    last = int(on[-1])
    if level[on].max() == level[on[0]]:
        step = last  # no step at all: as fast before as at the end
    # speed over 2 ms: noise of the sensor 5 rpm
    speed = np.abs(motor_deg[4:] - motor_deg[:-4]) / (4.0 * dt * 6.0)
    before = float(speed[max(step - 14, 0) : max(step - 4, 1)].mean())
    end = float(speed[max(last - 10, 0) : max(last - 5, 1)].mean())
    rising = speed[max(step - 2, 0) : last - 4]
    if end < _LEAST_GAIN * max(before, 1.0):
        return np.array([before, end]), float("nan")
    passed = [int(np.argmax(rising >= before + share * (end - before))) for share in (0.1, 0.9)]
    return np.array([before, end]), (passed[1] - passed[0]) * dt


def _refusals(data: InertiaData, use: Flags, fit: Fit, speeds: Floats) -> list[str]:
    axis = AXES[data.axis]
    counted = use.sum(axis=(1, 2))
    sides = np.sign(np.nansum(data.voltage, axis=-1))
    out = []
    for row in range(len(use)):
        if counted[row] == 0:
            out.append(f"{axis} did not move when it was pushed")
        elif counted[row] < 20 * use.shape[1]:
            out.append(f"{axis}: {counted[row]} samples of motion in {use.shape[1]} pushes, too few")
        elif not ((sides[row] > 0).any() and (sides[row] < 0).any()):
            out.append(f"{axis} was pushed in one direction only: friction and spring look alike")
        elif not speeds[row, 1] > _LEAST_GAIN * speeds[row, 0]:
            out.append(f"{axis}: the step of torque raised its speed from {speeds[row, 0]:.0f} to "
                       f"{speeds[row, 1]:.0f} rpm only")  # fmt: skip
        elif fit.singular[row] or not fit.value[row, 0] > 0.0:
            out.append(f"{axis}: the pushes do not tell inertia and drag apart")
        else:
            out.append("")
    return out


async def measure_inertia(
    client: Client,
    camera: Camera | None,
    plane: FocalPlane,
    settings: InertiaSettings | None = None,
    progress: Progress | None = None,
) -> tuple[InertiaData, InertiaData]:
    """One axis after the other, all positioners of the `plane` at once, in the middle of the range.

    `client` of the bench; the `camera` is not needed; `settings`: how much is measured, defaults when
    None; `progress` is called with (steps done, steps in all).
    """
    settings = settings or InertiaSettings()
    operator = Operator(client, camera, plane, progress)
    operator.expect(2 * settings.pushes)
    await operator.prepare()
    middle = np.array([0.5 * (low + high) for low, high in plane.limits_deg])
    traces = [[await _push(operator, axis, middle, 1 - 2 * (k % 2), settings)
               for k in range(settings.pushes)] for axis in range(2)]  # fmt: skip
    return _data(0, traces[0], operator), _data(1, traces[1], operator)


async def _push(operator: Operator, axis: int, middle: Floats, side: int, settings: InertiaSettings) -> Push:
    await operator.goto(*(middle - side * APPROACH_DEG))
    await operator.goto(*middle)
    await operator.trace(TICK_S)
    await operator.push(axis, (side * settings.low, side * settings.high), (settings.low_s, settings.high_s))
    trace = await operator.take(axis)
    operator.step()
    return trace.motor_deg, trace.voltage, trace.zero_deg


Push = tuple[Floats, Floats, Floats]
"""Motor angle (N, M), share of the full voltage (N, M) and motor angle of rotor angle zero (N,) of a push."""


def stacked(pushes: list[Push]) -> Push:
    """Voltage (N, K, M), motor angle (N, K, M), zero (N, K) of K pushes, NaN beyond the end of each."""
    most = max(motor.shape[1] for motor, _, _ in pushes)

    def together(which: int) -> Floats:
        full = [np.pad(p[which], ((0, 0), (0, most - p[which].shape[1])), constant_values=np.nan)
                for p in pushes]  # fmt: skip
        return np.stack(full, axis=1)

    return together(1), together(0), np.stack([z for _, _, z in pushes], axis=1)


def _data(axis: int, pushes: list[Push], operator: Operator) -> InertiaData:
    return InertiaData(axis, *stacked(pushes), list(operator.trouble))
