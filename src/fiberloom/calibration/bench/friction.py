"""Coulomb friction, spring, cogging and drag of one axis. Kronig 2020, Section 2.4, Fig. 11 and 12.

With signed torques the torque that keeps a motor turning is (Eq. 8 and 9, EQUATIONS of the project)

    T = c_coulomb sgn(w) + c_tot w + T_spring(theta) + A sin(2 phi + p) [+ its second harmonic]

theta the output angle, phi the rotor's own, w its speed; c_tot is viscous friction and back-EMF. Eq. 11
is what least squares makes of it when a motor turn is covered evenly in both directions.

Two kinds of moves tell them apart: creeping over two motor turns at several output angles, up and down
(break-away torque and cogging), and running over the whole range at several speeds (drag, spring). The
paper raises the torque until the rotor starts; at creep speed the torque is the same but for drag, which
is fitted, and the rotor's inertia does not delay what is seen. A unit whose friction at rest is higher
than in motion (the model has no such term) shows the lower one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.calibration.bench.bench import APPROACH_DEG, BENCH_MARGIN_DEG, Operator, Progress, joined
from fiberloom.calibration.bench.estimate import (
    Estimate,
    Fit,
    Fitted,
    Residuals,
    estimate,
    least_squares,
    standard_errors,
)
from fiberloom.calibration.bench.torque import AT_SPEED, TorqueScale, Windows, mean_wave, together, windows_of
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.metrology import Camera
from fiberloom.typing import Floats
from fiberloom.units import GEAR

SKIP_DEG = 400.0
"""Motor angle at the start of a move that does not count: the largest backlash of Fig. 10 (250 motor
deg) and how far a rotor may fall back without current (90)."""
_LAG = 20
"""Windows over which residuals may go together: one motor turn of creep."""
_ENOUGH = 60
_PHASE_ERROR_RAD = 0.002
"""Of the rotor's angle, twice: hall sensors calibrated to a mrad."""


@dataclass(frozen=True)
class FrictionSettings:
    """How to drive."""

    n_angles: int = 5
    """Output angles at which to creep."""
    creep_rpm: float = 30.0
    creep_turns: float = 1.0
    """Motor turns of creep that count, beyond SKIP_DEG."""
    run_rpm: tuple[float, ...] = (500.0, 2000.0)
    run_span_deg: float | None = None
    """Around the middle of the range; None: all of it."""

    def __post_init__(self) -> None:
        if self.n_angles < 2:
            raise InputError(f"n_angles = {self.n_angles}: the spring's rate needs at least 2")
        if len(self.run_rpm) < 1 or min(self.run_rpm) < 2 * self.creep_rpm:
            raise InputError(f"run_rpm = {self.run_rpm}: drag needs a speed well above {self.creep_rpm} rpm")


@dataclass(frozen=True, eq=False)
class FrictionData:
    """What one axis of N positioners did. `segments`: one per move."""

    axis: int
    segments: tuple[Windows, ...]
    creep: tuple[bool, ...]
    """Which segments creep."""
    wire_deg: tuple[float, ...]
    """Where a segment was, its middle."""
    trouble: list[str]
    gear: float = GEAR


@dataclass(frozen=True, eq=False)
class Friction:
    """Estimates of one axis of N positioners."""

    axis: int
    coulomb: Estimate
    spring: Estimate
    """T_spring of Eq. 11 at output angle 0: negative, for the spring pushes towards positive angles."""
    spring_rate: Estimate
    """Its change per output degree."""
    cogging: Estimate
    """Amplitude, two cycles a motor turn."""
    cogging_phase: Estimate
    """p of sin(2 phi + p), phi the rotor's own angle."""
    drag: Estimate
    """c_tot, viscous friction and back-EMF."""
    fitted_uNm: Floats
    """(N, M) of the windows, in the order of the segments."""

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """All of them."""
        return (self.coulomb, self.spring, self.spring_rate, self.cogging, self.cogging_phase, self.drag)


def identify_friction(data: FrictionData, scale: TorqueScale) -> Friction:
    """Least squares over all windows; see the module. Vectorised over positioners.

    InputError when no positioner's data support it; a positioner whose own do not gets a reason.
    """
    windows = together(list(data.segments))
    design = _design(windows, data.gear)
    # in shares of the full voltage: the scale multiplies at the end, with its error
    fit = least_squares(design, windows.voltage, lag=_LAG)
    reason = joined(data.trouble, _refusals(data, windows, fit))
    return _estimates(data.axis, fit, np.asarray(scale.full_uNm), scale.relative_error, reason, design)


def _design(w: Windows, gear: float) -> Floats:
    """(N, M, 8): sgn, 1, output angle, speed, two cycles, four cycles."""
    ones = np.ones_like(w.voltage)
    columns = [np.sign(w.speed_rad_s), ones, w.motor_deg / gear, w.speed_rad_s]
    for cycles in (2, 4):
        columns += mean_wave(w.rotor_deg, cycles)
    return np.stack(columns, axis=-1)


def _refusals(data: FrictionData, windows: Windows, fit: Fit) -> list[str]:
    axis = AXES[data.axis]
    used = np.isfinite(fit.residuals)
    up = (used & (windows.speed_rad_s > 0)).sum(axis=1)
    down = (used & (windows.speed_rad_s < 0)).sum(axis=1)
    out = []
    for row in range(len(used)):
        n_up, n_down = int(up[row]), int(down[row])
        if n_up + n_down == 0:
            out.append(f"{axis} did not move while its torque was recorded")
        elif min(n_up, n_down) < _ENOUGH // 2:
            out.append(
                f"{axis}: {n_up} stretches upward and {n_down} downward, {_ENOUGH // 2} of each needed"
            )
        elif fit.singular[row]:
            out.append(f"{axis}: speeds and places too much alike to tell drag, spring and cogging apart")
        else:
            out.append("")
    return out


def _estimates(
    axis: int, fit: Fit, full_uNm: Floats, relative: Floats | float, reason: list[str], design: Floats
) -> Friction:
    full = np.broadcast_to(full_uNm, len(reason)).astype(np.float64)
    residuals = Residuals(fit.residuals * full[:, None], "uNm")
    error = standard_errors(fit)
    name = AXES[axis]

    def make(what: str, unit: str, value: Floats, scatter: Floats, systematic: Floats) -> Estimate:
        fitted = Fitted(value, scatter, systematic, fit.freedom)
        return estimate(f"{name} {what}", unit, fitted, residuals, reason)

    def torque(what: str, unit: str, column: int) -> Estimate:
        value = fit.value[:, column] * full
        return make(what, unit, value, error[:, column] * full, np.abs(value) * relative)

    a, b = fit.value[:, 4], fit.value[:, 5]
    size = np.maximum(np.hypot(a, b), 1e-12)
    along = np.stack([a / size, b / size], axis=1)
    across = np.stack([-b / size, a / size], axis=1) / size[:, None]
    part = fit.covariance[:, 4:6, 4:6]
    of_size, of_phase = (np.sqrt(np.einsum("ni,nij,nj->n", v, part, v)) for v in (along, across))
    return Friction(
        axis,
        torque("Coulomb friction", "uNm", 0),
        torque("spring at 0 deg", "uNm", 1),
        torque("spring rate", "uNm/deg", 2),
        make("cogging", "uNm", size * full, of_size * full, size * full * relative),
        make("cogging phase", "rad", np.arctan2(b, a), of_phase, np.full(len(a), _PHASE_ERROR_RAD)),
        torque("drag", "uNm s/rad", 3),
        np.einsum("nmp,np->nm", design, fit.value) * full[:, None],
    )


@dataclass(frozen=True)
class BreakAway:
    """Fig. 11 at one output angle of one positioner, by Eq. 11."""

    wire_deg: float
    rotor_deg: tuple[Floats, Floats]
    """Rotor's angle within its turn, upward and downward."""
    torque_uNm: tuple[Floats, Floats]
    """Signed, drag taken off."""
    spring_uNm: float
    coulomb_uNm: float


def break_away(data: FrictionData, friction: Friction, scale: TorqueScale, row: int) -> list[BreakAway]:
    """The curves of Fig. 11 in uNm, one for each output angle, with Eq. 11 applied to each by itself.

    `data`: the measurement of one axis; `friction`: what was identified from it; `scale`: torque at
    full voltage; `row`: the positioner.
    """
    full = float(np.broadcast_to(scale.full_uNm, len(data.trouble))[row])
    drag = friction.drag.of(row)[0]
    at: dict[float, dict[bool, tuple[Floats, Floats]]] = {}
    for segment, creep, wire in zip(data.segments, data.creep, data.wire_deg, strict=True):
        good = np.isfinite(segment.voltage[row])
        if not creep or not good.any():
            continue
        torque = segment.voltage[row, good] * full - drag * segment.speed_rad_s[row, good]
        angle = segment.rotor_deg[row, good].mean(axis=-1) % 360.0
        at.setdefault(wire, {})[bool(segment.speed_rad_s[row, good][0] > 0)] = (angle, torque)
    return [_eq_11(wire, curves[True], curves[False]) for wire, curves in at.items() if len(curves) == 2]


def _eq_11(wire: float, up: tuple[Floats, Floats], down: tuple[Floats, Floats]) -> BreakAway:
    plus, minus = _turn_mean(*up), _turn_mean(*down)
    spring = 0.5 * (plus + minus)
    return BreakAway(wire, (up[0], down[0]), (up[1], down[1]), spring, plus - spring)


def _turn_mean(rotor_deg: Floats, torque: Floats) -> float:
    """Mean over the turn, though the rotor spends more time where cogging slows it: Eq. 10."""
    waves = [np.ones_like(torque)]
    for cycles in (2, 4):
        turn = np.deg2rad(rotor_deg) * cycles
        waves += [np.sin(turn), np.cos(turn)]
    return float(np.linalg.lstsq(np.stack(waves, axis=1), torque, rcond=None)[0][0])


async def measure_friction(
    client: Client,
    camera: Camera | None,
    plane: FocalPlane,
    settings: FrictionSettings | None = None,
    progress: Progress | None = None,
) -> tuple[FrictionData, FrictionData]:
    """Both axes at the same time, all positioners of the `plane` at once.

    `client` of the bench; the `camera` is not needed; `settings`: how much is measured, defaults when
    None; `progress` is called with (steps done, steps in all).
    """
    settings = settings or FrictionSettings()
    operator = Operator(client, camera, plane, progress)
    operator.expect(2 * settings.n_angles + 2 * len(settings.run_rpm))
    await operator.prepare()
    await operator.margin(BENCH_MARGIN_DEG)
    books = _Books()
    for place in _places(plane, settings.n_angles):
        await _creep(operator, settings, place, books)
    for rpm in settings.run_rpm:
        await _run(operator, settings, rpm, books)
    await operator.margin(0)
    return books.data(0, operator.trouble, plane), books.data(1, operator.trouble, plane)


class _Books:
    """Segments of both axes."""

    def __init__(self) -> None:
        self.segments: list[tuple[Windows, Windows]] = []
        self.creep: list[bool] = []
        self.wire: list[tuple[float, float]] = []

    async def take(self, operator: Operator, rpm: float, creep: bool, wire: tuple[float, float]) -> None:
        traces = [await operator.take(axis) for axis in range(2)]
        # creeping, cogging makes it slower and faster
        slowest_rpm = (0.5 if creep else AT_SPEED) * rpm
        both = [windows_of(trace, SKIP_DEG, slowest_rpm) for trace in traces]
        self.segments.append((both[0], both[1]))
        self.creep.append(creep)
        self.wire.append(wire)
        operator.step()

    def data(self, axis: int, trouble: list[str], plane: FocalPlane) -> FrictionData:
        return FrictionData(
            axis,
            tuple(s[axis] for s in self.segments),
            tuple(self.creep),
            tuple(w[axis] for w in self.wire),
            list(trouble),
            plane.instrument.alpha.gear,
        )


def _range(plane: FocalPlane, axis: int, margin_deg: float) -> tuple[float, float]:
    """Wire positions that leave room for an approach at both ends, and for the wire's own zero."""
    low, high = plane.limits_deg[axis]
    stop_low, stop_high = plane.hard_stops_deg[axis]
    room = APPROACH_DEG + 1.0 + margin_deg
    return max(float(low), float(stop_low) + room), min(float(high), float(stop_high) - room)


def _places(plane: FocalPlane, n: int) -> list[tuple[float, float]]:
    ranges = [_range(plane, axis, 1.0) for axis in range(2)]
    # a tenth of the range away from its ends
    return [
        (float(a), float(b))
        for a, b in zip(*(np.linspace(0.9 * r[0] + 0.1 * r[1], 0.1 * r[0] + 0.9 * r[1], n) for r in ranges),
                        strict=True)
    ]  # fmt: skip


async def _creep(
    operator: Operator, settings: FrictionSettings, place: tuple[float, float], books: _Books
) -> None:
    way = (SKIP_DEG + 360.0 * settings.creep_turns + 40.0) / operator.plane.instrument.alpha.gear
    low, high = np.array(place) - 0.5 * way, np.array(place) + 0.5 * way
    period_s = 3.6 / (6.0 * settings.creep_rpm)  # 3.6 motor deg a window: a hundred in a turn
    for begin, end, side in ((low, high, -1.0), (high, low, 1.0)):
        await operator.speed(2000, 2000)
        await operator.goto(*(begin + side * APPROACH_DEG))
        await operator.goto(*begin)
        await operator.speed(settings.creep_rpm, settings.creep_rpm)
        await operator.trace(period_s)
        await operator.goto(*end)
        await books.take(operator, settings.creep_rpm, True, place)


async def _run(operator: Operator, settings: FrictionSettings, rpm: float, books: _Books) -> None:
    low, high = (np.array(ends) for ends in zip(*(_span(operator.plane, k, settings) for k in range(2)),
                                                strict=True))  # fmt: skip
    await operator.speed(2000, 2000)
    await operator.goto(*(low - APPROACH_DEG))
    await operator.goto(*low)
    await operator.speed(rpm, rpm)
    for end in (high, low):
        await operator.trace(2.0 * 60.0 / rpm)  # two motor turns a window: cogging cancels
        await operator.goto(*end)
        middle = 0.5 * (low + high)
        await books.take(operator, rpm, False, (float(middle[0]), float(middle[1])))


def _span(plane: FocalPlane, axis: int, settings: FrictionSettings) -> tuple[float, float]:
    low, high = _range(plane, axis, 0.0)
    if settings.run_span_deg is None:
        return low, high
    middle, half = 0.5 * (low + high), 0.5 * min(settings.run_span_deg, high - low)
    return middle - half, middle + half
