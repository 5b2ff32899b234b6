"""What a full voltage is worth as torque, from a known torque on the arm.

Motors differ from their data sheet by some percent, and with them every torque that is measured by a
voltage. A weight that helps in one direction and hinders in the other changes the voltage at constant
speed by T_ext/n (Eq. 3a, divided by n): that is the scale, as good as the weight is known. The gear must
not lose more under load than without (true of the twin; of real gears to their efficiency).

The weight must stay below friction less spring, or the gear would run by itself (and the rotor in its
gap): half of the stiffness torques of Fig. 13 do, where the spring is weak.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.calibration.bench.bench import (
    APPROACH_DEG,
    BENCH_MARGIN_DEG,
    Operator,
    Progress,
    TorqueActuator,
    joined,
)
from fiberloom.calibration.bench.estimate import (
    Estimate,
    Fitted,
    Residuals,
    estimate,
    least_squares,
    standard_errors,
)
from fiberloom.calibration.bench.torque import AT_SPEED, TorqueScale, Windows, together, windows_of
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.metrology import Camera
from fiberloom.units import GEAR

SKIP_DEG = 400.0
_LAG = 5


@dataclass(frozen=True)
class TorqueScaleSettings:
    """Weights and moves."""

    torque_mNm: tuple[float, float] = (5.9, 0.7)
    """On alpha and on beta: half of Fig. 13."""
    rpm: float = 500.0
    span_deg: float = 12.0


@dataclass(frozen=True, eq=False)
class TorqueScaleData:
    """Runs up and down under known torques, one axis of N positioners."""

    axis: int
    segments: tuple[Windows, ...]
    torque_mNm: tuple[float, ...]
    """On the arm during each segment, positive towards positive angles."""
    tolerance: float
    trouble: list[str]
    gear: float = GEAR


def identify_torque_scale(data: TorqueScaleData) -> Estimate:
    """Torque of the motor at full voltage, uNm. InputError when no positioner's data support it."""
    windows = together(list(data.segments))
    lengths = [s.voltage.shape[1] for s in data.segments]
    at_motor_uNm = np.repeat(np.array(data.torque_mNm) * 1e3 / data.gear, lengths)
    design = np.stack(
        [
            np.sign(windows.speed_rad_s),
            np.ones_like(windows.voltage),
            windows.motor_deg / data.gear,
            np.broadcast_to(-at_motor_uNm, windows.voltage.shape),
        ],
        axis=-1,
    )
    fit = least_squares(design, windows.voltage, lag=_LAG)
    per_uNm, error = fit.value[:, 3], standard_errors(fit)[:, 3]
    axis = AXES[data.axis]
    reason = joined(
        data.trouble,
        [
            "" if np.isfinite(r).sum() >= 20 else f"{axis} did not move under the weight"
            for r in fit.residuals
        ],
        [f"{axis}: torques too much alike to give a scale" if s else "" for s in fit.singular],
        ["" if p > 5.0 * e else f"{axis}: the weight made no difference to its motor"
         for p, e in zip(per_uNm, error, strict=True)],
    )  # fmt: skip
    value = 1.0 / np.where(per_uNm > 0.0, per_uNm, np.nan)
    fitted = Fitted(value, error * value**2, data.tolerance * value, fit.freedom)
    residuals = Residuals(fit.residuals * value[:, None], "uNm")
    return estimate(f"{axis} torque at full voltage", "uNm", fitted, residuals, reason)


def measured_scale(found: Estimate) -> TorqueScale:
    """For the other identifications; those refused here are refused there (NaN)."""
    return TorqueScale(found.value, found.standard_error / found.value)


async def measure_torque_scale(
    client: Client,
    camera: Camera | None,
    bench: TorqueActuator,
    plane: FocalPlane,
    settings: TorqueScaleSettings | None = None,
    progress: Progress | None = None,
) -> tuple[TorqueScaleData, TorqueScaleData]:
    """One axis after the other, in the upper half of the range, where the spring is weak.

    `client` of the bench with the positioners of the `plane`; the `camera` is not needed; `bench`
    applies the torques; `settings`: how much is measured, defaults when None; `progress` is called with
    (steps done, steps in all).
    """
    settings = settings or TorqueScaleSettings()
    operator = Operator(client, camera, plane, progress)
    operator.expect(4)
    await operator.prepare()
    await operator.margin(BENCH_MARGIN_DEG)
    out = []
    for axis in range(2):
        segments, torques = [], []
        for side in (-1.0, 1.0):
            torque = side * settings.torque_mNm[axis]
            segments += await _loaded(operator, bench, axis, torque, settings)
            torques += [torque, torque]
            operator.step()
        out.append(
            TorqueScaleData(axis, tuple(segments), tuple(torques), bench.tolerance, operator.trouble,
                            plane.instrument.alpha.gear)
        )  # fmt: skip
    await operator.margin(0)
    return out[0], out[1]


async def _loaded(
    operator: Operator, bench: TorqueActuator, axis: int, torque_mNm: float, settings: TorqueScaleSettings
) -> list[Windows]:
    limits = operator.plane.limits_deg
    place = np.array([low + 0.8 * (high - low) for low, high in limits])
    away = np.zeros(2)
    away[axis] = 0.5 * settings.span_deg
    await operator.goto(*(place - away - APPROACH_DEG))
    await operator.goto(*(place - away))
    for positioner in operator.ids:
        bench.apply_torque(positioner, axis, torque_mNm)
    rpm = settings.rpm
    await operator.speed(rpm, rpm)
    out = []
    for end in (place + away, place - away):
        await operator.trace(2.0 * 60.0 / rpm)
        await operator.goto(*end)
        out.append(windows_of(await operator.take(axis), SKIP_DEG, AT_SPEED * rpm))
    for positioner in operator.ids:
        bench.apply_torque(positioner, axis, 0.0)
    await operator.speed(2000, 2000)
    return out
