"""Which part of the drag is back-EMF and which is friction: a rotor coasts, its bridge open, then shorted.

A driven motor always feels both (Kronig 2020, Eq. 9, 15 to 17): c_tot = (3/2) lambda^2/R + c_viscous.
With the bridge open no current flows, and what slows the rotor is friction alone; shorted, the back-EMF
brakes too. In either case, without a voltage,

    J w' = -c_coulomb sgn w - T_spring - T_cog - c_viscous w - [shorted] (3/2) (lambda^2/R) w,

integrated twice as in `inertia`, so that positions are enough:

    -theta = (c_viscous/J) integral of theta + [shorted] ((3/2) (lambda^2/R)/J) integral of theta
             + (c_coulomb sgn + T_spring)/J t^2/2 + double integral of T_cog/J + a + b t,

a and b being what there was at the beginning of each coast. No torque is applied, so no scale of torques is
needed: ratios to the inertia are all that coasting can tell. The inertia of `inertia` makes torques of them,
with its error. A delta winding in which a third harmonic of the EMF drives a current round the loop brakes in
the open bridge too: that counts as viscous friction here.
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
    refuse_if_all,
    standard_errors,
)
from fiberloom.calibration.bench.inertia import Push, stacked, summed
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.metrology import Camera
from fiberloom.typing import Flags, Floats
from fiberloom.units import GEAR, TICK_S, motor_to_output_deg

SLOWEST_RPM = 150.0
"""A coast counts until shortly before this speed: below, cogging decides, and a rotor that has stopped falls
back."""
_FASTEST_RPM = 1500.0
"""It must begin at least so fast: over a fifth of that drag and Coulomb friction look alike."""
_SPAN = 4
"""Ticks over which a speed is taken: noise of the sensor 14 rpm."""
GOLDEN_DEG = 137.5
"""Motor degrees from the start of one coast to that of the next: no two begin alike."""
_GRACE = 4
"""Ticks: the rotor loses 40 rpm in each, the noise of a speed is 14."""
_LEAST = 6
"""Samples of a coast."""
_SEEN = 5.0
"""Standard errors by which the back-EMF must show."""
_CANNOT_OPEN = {f"refused ({code})" for code in ("UNKNOWN_COMMAND", "VALUE_OUT_OF_RANGE")}


@dataclass(frozen=True)
class CoastSettings:
    """How fast, how long, how often."""

    voltages: tuple[float, ...] = (0.9725, 0.35)
    """Shares of the full one with which the rotor is spun up, in turn: from 5400 and from 1800 rpm drag and
    Coulomb friction look different."""
    spin_s: float = 0.05
    coast_s: float = 0.08
    repeats: int = 4
    """Of four coasts: upward and downward, open and shorted."""

    def __post_init__(self) -> None:
        if self.repeats < 1:
            raise InputError(f"repeats = {self.repeats}: a coast in each direction and state at least")
        if not self.voltages or not all(0.0 < v <= 1.0 for v in self.voltages):
            raise InputError(f"voltages = {self.voltages}: shares of the full one, above 0 and up to 1")


@dataclass(frozen=True, eq=False)
class CoastData:
    """K coasts of one axis of N positioners, sampled every tick."""

    axis: int
    open_bridge: Flags
    """(K,) which coasts had the bridge open; the others were shorted."""
    voltage: Floats
    """(N, K, M) share of the full voltage during a tick, sign included; 0 while coasting; NaN beyond."""
    motor_deg: Floats
    """(N, K, M) motor angle at its start."""
    zero_deg: Floats
    """(N, K) motor angle of rotor angle zero."""
    trouble: list[str]
    period_s: float = TICK_S


@dataclass(frozen=True, eq=False)
class Coast:
    """Estimates of one axis of N positioners."""

    axis: int
    back_emf_rate: Estimate
    """(3/2) lambda^2/(R J)."""
    viscous_rate: Estimate
    """c_viscous/J."""
    coulomb_rate: Estimate
    """c_coulomb/J."""
    back_emf: Estimate
    """(3/2) lambda^2/R, with J from pushes."""
    viscous: Estimate
    """c_viscous of motor and gear, with J from pushes."""

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """All of them."""
        return self.back_emf_rate, self.viscous_rate, self.coulomb_rate, self.back_emf, self.viscous


def identify_coast(data: CoastData, inertia: Estimate) -> Coast:
    """Least squares of the twice integrated balance of momentum; vectorised over positioners.

    `data`: coasts of one axis; `inertia`: J of the same axis and positioners, kg m^2, with its error. The
    ratios to J do not use it, nor are they refused with it. InputError when no positioner's data support it.
    """
    if data.motor_deg.shape[-1] <= _SPAN:
        nothing = [f"{AXES[data.axis]} recorded nothing"] * len(data.trouble)
        refuse_if_all(f"{AXES[data.axis]} back-EMF drag", joined(data.trouble, nothing))
    use = _coasting(data)
    fit = _fit(data, use)
    error = standard_errors(fit)
    reason = joined(data.trouble, _refusals(data, use, fit, error))
    residuals = Residuals(np.rad2deg(fit.residuals), "motor deg")

    def rate(what: str, unit: str, column: int) -> Estimate:
        fitted = Fitted(fit.value[:, column], error[:, column], 0.0, fit.freedom)
        return estimate(f"{AXES[data.axis]} {what} over inertia", unit, fitted, residuals, reason)

    def torque(what: str, column: int) -> Estimate:
        whole_uNm = inertia.value * 1e6
        value = fit.value[:, column] * whole_uNm
        own = np.abs(value) * inertia.standard_error / inertia.value
        fitted = Fitted(value, error[:, column] * whole_uNm, own, fit.freedom)
        why = joined(reason, list(inertia.reason))
        return estimate(f"{AXES[data.axis]} {what}", "uNm s/rad", fitted, residuals, why)

    return Coast(
        data.axis,
        rate("back-EMF drag", "1/s", 1),
        rate("viscous friction", "1/s", 0),
        rate("Coulomb friction", "rad/s^2", 2),
        torque("back-EMF drag", 1),
        torque("viscous friction", 0),
    )


def _fit(data: CoastData, use: Flags) -> Fit:
    """Twice: errors of the sensor are integrated with the drag, and that is known after the first time.

    Calibrated hall sensors are off by waves of one and two cycles of the rotor; those are fitted, too.
    """
    balance, drag = _balance(data, use), np.zeros(use.shape[:2])
    turn = _rotor_rad(data)
    hall = np.stack([wave(k * turn) for k in (1, 2) for wave in (np.sin, np.cos)], axis=-1)
    for _ in range(2):
        rows = _whitened(balance, drag, data.period_s)
        design = np.concatenate([rows[..., :-1], hall], axis=-1)
        fit = least_squares(
            design.reshape(len(use), -1, design.shape[-1]),
            rows[..., -1].reshape(len(use), -1),
            used=use.reshape(len(use), -1),
        )
        drag = fit.value[:, :1] + fit.value[:, 1:2] * ~data.open_bridge
    return fit


def _whitened(rows: Floats, drag: Floats, dt: float) -> Floats:
    """The e of e + drag * (its integral) = `rows` (N, K, M, P), with `drag` (N, K) in 1/s.

    An error e of an angle stands in the equation once as it is, and once in the integral of theta.
    """
    out = np.empty_like(rows)
    d = drag[..., None]
    integral = np.zeros_like(rows[:, :, 0])
    out[:, :, 0] = rows[:, :, 0]
    for k in range(1, rows.shape[2]):
        integral += 0.5 * dt * out[:, :, k - 1]
        out[:, :, k] = (rows[:, :, k] - d * integral) / (1.0 + 0.5 * dt * d)
        integral += 0.5 * dt * out[:, :, k]
    return out


def _rotor_rad(data: CoastData) -> Floats:
    """(N, K, M) the rotor's own angle; 0 where nothing is known."""
    return np.deg2rad(np.nan_to_num(data.motor_deg) - np.nan_to_num(data.zero_deg)[..., None])


def _first(data: CoastData) -> Floats:
    """(N, K) index of the first sample without voltage after the spin."""
    samples = np.arange(1, data.voltage.shape[-1] + 1)
    driven = np.nan_to_num(data.voltage) != 0.0
    end = np.max(np.where(driven, samples, 0), axis=-1, initial=0)
    first: Floats = np.where(end > 0, end, data.voltage.shape[-1])
    return first


def _speeds_rpm(data: CoastData) -> Floats:
    """(N, K, M) size of the speed over the next _SPAN ticks, NaN at the end."""
    out = np.full_like(data.motor_deg, np.nan)
    way = data.motor_deg[..., _SPAN:] - data.motor_deg[..., :-_SPAN]
    out[..., : way.shape[-1]] = np.abs(way) / (_SPAN * data.period_s * 6.0)
    return out


def _coasting(data: CoastData) -> Flags:
    """(N, K, M) samples that count: from a tick after the drive ended until the rotor is slow."""
    index = np.arange(data.motor_deg.shape[-1])
    after = index > _first(data)[..., None]
    slow = after & ~(_speeds_rpm(data) > SLOWEST_RPM)
    ended = np.logical_or.accumulate(slow, axis=-1)
    # those whose own noise decided that the rotor was still fast do not count
    ended[..., :-_GRACE] |= ended[..., _GRACE:]
    return after & ~ended & np.isfinite(data.motor_deg)


def _balance(data: CoastData, use: Flags) -> Floats:
    """Columns (N, K, M, 9 + 2 K) in SI, torques over inertia; the last is the right side."""
    n, coasts, samples = use.shape
    dt = data.period_s
    first = np.argmax(use, axis=-1)[..., None]
    # integrals begin with the coast: what was before would drown what they tell
    time = np.maximum(np.arange(samples) - first, 0) * dt
    motor_deg = np.nan_to_num(data.motor_deg)
    theta = np.deg2rad(motor_deg - np.take_along_axis(motor_deg, first, axis=-1)) * (time > 0.0)
    phi = _rotor_rad(data)
    side = np.sign(np.nansum(data.voltage, axis=-1))[..., None]
    # trapezes of a decay by 0.11 a tick are 0.1 % short: Euler and Maclaurin's next term
    way = summed(theta, dt) - dt**2 / 12.0 * np.gradient(np.deg2rad(motor_deg), dt, axis=-1)
    half_square = 0.5 * time**2
    columns = [
        way,
        way * ~data.open_bridge[:, None],
        half_square * side,
        half_square,
        *(summed(summed(wave(k * phi) * (time > 0.0), dt), dt) for k in (2, 4) for wave in (np.sin, np.cos)),
    ]
    for k in range(coasts):
        mine = np.zeros((n, coasts, 1))
        mine[:, k] = 1.0
        columns += [mine * (time >= 0.0), mine * time]
    return np.stack([*columns, -theta], axis=-1)


def _refusals(data: CoastData, use: Flags, fit: Fit, error: Floats) -> list[str]:
    axis = AXES[data.axis]
    enough = use.sum(axis=-1) >= _LEAST
    fastest = np.nanmax(np.where(use, _speeds_rpm(data), 0.0), axis=(1, 2), initial=0.0)
    sides = np.sign(np.nansum(data.voltage, axis=-1))
    out = []
    for row, good in enumerate(enough):
        if not use[row].any():
            out.append(f"{axis} did not turn when it was spun up")
        elif fastest[row] < _FASTEST_RPM:
            out.append(f"{axis} coasted from {fastest[row]:.0f} rpm, {_FASTEST_RPM:.0f} needed")
        elif not (good & data.open_bridge).any() or not (good & ~data.open_bridge).any():
            out.append(f"{axis} did not coast both with the bridge open and shorted")
        elif not ((sides[row] > 0) & good).any() or not ((sides[row] < 0) & good).any():
            out.append(f"{axis} coasted in one direction only: friction and spring look alike")
        elif fit.singular[row]:
            out.append(f"{axis}: the coasts do not tell friction and drag apart")
        elif fit.value[row, 1] < _SEEN * error[row, 1]:
            out.append(f"{axis} slowed as much with its bridge open as shorted: does the board open it?")
        else:
            out.append("")
    return out


async def measure_coast(
    client: Client,
    camera: Camera | None,
    plane: FocalPlane,
    settings: CoastSettings | None = None,
    progress: Progress | None = None,
) -> tuple[CoastData, CoastData]:
    """One axis after the other, all positioners of the `plane` at once, in the middle of the range.

    `client` of the bench; the `camera` is not needed; `settings`: how much is measured, defaults when
    None; `progress` is called with (steps done, steps in all). A positioner whose board cannot open its
    bridges drops out.
    """
    settings = settings or CoastSettings()
    operator = Operator(client, camera, plane, progress)
    order = _order(settings)
    operator.expect(2 * len(order))
    await operator.prepare()
    middle = np.array([0.5 * (low + high) for low, high in plane.limits_deg])
    out = []
    for axis in range(2):
        coasts = [await _coast(operator, axis, middle, one, settings) for one in order]
        voltage, motor, zero = stacked(coasts)
        flags = np.array([one.open_bridge for one in order])
        out.append(CoastData(axis, flags, voltage, motor, zero, list(operator.trouble)))
    return out[0], out[1]


@dataclass(frozen=True)
class _Run:
    """One coast."""

    open_bridge: bool
    voltage: float
    """Of the spin, sign included."""
    away_deg: float
    """From the middle of the range, wire position."""


def _order(settings: CoastSettings) -> list[_Run]:
    """Each begins at another angle of the rotor, so that errors of the hall sensors differ."""
    out = []
    for k in range(4 * settings.repeats):
        voltage = settings.voltages[k // 4 % len(settings.voltages)] * (1.0, -1.0)[k % 2]
        out.append(_Run(k % 4 < 2, voltage, motor_to_output_deg(GOLDEN_DEG * k % 360.0, GEAR)))
    return out


async def _coast(operator: Operator, axis: int, middle: Floats, one: _Run, settings: CoastSettings) -> Push:
    start = middle + one.away_deg
    await operator.goto(*(start - np.sign(one.voltage) * APPROACH_DEG))
    await operator.goto(*start)
    await operator.trace(TICK_S)
    then = None if one.open_bridge else 0.0
    await operator.push(axis, (one.voltage, then), (settings.spin_s, settings.coast_s))
    if one.open_bridge:
        _say_what_cannot_open(operator)
    trace = await operator.take(axis)
    operator.step()
    return trace.motor_deg, trace.voltage, trace.zero_deg


def _say_what_cannot_open(operator: Operator) -> None:
    for row, why in enumerate(operator.trouble):
        if why in _CANNOT_OPEN:
            operator.trouble[row] = f"its board cannot open the bridge of a motor: {why}"
