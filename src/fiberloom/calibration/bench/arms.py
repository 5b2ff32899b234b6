"""Arm lengths and centre of a single positioner, from the circles of its two axes.

While one axis turns and the other rests, the fibre goes round a circle. Alpha's has the positioner's
centre for its own; beta's has the elbow, which is l_alpha away from it, and l_beta for its radius. The
gear's non-linearity moves points along their circle and so does no harm. Kronig 2020, Eq. 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.calibration.bench.bench import APPROACH_DEG, Operator, Progress, joined
from fiberloom.calibration.bench.estimate import Estimate, Fitted, Residuals, estimate
from fiberloom.calibration.transmission.circle import Circles, fit_circles
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.metrology import Camera
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

_LEAST_ARC_DEG = 60.0
_ENOUGH = 8
_STILL_MM = 0.1


@dataclass(frozen=True)
class ArmsSettings:
    """Points per circle."""

    n_points: int = 40
    images: int = 1
    beta_rest_deg: float = 75.0
    alpha_rest_deg: float = 180.0

    def __post_init__(self) -> None:
        if self.n_points < _ENOUGH:
            raise InputError(f"n_points = {self.n_points}: a circle needs at least {_ENOUGH}")


@dataclass(frozen=True, eq=False)
class ArmsData:
    """(2, N, M, 2) positions while alpha turned, and while beta turned; NaN where not seen."""

    xy_mm: Floats
    trouble: list[str]


@dataclass(frozen=True, eq=False)
class Arms:
    """Estimates of N positioners; residuals are radial."""

    centre_x: Estimate
    centre_y: Estimate
    l_alpha: Estimate
    l_beta: Estimate
    """From the beta axis to the fibre that the camera sees."""

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """All of them."""
        return (self.centre_x, self.centre_y, self.l_alpha, self.l_beta)


def identify_arms(data: ArmsData) -> Arms:
    """Two circles for each positioner. InputError when no positioner's points lie on circles."""
    circles = [fit_circles(xy, np.isfinite(xy).all(axis=-1)) for xy in data.xy_mm]
    reason = joined(
        data.trouble,
        *([_refusal(AXES[k], xy, c, row) for row, xy in enumerate(data.xy_mm[k])]
          for k, c in enumerate(circles)),
    )  # fmt: skip
    alpha, beta = circles
    arm = beta.centre_mm - alpha.centre_mm
    length = np.linalg.norm(arm, axis=1)
    along = arm / np.maximum(length, 1e-300)[:, None]
    spread = (alpha.covariance + beta.covariance)[:, :2, :2]
    left = [_radial_um(xy, c) for xy, c in zip(data.xy_mm, circles, strict=True)]
    both = np.concatenate(left, axis=1)

    def make(name: str, value: Floats, variance: Floats, residuals: Floats) -> Estimate:
        freedom = np.maximum(np.isfinite(residuals).sum(axis=1) - 3.0, 1.0)
        fitted = Fitted(value, np.sqrt(variance), freedom=freedom)
        return estimate(name, "mm", fitted, Residuals(residuals, "um"), reason)

    return Arms(
        make("centre x", alpha.centre_mm[:, 0], alpha.covariance[:, 0, 0], left[0]),
        make("centre y", alpha.centre_mm[:, 1], alpha.covariance[:, 1, 1], left[0]),
        make("l_alpha", length, np.einsum("ni,nij,nj->n", along, spread, along), both),
        make("l_beta", beta.radius_mm, beta.covariance[:, 2, 2], left[1]),
    )


def _radial_um(xy: Floats, circles: Circles) -> Floats:
    distance = np.linalg.norm(xy - circles.centre_mm[:, None], axis=-1) - circles.radius_mm[:, None]
    return np.where(circles.used, distance, np.nan) * UM_PER_MM


def _refusal(axis: str, xy: Floats, circles: Circles, row: int) -> str:
    used = circles.used[row]
    if used.sum() < _ENOUGH:
        return f"{axis}: {used.sum()} usable points on its circle, {_ENOUGH} needed (is the fibre lit?)"
    if np.linalg.norm(np.ptp(xy[used], axis=0)) < _STILL_MM:
        return f"{axis} did not move"
    out = xy[used] - circles.centre_mm[row]
    direction = np.unwrap(np.arctan2(out[:, 1], out[:, 0]))
    arc = np.rad2deg(np.ptp(direction))
    if arc < _LEAST_ARC_DEG:
        return f"{axis}: its points span {arc:.0f} deg, too short an arc for a circle"
    return ""


async def measure_arms(
    client: Client,
    camera: Camera,
    plane: FocalPlane,
    settings: ArmsSettings | None = None,
    progress: Progress | None = None,
) -> ArmsData:
    """All positioners of the `plane` at once; each axis rises through its range while the other rests.

    `client` and `camera` of the bench; `settings`: how much is measured, defaults when None; `progress`
    is called with (steps done, steps in all).
    """
    settings = settings or ArmsSettings()
    operator = Operator(client, camera, plane, progress)
    operator.expect(2 * settings.n_points)
    await operator.prepare()
    xy = np.full((2, plane.n, settings.n_points, 2), np.nan)
    for axis, rest in enumerate((settings.beta_rest_deg, settings.alpha_rest_deg)):
        low, high = plane.limits_deg[axis]
        wire = np.linspace(low, high - (high - low) / settings.n_points, settings.n_points)
        await operator.goto(*_both(axis, wire[0], rest + APPROACH_DEG))
        for k, position in enumerate(wire):
            await operator.goto(*_both(axis, position, rest))
            xy[axis, :, k] = operator.look(settings.images)
            operator.step()
    return ArmsData(xy, list(operator.trouble))


def _both(axis: int, moving: float, rest: float) -> tuple[float, float]:
    return (float(moving), rest) if axis == 0 else (rest, float(moving))
