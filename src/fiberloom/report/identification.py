"""Figures of identifications, each with its residuals, as the paper's Fig. 11 to 14 and 17 show them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.calibration import (
    Arms,
    ArmsData,
    Coast,
    CoastData,
    Estimate,
    Friction,
    FrictionData,
    Inertia,
    InertiaData,
    Repeatability,
    RepeatabilityData,
    StiffnessData,
    TorqueScale,
    break_away,
)
from fiberloom.calibration.bench.stiffness import turned_deg
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.report.figures import save
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

_RPM = 30.0 / np.pi
_SMALL = {"fontsize": 8}


def _figure(rows: int, title: str, plane: FocalPlane, row: int) -> tuple[Any, Any]:
    figure, panels = plt.subplots(rows, 2, figsize=(12, 3.6 * rows), layout="constrained", squeeze=False)
    figure.suptitle(f"{plane.instrument.name}, positioner {plane.positioner_id[row]}: {title}")
    return figure, panels


def _label(panel: Any, title: str, xlabel: str, ylabel: str) -> None:
    panel.set(title=title, xlabel=xlabel, ylabel=ylabel)
    panel.title.set_fontsize(9)


def _save(figure: Any, path: Path) -> None:
    save(figure, path, 110)
    plt.close(figure)


def said(e: Estimate, row: int) -> str:
    """Value and standard error in words, or why there is none."""
    if e.reason[row]:
        return f"refused: {e.reason[row]}"
    value, error = e.of(row)
    return f"{value:.4g} ± {error:.2g} {e.unit}"


def _full(scale: TorqueScale, row: int, n: int) -> float:
    return float(np.broadcast_to(np.asarray(scale.full_uNm), n)[row])


def plot_friction(
    path: Path,
    plane: FocalPlane,
    data: tuple[FrictionData, FrictionData],
    found: list[Friction],
    scales: list[TorqueScale],
    row: int,
) -> None:
    """Break-away torque over a motor turn, running torque over the range, residuals.

    `path`: file to write; `data`, `found` and `scales`: measurement, result and torque scale of alpha
    and beta; `row`: the positioner of the `plane`.
    """
    figure, panels = _figure(3, "friction (Kronig 2020, Fig. 11 and 12)", plane, row)
    for axis in range(2):
        if found[axis].coulomb.reason[row]:
            continue
        _break_away(panels[0, axis], data[axis], found[axis], scales[axis], row)
        _running(panels[1, axis], data[axis], _full(scales[axis], row, plane.n), row)
        _friction_residuals(panels[2, axis], data[axis], found[axis], row)
    _save(figure, path)


def _break_away(panel: Any, data: FrictionData, found: Friction, scale: TorqueScale, row: int) -> None:
    for k, curve in enumerate(break_away(data, found, scale, row)):
        for side, marker in enumerate(("^", "v")):
            label = f"{curve.wire_deg:.0f}°" if side == 0 else None
            panel.plot(
                curve.rotor_deg[side], curve.torque_uNm[side], marker, ms=3, color=f"C{k}", label=label
            )
    words = f"Coulomb {said(found.coulomb, row)}, cogging {said(found.cogging, row)}"
    _label(panel, f"{AXES[data.axis]}: {words}", "rotor angle [motor deg]", "torque [µNm]")
    panel.legend(title="at", ncols=5, **_SMALL)


def _running(panel: Any, data: FrictionData, full_uNm: float, row: int) -> None:
    for segment, creep in zip(data.segments, data.creep, strict=True):
        good = np.isfinite(segment.voltage[row])
        if creep or not good.any():
            continue
        rpm = np.median(segment.speed_rad_s[row, good]) * _RPM
        output_deg = segment.motor_deg[row, good] / data.gear
        panel.plot(output_deg, segment.voltage[row, good] * full_uNm, ".", ms=3, label=f"{rpm:.0f} rpm")
    panel.set(xlabel="θ [deg]", ylabel="torque [µNm]")
    panel.legend(ncols=2, **_SMALL)


def _friction_residuals(panel: Any, data: FrictionData, found: Friction, row: int) -> None:
    left = found.coulomb.residuals[row]
    begin = 0
    for segment, creep in zip(data.segments, data.creep, strict=True):
        end = begin + segment.voltage.shape[1]
        colour = "C0" if creep else "C3"
        panel.plot(segment.motor_deg[row] / data.gear, left[begin:end], ".", ms=2, color=colour)
        begin = end
    rms = np.sqrt(np.nanmean(left**2))
    title = f"blue creeping, red running; rms {rms:.3g} µNm; drag {said(found.drag, row)}"
    _label(panel, title, "θ [deg]", "measured − fitted [µNm]")


def plot_inertia(
    path: Path,
    plane: FocalPlane,
    data: tuple[InertiaData, InertiaData],
    found: list[Inertia],
    scales: list[TorqueScale],
    row: int,
) -> None:
    """Speed after the step of torque, and the residual of the fitted rotor.

    `path`: file to write; `data`, `found` and `scales`: measurement, result and torque scale of alpha
    and beta; `row`: the positioner of the `plane`.
    """
    figure, panels = _figure(2, "inertia from steps of torque (Kronig 2020, Fig. 14)", plane, row)
    for axis in range(2):
        one, j = data[axis], found[axis]
        if j.inertia.reason[row]:
            continue
        time_ms = np.arange(one.motor_deg.shape[2]) * one.period_s * 1e3
        for motor in one.motor_deg[row]:
            rpm = np.abs(motor[4:] - motor[:-4]) / (4.0 * one.period_s * 6.0)
            panels[0, axis].plot(time_ms[2:-2], rpm, lw=0.8)
        full = _full(scales[axis], row, plane.n)
        levels = np.unique(np.round(np.abs(one.voltage[row][np.isfinite(one.voltage[row])]) * full))
        steps = " to ".join(f"{v:.0f}" for v in levels[levels > 0])
        before, end = j.speeds_rpm[row]
        _label(
            panels[0, axis],
            f"{AXES[axis]}: {steps} µNm, {before:.0f} to {end:.0f} rpm, "
            f"10–90 % in {1e3 * j.rise_s[row]:.1f} ms\nJ = {said(j.inertia, row)}",
            "time [ms]",
            "speed [rpm]",
        )
        left = j.inertia.residuals[row].reshape(one.motor_deg.shape[1:])
        for residual in left:
            panels[1, axis].plot(time_ms, residual, lw=0.7)
        panels[1, axis].set(xlabel="time [ms]", ylabel="residual [motor deg]",
                            title=f"rms {np.sqrt(np.nanmean(left**2)):.2f} motor deg")  # fmt: skip
    _save(figure, path)


def plot_coast(
    path: Path, plane: FocalPlane, data: tuple[CoastData, CoastData], found: list[Coast], row: int
) -> None:
    """Speed while the rotor coasts, bridge open and shorted, and the residual of the fitted way.

    `path`: file to write; `data` and `found`: measurement and result of alpha and beta; `row`: the
    positioner of the `plane`.
    """
    figure, panels = _figure(2, "coasting with the bridge open and shorted", plane, row)
    for axis in range(2):
        one, c = data[axis], found[axis]
        if c.back_emf_rate.reason[row]:
            continue
        time_ms = np.arange(one.motor_deg.shape[2]) * one.period_s * 1e3
        left = c.back_emf_rate.residuals[row].reshape(one.motor_deg.shape[1:])
        for motor, residual, opened in zip(one.motor_deg[row], left, one.open_bridge, strict=True):
            rpm = np.abs(motor[4:] - motor[:-4]) / (4.0 * one.period_s * 6.0)
            color = "tab:blue" if opened else "tab:red"
            panels[0, axis].plot(time_ms[2:-2], rpm, lw=0.8, color=color)
            panels[1, axis].plot(time_ms, residual, lw=0.7, color=color)
        _label(
            panels[0, axis],
            f"{AXES[axis]}: bridge open blue, shorted red\nback-EMF {said(c.back_emf, row)}, "
            f"viscous {said(c.viscous, row)}",
            "time [ms]",
            "speed [rpm]",
        )
        panels[1, axis].set(xlabel="time [ms]", ylabel="residual [motor deg]",
                            title=f"rms {np.sqrt(np.nanmean(left**2)):.2f} motor deg")  # fmt: skip
    _save(figure, path)


def plot_stiffness(
    path: Path, plane: FocalPlane, data: tuple[StiffnessData, StiffnessData], found: list[Estimate], row: int
) -> None:
    """The turn between the two torques, repeat by repeat.

    `path`: file to write; `data` and `found`: measurement and result of alpha and beta; `row`: the
    positioner of the `plane`.
    """
    figure, panels = _figure(1, "stiffness (Kronig 2020, Fig. 13)", plane, row)
    for axis in range(2):
        if found[axis].reason[row]:
            continue
        turned = turned_deg(data[axis])[row] * 1e3
        k, error = found[axis].of(row)
        panel = panels[0, axis]
        panel.plot(np.arange(1, len(turned) + 1), turned, "o", ms=4)
        mean = 2e3 * data[axis].torque_mNm / k
        panel.axhline(mean, color="0.4", lw=1)
        panel.axhspan(mean * (1 - error / k), mean * (1 + error / k), color="0.85")
        _label(
            panel,
            f"{AXES[axis]}: −{data[axis].torque_mNm:g} to +{data[axis].torque_mNm:g} mNm, "
            f"k = {said(found[axis], row)}",
            "repeat",
            "turn of the axis [mdeg]",
        )
    _save(figure, path)


def plot_arms(path: Path, plane: FocalPlane, data: ArmsData, arms: Arms, row: int) -> None:
    """Radial residuals over the direction from each circle's centre.

    `path`: file to write; `data` and `arms`: measurement and result; `row`: the positioner of the
    `plane`.
    """
    figure, panels = _figure(1, "arms from two circles", plane, row)
    if not arms.l_alpha.reason[row]:
        m = data.xy_mm.shape[2]
        both = arms.l_alpha.residuals[row]
        for axis, left in enumerate((both[:m], both[m:])):
            xy = data.xy_mm[axis, row]
            out = xy - np.nanmean(xy, axis=0)
            direction = np.rad2deg(np.arctan2(out[:, 1], out[:, 0]))
            name = said((arms.l_alpha, arms.l_beta)[axis], row)
            panels[0, axis].axhline(0.0, color="0.6", lw=0.8)
            panels[0, axis].plot(direction, left, "o", ms=3)
            _label(
                panels[0, axis],
                f"while {AXES[axis]} turned: radial rms {np.sqrt(np.nanmean(left**2)):.3f} µm; "
                f"l_{AXES[axis]} = {name}",
                "direction from the middle [deg]",
                "radial residual [µm]",
            )
    _save(figure, path)


def plot_repeatability(
    path: Path,
    plane: FocalPlane,
    data: tuple[RepeatabilityData, RepeatabilityData],
    found: list[Repeatability],
    row: int,
) -> None:
    """Where the fibre was at every visit, target by target.

    `path`: file to write; `data` and `found`: measurement and result of alpha and beta; `row`: the
    positioner of the `plane`.
    """
    figure, panels = _figure(1, "repeatability (Kronig 2020, Fig. 17)", plane, row)
    for axis in range(2):
        if found[axis].measured.reason[row]:
            continue
        off_um = turned_um(data[axis], row)
        for target in off_um:
            panels[0, axis].plot(*target.T, ".", ms=3)
        half = 1.1 * np.nanmax(np.abs(off_um))
        panels[0, axis].set(
            title=f"{AXES[axis]}, lever {data[axis].lever_mm[row]:.1f} mm, rms: as measured "
            f"{said(found[axis].measured, row)}\nwithout the camera {said(found[axis].own, row)}",
            xlabel="along the way [µm]",
            ylabel="across [µm]",
            aspect="equal",
            xlim=(-half, half),
            ylim=(-0.5 * half, 0.5 * half),
        )
        panels[0, axis].title.set_fontsize(9)
    _save(figure, path)


def turned_um(data: RepeatabilityData, row: int) -> Floats:
    """(T, V, 2) um about the middle, along the way of the fibre and across it."""
    xy = data.xy_mm[row]
    middle = np.nanmean(xy, axis=(0, 1))
    out = middle - data.pivot_mm[row]
    out /= np.linalg.norm(out)
    turn = np.array([[-out[1], out[0]], [out[0], out[1]]])
    turned: Floats = (xy - middle) @ turn.T * UM_PER_MM
    return turned
