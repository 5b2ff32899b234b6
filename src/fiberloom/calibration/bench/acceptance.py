"""Acceptance of units on a bench: what is measured, and what it is held against.

One sweep of both axes gives maps, backlash and arms; the maps, in the unit's own geometry as just
measured, then drive random targets, corrected by Eq. 25; visits to the same places give the
repeatability. Requirements are the instrument's (`[acceptance]` of its file).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.calibration.bench.bench import Operator, Progress, joined
from fiberloom.calibration.bench.repeatability import (
    Repeatability,
    RepeatabilityData,
    RepeatabilitySettings,
    identify_repeatability,
    measure_repeatability,
)
from fiberloom.calibration.transmission.evaluate import CalibrationReport, evaluate
from fiberloom.calibration.transmission.maps import Provenance, TransmissionMaps, polyline
from fiberloom.calibration.transmission.sweep import SweepSettings, measure_sweeps
from fiberloom.calibration.transmission.sweep_data import SweepData
from fiberloom.errors import InputError
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.instruments.arms import CENTRE, L_ALPHA
from fiberloom.instruments.model import AXES, Acceptance
from fiberloom.metrology import Camera
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

SLOPE_STEP_DEG = 360.0 / 183.0
"""Over which the slope of the non-linearity is taken: the steps of the maker's bench."""


@dataclass(frozen=True)
class AcceptanceSettings:
    """How much is measured."""

    n_points: int = 200
    """Of the sweep, per axis and direction."""
    n_targets: int = 20
    n_moves: int = 5
    """To each target, the blind one counted."""
    visits: int = 30
    """To each of the three targets of the repeatability, per axis."""
    tilt_deg: float | None = None
    """Tilt of the fibre, measured elsewhere: this bench does not see it. None: not measured."""

    def __post_init__(self) -> None:
        if self.n_targets < 1 or self.n_moves < 1:
            raise InputError(f"{self.n_targets} targets, {self.n_moves} moves: at least 1 of each")
        if self.tilt_deg is not None and not 0.0 <= self.tilt_deg < 90.0:
            raise InputError(f"tilt of the fibre {self.tilt_deg:g} deg: must be from 0 to 90")


@dataclass(frozen=True, eq=False)
class AcceptanceData:
    """What the bench saw of N units."""

    plane: FocalPlane
    """With each unit's own arms and centre, as measured."""
    maps: TransmissionMaps
    report: CalibrationReport
    sweep: SweepData
    target_deg: Floats
    """(T, 2)"""
    error_um: Floats
    """(N, T, M) distance from the target after each move, as measured; NaN where not seen."""
    visits: tuple[RepeatabilityData, ...]
    repeatability: tuple[Repeatability, ...]
    """Of alpha and of beta; empty when no unit got so far."""
    reason: list[str]
    """Why a unit could not be measured."""


@dataclass(frozen=True)
class Check:
    """One requirement and a unit's value for it."""

    name: str
    value: float | None
    """None: not measured."""
    error: float | None
    """Standard error, where known."""
    limit: float | None
    """None: for information."""
    unit: str
    note: str = ""

    @property
    def verdict(self) -> str:
        """pass, fail, not measured, or for information."""
        if self.limit is None:
            return "information"
        if self.value is None:
            return "not measured"
        return "pass" if self.value <= self.limit else "fail"

    @property
    def marginal(self) -> bool:
        """Nearer to its limit than two standard errors."""
        if self.value is None or self.limit is None or self.error is None:
            return False
        return abs(self.value - self.limit) < 2.0 * self.error


@dataclass(frozen=True)
class UnitVerdict:
    """A unit's checks."""

    positioner_id: int
    row: int
    checks: tuple[Check, ...]
    reason: str
    """Why it could not be measured; empty where it was."""

    @property
    def missing(self) -> tuple[str, ...]:
        """Requirements for which nothing was measured."""
        return tuple(c.name for c in self.checks if c.verdict == "not measured")

    @property
    def passed(self) -> bool:
        """Measured, and every requirement met."""
        return self.word == "accepted"

    @property
    def word(self) -> str:
        """accepted; not accepted; not complete, where none is missed and one was not measured."""
        if self.reason or any(c.verdict == "fail" for c in self.checks):
            return "not accepted"
        return "not complete" if self.missing else "accepted"


def own_geometry(plane: FocalPlane, report: CalibrationReport) -> FocalPlane:
    """The plane with the arms and centres that the sweep's circles gave; refused units keep theirs."""
    ok = report.ok
    arms = plane.arms.copy()
    arms[ok, CENTRE], arms[ok, L_ALPHA] = report.centre_mm[ok], report.l_alpha_mm[ok]
    stretch = np.where(ok, report.l_beta_mm / plane.l_beta_mm, 1.0)[:, None]
    points = {**plane.points, METROLOGY: plane.points[METROLOGY] * stretch}
    return replace(plane, arms=arms, points=points)


def judge(data: AcceptanceData, nominal: FocalPlane, tilt_deg: float | None = None) -> list[UnitVerdict]:
    """Every unit against the instrument's requirements. InputError when it has none.

    `data`: of the units of the layout `nominal`; `tilt_deg`: tilt of the fibre, measured elsewhere.
    """
    asked = nominal.instrument.acceptance
    if asked is None:
        raise InputError(
            f"{nominal.instrument.name}: no requirements; add [acceptance] to the instrument's file"
        )
    out = []
    for row, number in enumerate(nominal.positioner_id):
        reason = data.reason[row]
        checks = () if reason else (*_checks(data, nominal, asked, row), _tilt(asked, tilt_deg))
        out.append(UnitVerdict(int(number), row, checks, reason))
    return out


def _checks(data: AcceptanceData, nominal: FocalPlane, asked: Acceptance, row: int) -> list[Check]:
    requirement_um = nominal.instrument.operation.requirement_um
    blind = data.error_um[row, :, 0]
    needed = moves_needed(data.error_um[row], requirement_um)
    final = data.error_um[row, :, min(asked.moves or 1, data.error_um.shape[2]) - 1]
    rms, rms_error = stretched_repeatability(data, row)
    moves_note = "" if needed else f"not reached in {data.error_um.shape[2]} moves"
    return [
        Check("repeatability, arm stretched, rms", rms, rms_error, asked.repeatability_um, "µm"),
        *_of_axes(data, asked, row),
        *_of_arms(data, nominal, asked, row),
        Check("blind error, largest", _largest(blind), None, asked.blind_error_um, "µm"),
        Check(
            f"moves until all within {requirement_um:g} µm",
            float(needed or data.error_um.shape[2] + 1), None, asked.moves, "", moves_note,
        ),
        Check("blind error, rms", float(np.sqrt(np.nanmean(blind**2))), None, None, "µm"),
        Check(f"error after {asked.moves or 1} moves, largest", _largest(final), None, None, "µm"),
    ]  # fmt: skip


def _tilt(asked: Acceptance, tilt_deg: float | None) -> Check:
    note = "a camera from above does not see it; --tilt" if tilt_deg is None else "measured elsewhere"
    return Check("tilt of the fibre", tilt_deg, None, asked.tilt_deg, "°", note)


def _largest(values: Floats) -> float:
    return float(np.nanmax(values)) if np.isfinite(values).any() else float("inf")


def _of_axes(data: AcceptanceData, asked: Acceptance, row: int) -> list[Check]:
    out = []
    rows: list[tuple[str, Callable[[AcceptanceData, int, int], float], float | None, str]] = [
        ("hysteresis", hysteresis_deg, asked.hysteresis_deg, "°"),
        ("non-linearity", non_linearity_deg, asked.non_linearity_deg, "°"),
        ("slope of the non-linearity", non_linearity_slope, asked.non_linearity_slope, "°/°"),
    ]
    for name, measure, limit, unit in rows:
        for axis, axis_name in enumerate(AXES):
            error = _map_error_deg(data, row, axis) * (np.sqrt(2) / SLOPE_STEP_DEG if "slope" in name else 1)
            out.append(Check(f"{name}, {axis_name}", measure(data, row, axis), float(error), limit, unit))
    return out


def _of_arms(data: AcceptanceData, nominal: FocalPlane, asked: Acceptance, row: int) -> list[Check]:
    positioner, report = nominal.instrument.positioner, data.report
    seen = positioner.points[nominal.instrument.seen_point]
    nominal_mm = (positioner.l_alpha_mm, float(np.hypot(seen.x_mm, seen.y_mm)))
    found = (
        (report.l_alpha_mm[row], report.l_alpha_se_mm[row]),
        (report.l_beta_mm[row], report.l_beta_se_mm[row]),
    )
    return [
        Check(
            f"{name} arm, off its nominal {nominal_mm[axis]:g} mm", abs(float(length) - nominal_mm[axis]),
            float(error), asked.arm_deviation_mm, "mm", f"{length:.4f} mm",
        )
        for axis, (name, (length, error)) in enumerate(zip(AXES, found, strict=True))
    ]  # fmt: skip


def _map_error_deg(data: AcceptanceData, row: int, axis: int) -> float:
    """Standard error of a knot of the map: the camera at the circle's lever."""
    lever_mm = (data.report.l_alpha_mm[row], data.report.l_beta_mm[row])[axis]
    return float(np.rad2deg(data.report.circle_rms_um[row, axis] / UM_PER_MM / lever_mm))


def _delta(data: AcceptanceData, row: int, axis: int, side: int) -> Floats:
    wire = data.maps.wire_deg[row, axis, side]
    out: Floats = wire - data.maps.output_deg[row, axis, side]
    return out


def hysteresis_deg(data: AcceptanceData, row: int, axis: int) -> float:
    """Largest difference of output angle between the two contacts at the same motor angle."""
    output = data.maps.output_deg[row, axis]
    return float(np.max(output[0] - output[1]))


def non_linearity_deg(data: AcceptanceData, row: int, axis: int) -> float:
    """Largest deviation from the nominal ratio in either contact, its mean taken off. Eq. 7."""
    delta = [_delta(data, row, axis, side) for side in range(2)]
    return float(max(np.abs(d - d.mean()).max() for d in delta))


def non_linearity_slope(data: AcceptanceData, row: int, axis: int) -> float:
    """Largest change of that deviation per angle (dimensionless), over steps of SLOPE_STEP_DEG."""
    slopes = []
    for side in range(2):
        output = data.maps.output_deg[row, axis, side]
        at = np.arange(output[0], output[-1], SLOPE_STEP_DEG)
        slopes.append(np.abs(np.diff(polyline(output, _delta(data, row, axis, side), at))).max())
    return float(max(slopes)) / SLOPE_STEP_DEG


def stretched_repeatability(data: AcceptanceData, row: int) -> tuple[float, float]:
    """Both axes' own scatter at the longest lever each can have: um rms and standard error."""
    l_beta = float(data.plane.l_beta_mm[row])
    levers = (data.plane.l_alpha_mm[row] + l_beta, l_beta)
    square, error = 0.0, 0.0
    for axis, lever in enumerate(levers):
        mdeg, mdeg_error = data.repeatability[axis].angle.of(row)
        um = np.deg2rad(mdeg * 1e-3) * lever * UM_PER_MM
        um_error = np.deg2rad(mdeg_error * 1e-3) * lever * UM_PER_MM
        square, error = square + um**2, error + (um * um_error) ** 2
    rms = np.sqrt(square)
    return float(rms), float(np.sqrt(error) / max(rms, 1e-9))


def moves_needed(error_um: Floats, requirement_um: float) -> int | None:
    """Moves after which every one of (T, M) errors is within the requirement; None: never."""
    good = np.all(error_um <= requirement_um, axis=0)
    return int(np.argmax(good)) + 1 if good.any() else None


@dataclass(frozen=True)
class AcceptanceBench:
    """What an acceptance is measured with."""

    client: Client
    camera: Camera
    close_up: Camera
    """Close to the units."""
    close_up_rms_um: float
    """Error of the close-up camera, two-dimensional rms."""


async def measure_acceptance(
    bench: AcceptanceBench,
    plane: FocalPlane,
    settings: AcceptanceSettings | None = None,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> AcceptanceData:
    """The whole procedure, all N units of the `plane` at once.

    `bench`: what is measured with; `settings`: how much; `seed` of the random targets; `progress` is called
    with (steps done, steps in all).
    """
    settings = settings or AcceptanceSettings()
    sweep_settings = SweepSettings(settings.n_points)
    sweep = await measure_sweeps(bench.client, bench.camera, plane, sweep_settings, progress)
    provenance = Provenance(plane.config_hash(), seed, gear=plane.instrument.alpha.gear, note="acceptance")
    _, first = evaluate(plane, sweep, sweep_settings.seen_at_least, provenance)
    own = own_geometry(plane, first)
    maps, report = evaluate(own, sweep, sweep_settings.seen_at_least, provenance)
    operator = Operator(bench.client, bench.camera, own, progress)
    operator.trouble = list(report.reason)
    target_deg = _targets(plane, settings.n_targets, seed)
    error_um = await _visit(operator, maps, target_deg, settings)
    visits, found, reason = await _repeat(operator, bench, settings.visits, progress)
    return AcceptanceData(own, maps, report, sweep, target_deg, error_um, visits, found, reason)


async def _repeat(
    operator: Operator, bench: AcceptanceBench, visits: int, progress: Progress | None
) -> tuple[tuple[RepeatabilityData, ...], tuple[Repeatability, ...], list[str]]:
    """Nothing but the reasons when no unit is left."""
    if not operator.ids:
        return (), (), operator.trouble
    data = await measure_repeatability(
        operator.client, bench.close_up, operator.plane, RepeatabilitySettings(visits=visits), progress
    )
    trouble = joined(operator.trouble, *(d.trouble for d in data))
    data = (replace(data[0], trouble=trouble), replace(data[1], trouble=trouble))
    if all(trouble):
        return (), (), trouble
    found = tuple(identify_repeatability(d, bench.close_up_rms_um) for d in data)
    return data, found, joined(trouble, *(list(f.angle.reason) for f in found))


def _targets(plane: FocalPlane, n: int, seed: int) -> Floats:
    """(n, 2) angles, inside the range by what corrections may need."""
    low, high = plane.limits_deg.T
    room = 0.03 * (high - low)
    return np.random.default_rng([seed, 0xACCE]).uniform(low + room, high - room, (n, 2))


async def _visit(
    operator: Operator, maps: TransmissionMaps, target_deg: Floats, settings: AcceptanceSettings
) -> Floats:
    """(N, T, M) distances from the targets in um. Corrections by Eq. 25, from the first one on."""
    plane = operator.plane
    operator.expect(settings.n_targets * settings.n_moves)
    await operator.prepare()
    out = np.full((plane.n, settings.n_targets, settings.n_moves), np.nan)
    for t, (alpha, beta) in enumerate(target_deg):
        goal_mm = plane.forward(alpha, beta)
        angles = np.broadcast_to([alpha, beta], (plane.n, 2)).copy()
        for move in range(settings.n_moves):
            wire = maps.to_wire(angles)
            await operator.approach(*wire.T)
            off_mm = goal_mm - operator.look()
            out[:, t, move] = np.linalg.norm(off_mm, axis=1) * UM_PER_MM
            jacobian = plane.jacobian(*angles.T)
            angles += np.einsum("nij,nj->ni", np.linalg.pinv(jacobian), np.nan_to_num(off_mm))
            operator.step()
    return out
