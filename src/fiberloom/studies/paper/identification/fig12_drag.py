"""Fig. 12: torque at constant speed over the output angle, and over the speed."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.studies.paper.identification.identified import RUN_RPM, UNITS, Identified, each_seed
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Kind, Quantity, ordering, quantity
from fiberloom.typing import Floats
from fiberloom.units import GEAR, motor_to_output_deg

ALPHA = 0


@dataclass(frozen=True)
class Sweep:
    """One run over the range at constant speed, one unit."""

    speed_rpm: float
    output_deg: Floats
    torque_uNm: Floats


def sweeps(found: Identified, row: int) -> list[Sweep]:
    """Every run of alpha, up and down at each speed, after its start."""
    data, scale = found.friction_data[ALPHA], found.scale[ALPHA]
    full = float(np.broadcast_to(scale.full_uNm, UNITS)[row])
    out = []
    for windows, creep in zip(data.segments, data.creep, strict=True):
        good = np.isfinite(windows.voltage[row])
        if creep or not good.any():
            continue
        rpm = float(np.median(windows.speed_rad_s[row, good])) * 30.0 / np.pi
        angle = motor_to_output_deg(windows.motor_deg[row, good], GEAR)
        # the first and last stretches speed up and slow down
        steady = np.abs(windows.speed_rad_s[row, good] * 30.0 / np.pi - rpm) < 0.01 * abs(rpm)
        out.append(Sweep(rpm, angle[steady], windows.voltage[row, good][steady] * full))
    return out


def r_squared(x: Floats, y: Floats) -> float:
    """Share of the variance of `y` that a straight line in `x` explains; both of any unit."""
    return float(np.corrcoef(x, y)[0, 1] ** 2)


def over_speed(runs: list[Sweep]) -> tuple[Floats, Floats]:
    """Speed in rpm and mean torque of every run in the middle of the range; each against its own sign."""
    speed = np.array([run.speed_rpm for run in runs])
    mean = np.array([np.interp(180.0, *_sorted(run)) for run in runs])
    return speed, mean


def _sorted(run: Sweep) -> tuple[Floats, Floats]:
    slope = np.polynomial.Polynomial.fit(run.output_deg, run.torque_uNm, 1)
    ends = np.array([run.output_deg.min(), run.output_deg.max()])
    return ends, slope(ends)


def run(settings: Settings) -> FigureOutcome:
    """Ours beside the paper's two straight lines."""
    found = each_seed(settings, 12)
    return FigureOutcome(
        quantities=_quantities(found),
        drawings=[_draw(sweeps(found[0], 0))],
        how=(
            f"{UNITS} units per seed run over their whole range at {', '.join(f'{r:g}' for r in RUN_RPM)} "
            "rpm both ways; the firmware records voltage and angle, two motor turns to a point so that "
            "cogging cancels. Alpha is shown."
        ),
    )


def _linear_in_speed(found: Identified) -> float:
    shares = []
    for row in range(UNITS):
        speed, torque = over_speed(sweeps(found, row))
        shares += [r_squared(speed[side], torque[side]) for side in (speed > 0, speed < 0)]
    return float(np.mean(shares))


def _linear_in_angle(found: Identified) -> float:
    runs = [run for row in range(UNITS) for run in sweeps(found, row)]
    return float(np.mean([r_squared(run.output_deg, run.torque_uNm) for run in runs]))


def _steepest_at_zero(found: Identified) -> float:
    """Spring torque at output angle 0 over that at 360."""
    friction = found.friction[ALPHA]
    at_zero = friction.spring.value
    return float(np.mean(np.abs(at_zero) / np.abs(at_zero + 360.0 * friction.spring_rate.value)))


def _quantities(found: list[Identified]) -> list[Quantity]:
    return [
        quantity(
            "fig12.linear_in_angle",
            "share of the variance of torque over angle that a line explains",
            [_linear_in_angle(f) for f in found],
            "1",
            Kind.PUT_IN,
            note="a linear spring is put in (Eq. 3a); noise of voltage and steps of the PWM are the rest; no "
            "number printed",
        ),
        quantity(
            "fig12.linear_in_speed",
            "share of the variance of torque over speed that a line explains",
            [_linear_in_speed(f) for f in found],
            "1",
            Kind.PUT_IN,
            note="viscous friction and back-EMF are put in (Eq. 8, 19); no number printed",
        ),
        quantity(
            "fig12.drag_uNms",
            "slope of torque over speed, alpha",
            [float(np.mean(f.friction[ALPHA].drag.value)) for f in found],
            "uNm s/rad",
            Kind.PUT_IN,
            note="0.8 derived from Fig. 12 and 14, no number printed",
        ),
        quantity(
            "fig12.spring_0_over_360",
            "spring torque at 0 deg over that at 360 deg, alpha",
            [_steepest_at_zero(f) for f in found],
            "1",
            Kind.PUT_IN,
            note="no number printed",
        ),
        ordering(
            "fig12.order.highest_at_zero",
            "the spring's torque is highest at 0 deg",
            [_steepest_at_zero(f) > 1.0 for f in found],
            Kind.PUT_IN,
            note="the spring is put in",
        ),
    ]


def _draw(runs: list[Sweep]) -> Drawing:
    canvas, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.2), layout="constrained")
    for one in runs:
        if round(abs(one.speed_rpm)) in (500, 2000):
            left.plot(one.output_deg, one.torque_uNm, linewidth=0.8, label=f"{one.speed_rpm:+.0f} rpm")
    left.set(xlabel="θ [deg]", ylabel="torque [µNm]")
    left.legend(fontsize=8)
    speed, torque = over_speed(runs)
    right.plot(speed, torque, "o")
    for side in (speed > 0, speed < 0):
        line = np.polynomial.Polynomial.fit(speed[side], torque[side], 1)
        ends = np.array([0.0, 1.05 * speed[side][np.argmax(np.abs(speed[side]))]])
        right.plot(ends, line(ends), color="0.5", linewidth=0.8)
    right.set(xlabel="motor speed [rpm]", ylabel="torque at 180 deg [µNm]")
    for axes in (left, right):
        axes.grid(True, alpha=0.3)
    return drawing(
        "torque", "Alpha motor of one unit: torque over the output angle and over the speed.", canvas
    )
