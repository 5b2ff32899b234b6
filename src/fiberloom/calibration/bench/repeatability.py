"""How well a positioner comes back to where it has been. Kronig 2020, Section 4.1, Fig. 17.

Three targets 1 um apart, each visited many times from above by 840 motor degrees. The scatter about the
mean of each target holds the camera's; what is left is the positioner's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.calibration.bench.bench import APPROACH_DEG, Operator, Progress, joined
from fiberloom.calibration.bench.estimate import Estimate, Fitted, Residuals, estimate
from fiberloom.errors import InputError
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.metrology import Camera
from fiberloom.typing import Floats
from fiberloom.units import MM_PER_UM, UM_PER_MM

_ENOUGH = 5


@dataclass(frozen=True)
class RepeatabilitySettings:
    """Targets and visits."""

    visits: int = 300
    step_um: float = 1.0
    targets: int = 3
    images: int = 1
    alpha_deg: float = 180.0
    beta_deg: tuple[float, float] = (170.0, 90.0)
    """While alpha repeats (folded: the paper's lever is 7.6 mm), and about where beta does."""

    def __post_init__(self) -> None:
        if self.visits < _ENOUGH or self.targets < 1:
            raise InputError(f"{self.targets} targets, {self.visits} visits: 1 and {_ENOUGH} at least")


@dataclass(frozen=True, eq=False)
class RepeatabilityData:
    """One axis of N positioners."""

    axis: int
    xy_mm: Floats
    """(N, T targets, V visits, 2)"""
    pivot_mm: Floats
    """(N, 2) the axis of rotation; for a direction, so a tenth of a millimetre will do."""
    lever_mm: Floats
    """(N,)"""
    trouble: list[str]


@dataclass(frozen=True, eq=False)
class Repeatability:
    """Estimates of one axis of N positioners."""

    axis: int
    measured: Estimate
    """Two-dimensional rms about each target's mean, the camera included."""
    own: Estimate
    """The same without the camera."""
    angle: Estimate
    """That as angle of the axis."""
    apart_um: Floats
    """(N, T - 1) distances between the means of neighbouring targets."""


def identify_repeatability(
    data: RepeatabilityData, camera_rms_um: float, camera_relative_error: float = 0.02
) -> Repeatability:
    """Scatter about the targets. InputError when no positioner's data support it.

    camera_rms_um: two-dimensional rms of one measurement of a fibre at rest, known to its relative
    error. Standard errors are those of variances of normal scatter. Where the scatter is the camera's
    alone the positioner's own is 0, with an honest error.
    """
    mean, left = _about_targets(data.xy_mm)
    visits = np.isfinite(left[..., 0]).sum(axis=2)
    freedom = np.maximum((visits - 1).sum(axis=1), 1).astype(np.float64)
    flat = np.nan_to_num(left).reshape(len(left), -1, 2)
    spread = np.einsum("nmi,nmj->nij", flat, flat) / freedom[:, None, None]
    across = _across(data, mean)
    along_way = np.einsum("ni,nij,nj->n", across, spread, across)
    whole = np.einsum("nii->n", spread)
    reason = joined(data.trouble, [_refusal(AXES[data.axis], v) for v in visits.min(axis=1)])
    residuals = np.sqrt((left**2).sum(axis=-1)).reshape(len(left), -1)
    whole_error = np.sqrt(2.0 * np.einsum("nij,nij->n", spread, spread) / freedom)
    way_error = np.sqrt(2.0 / freedom) * along_way
    camera2 = camera_rms_um**2
    camera2_error = 2.0 * camera_relative_error * camera2

    def make(what: str, square: Floats, error: Floats, systematic: float) -> Estimate:
        squared = Fitted(square, error, systematic, freedom)
        return _root(f"{AXES[data.axis]} {what}", squared, Residuals(residuals, "um"), reason)

    turned = make("angular repeatability", along_way - 0.5 * camera2, way_error, 0.5 * camera2_error)
    return Repeatability(
        data.axis,
        make("repeatability as measured", whole, whole_error, 0.0),
        make("repeatability", whole - camera2, whole_error, camera2_error),
        turned.scaled(np.rad2deg(MM_PER_UM / data.lever_mm) * 1e3, unit="mdeg"),
        np.linalg.norm(np.diff(mean, axis=1), axis=-1) * UM_PER_MM,
    )


def _about_targets(xy: Floats) -> tuple[Floats, Floats]:
    """Means of the targets (N, T, 2) in mm, and visits about them (N, T, V, 2) in um."""
    seen = np.isfinite(xy).all(axis=-1, keepdims=True)
    mean = np.where(seen, xy, 0.0).sum(axis=2) / np.maximum(seen.sum(axis=2), 1)
    return mean, np.where(seen, (xy - mean[:, :, None]) * UM_PER_MM, np.nan)


def _across(data: RepeatabilityData, mean: Floats) -> Floats:
    """(N, 2) the direction in which the axis moves the fibre."""
    out = mean.mean(axis=1) - data.pivot_mm
    out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300)
    return np.stack([-out[:, 1], out[:, 0]], axis=1)


def _root(name: str, squared: Fitted, residuals: Residuals, reason: list[str]) -> Estimate:
    """A length from its square: what scatters makes roots too small by 1/8 of its relative variance."""
    square, error = np.maximum(squared.value, 0.0), squared.scatter
    # at zero a root has no slope: there the error of the square itself, as a length
    floor = np.maximum(np.maximum(square, error), 1e-300)
    value = np.sqrt(square) * (1.0 + 0.125 * (error / floor) ** 2)
    slope = 2.0 * np.sqrt(floor)
    fitted = Fitted(value, error / slope, np.asarray(squared.systematic) / slope, squared.freedom)
    return estimate(name, "um", fitted, residuals, reason)


def _refusal(axis: str, visits: int) -> str:
    if visits < _ENOUGH:
        return f"{axis}: a target was seen {visits} times, {_ENOUGH} needed (is the fibre lit?)"
    return ""


async def measure_repeatability(
    client: Client,
    camera: Camera,
    plane: FocalPlane,
    settings: RepeatabilitySettings | None = None,
    progress: Progress | None = None,
) -> tuple[RepeatabilityData, RepeatabilityData]:
    """Alpha, then beta; all positioners of the `plane` at once. The other axis goes along without
    moving.

    `client` and `camera` of the bench; `settings`: how much is measured, defaults when None; `progress`
    is called with (steps done, steps in all).
    """
    settings = settings or RepeatabilitySettings()
    operator = Operator(client, camera, plane, progress)
    operator.expect(2 * settings.targets * settings.visits)
    await operator.prepare()
    out = [await _visits(operator, axis, settings) for axis in range(2)]
    return out[0], out[1]


async def _visits(operator: Operator, axis: int, settings: RepeatabilitySettings) -> RepeatabilityData:
    plane = operator.plane
    beta = settings.beta_deg[axis]
    place = np.array([settings.alpha_deg, beta])
    lever = _lever_mm(plane, axis, beta)
    step_deg = np.rad2deg(settings.step_um * MM_PER_UM / lever)
    xy = np.full((plane.n, settings.targets, settings.visits, 2), np.nan)
    for visit in range(settings.visits):
        for target in range(settings.targets):
            wire = np.broadcast_to(place, (plane.n, 2)).copy()
            wire[:, axis] += target * step_deg
            await _from_above(operator, axis, wire)
            xy[:, target, visit] = operator.look(settings.images)
            operator.step()
    pivot = plane.elbows_mm(settings.alpha_deg) if axis else plane.centres_mm
    return RepeatabilityData(axis, xy, pivot, lever, list(operator.trouble))


async def _from_above(operator: Operator, axis: int, wire: Floats) -> None:
    above = wire.copy()
    above[:, axis] += APPROACH_DEG
    await operator.goto(*above.T)
    await operator.goto(*wire.T)


def _lever_mm(plane: FocalPlane, axis: int, beta_deg: float) -> Floats:
    """(N,) from the axis to the fibre that the camera sees."""
    if axis == 1:
        return plane.l_beta_mm
    x, y = plane.points[METROLOGY].T
    turn = plane.beta_off_rad + np.deg2rad(beta_deg)
    lever: Floats = np.hypot(
        plane.l_alpha_mm + x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)
    )
    return lever
