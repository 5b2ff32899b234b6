"""Stiffness of the gear, from two known torques on the arm. Kronig 2020, Section 2.5, Eq. 5a, Fig. 13.

The motor is at rest, the arm is pulled to one side and to the other, and the camera sees by how much it
turns: k = T / dtheta. Only the part of the shift across the lever is the axis' own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.calibration.bench.bench import Operator, Progress, TorqueActuator, joined
from fiberloom.calibration.bench.estimate import Estimate, Fitted, Residuals, estimate
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.metrology import Camera
from fiberloom.typing import Floats

_LEVER_ERROR_MM = 0.003
"""Of the layout's lengths and centres: some micrometres."""
_ENOUGH = 3


@dataclass(frozen=True)
class StiffnessSettings:
    """Torques of Fig. 13, and how often."""

    torque_mNm: tuple[float, float] = (11.8, 1.4)
    """On alpha and on beta, to each side."""
    repeats: int = 10
    images: int = 4
    """Averaged at each torque."""

    def __post_init__(self) -> None:
        if self.repeats < _ENOUGH:
            raise InputError(f"repeats = {self.repeats}: the scatter needs at least {_ENOUGH}")


@dataclass(frozen=True, eq=False)
class StiffnessData:
    """One axis of N positioners: places of the fibre under -T and +T, R times."""

    axis: int
    xy_mm: Floats
    """(N, R, 2, 2): repeat, torque - and +, coordinates; NaN where not seen."""
    pivot_mm: Floats
    """(N, 2) the axis of rotation."""
    lever_mm: Floats
    """(N,) from there to the fibre."""
    torque_mNm: float
    tolerance: float
    """Relative standard error of the torque."""
    trouble: list[str]


def identify_stiffness(data: StiffnessData) -> Estimate:
    """k in mNm/deg for N positioners. InputError when no positioner's data support it."""
    turned = turned_deg(data)
    seen = np.isfinite(turned)
    count = seen.sum(axis=1)
    mean = np.where(seen, turned, 0.0).sum(axis=1) / np.maximum(count, 1)
    left = turned - mean[:, None]
    scatter = np.sqrt(np.nansum(left**2, axis=1) / np.maximum(count - 1, 1))
    error = scatter / np.sqrt(np.maximum(count, 1))
    axis = AXES[data.axis]
    reason = joined(data.trouble, [_refusal(axis, *row) for row in zip(count, mean, error, strict=True)])
    value = 2.0 * data.torque_mNm / np.where(mean > 0.0, mean, np.nan)
    relative = np.hypot(data.tolerance, _LEVER_ERROR_MM / data.lever_mm)
    fitted = Fitted(value, value * error / mean, value * relative, np.maximum(count - 1.0, 1.0))
    return estimate(f"{axis} stiffness", "mNm/deg", fitted, Residuals(left, "deg"), reason)


def turned_deg(data: StiffnessData) -> Floats:
    """(N, R) by how much the axis turned from -T to +T, each repeat."""
    out = _mean(data.xy_mm) - data.pivot_mm
    along = out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    shift = data.xy_mm[:, :, 1] - data.xy_mm[:, :, 0]
    turn: Floats = np.rad2deg(np.einsum("nrc,nc->nr", shift, across) / data.lever_mm[:, None])
    return turn


def _mean(xy_mm: Floats) -> Floats:
    """(N, 2) mean place of the fibre; zero if it was never seen."""
    seen = np.isfinite(xy_mm).all(axis=-1, keepdims=True)
    total = np.where(seen, xy_mm, 0.0).sum(axis=(1, 2))
    mean: Floats = total / np.maximum(seen.sum(axis=(1, 2)), 1)
    return mean


def _refusal(axis: str, count: int, mean_deg: float, error_deg: float) -> str:
    if count < _ENOUGH:
        return f"{axis}: fibre seen in {count} pairs of torques, {_ENOUGH} needed"
    if not mean_deg > 5.0 * error_deg:
        return (
            f"{axis} turned by {1e3 * mean_deg:.2f} +- {1e3 * error_deg:.2f} mdeg under the torque: no "
            "motion to speak of; does the weight hang?"
        )
    return ""


async def measure_stiffness(
    client: Client,
    camera: Camera,
    bench: TorqueActuator,
    plane: FocalPlane,
    settings: StiffnessSettings | None = None,
    progress: Progress | None = None,
) -> tuple[StiffnessData, StiffnessData]:
    """Alpha with the arm stretched (the longest lever), then beta.

    `client` and `camera` of the bench with the positioners of the `plane`; `bench` applies the torques;
    `settings`: how much is measured, defaults when None; `progress` is called with (steps done, steps
    in all).
    """
    settings = settings or StiffnessSettings()
    operator = Operator(client, camera, plane, progress)
    operator.expect(4 * settings.repeats)
    await operator.prepare()
    alpha_deg = float(np.mean(plane.limits_deg[0]))
    await operator.approach(alpha_deg, _stretched_deg(plane))
    xy = [await _pairs(operator, bench, axis, settings) for axis in range(2)]
    length = plane.l_beta_mm
    centre = plane.centres_mm
    levers = np.linalg.norm(_mean(xy[0]) - centre, axis=1), length
    pivots = centre, plane.elbows_mm(alpha_deg)
    data = [
        StiffnessData(axis, xy[axis], pivots[axis], levers[axis], settings.torque_mNm[axis], bench.tolerance,
                      list(operator.trouble))
        for axis in range(2)
    ]  # fmt: skip
    return data[0], data[1]


def _stretched_deg(plane: FocalPlane) -> float:
    low, high = plane.limits_deg[1]
    return float(np.clip(30.0, low, high))


async def _pairs(operator: Operator, bench: TorqueActuator, axis: int, settings: StiffnessSettings) -> Floats:
    xy = np.full((operator.plane.n, settings.repeats, 2, 2), np.nan)
    for repeat in range(settings.repeats):
        for side in range(2):
            for positioner in operator.ids:
                bench.apply_torque(positioner, axis, (2 * side - 1) * settings.torque_mNm[axis])
            await operator.client.sleep(0.05)
            xy[:, repeat, side] = operator.look(settings.images)
            operator.step()
    for positioner in operator.ids:
        bench.apply_torque(positioner, axis, 0.0)
    return xy
