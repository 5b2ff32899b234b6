"""Fig. 10: deviation from a linear gear and backlash, as the calibration finds them."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.calibration import NEGATIVE, POSITIVE, TransmissionMaps
from fiberloom.calibration.transmission.backlash import backlash_at_knots_deg, gap_motor_deg
from fiberloom.instruments.model import AXES
from fiberloom.studies.paper.bench import calibrated, make_bench
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Kind, Quantity, quantity
from fiberloom.twin import Units
from fiberloom.typing import Floats

UNITS = 8
POINTS, MORE_POINTS = 200, 800
PAPER_PEAKS, PAPER_BACKLASH_DEG = 36.0, (40.0, 250.0)
_TEETH = (12, 100)
"""Orders among which the tooth pairings are looked for: above eccentricities, below what 200 points see."""


@dataclass(frozen=True)
class GearCurves:
    """What the calibration of one seed's units says."""

    gap_deg: Floats
    """(2,) smallest and largest gap between the contacts, of any unit and angle, motor deg."""
    backlash_deg: Floats
    """(2,) the same of the backlash by Eq. 7, T- between its knots by a spline."""
    off_deg: Floats
    """(2,) rms of gap and of backlash less the true backlash, motor deg."""
    peaks: Floats
    """(units,) strongest order of delta among those of tooth pairings, alpha, per turn."""
    error_mdeg: Floats
    """(2,) rms error of the map of each axis against the true gear, a constant taken off."""


def measure(seed: int, n_points: int, n_units: int = UNITS) -> GearCurves:
    """Calibrates `n_units` units with `n_points` points per axis and direction."""
    maps, units = calibrated(seed, n_units, n_points).maps, make_bench(seed, n_units).units
    gap, backlash = gap_motor_deg(maps), backlash_at_knots_deg(maps)
    true = _true_backlash_deg(maps, units)
    return GearCurves(
        _ends(gap),
        _ends(backlash),
        np.array([float(np.sqrt(np.nanmean((found - true) ** 2))) for found in (gap, backlash)]),
        _peaks(maps),
        _errors(maps, units),
    )


def _ends(values: Floats) -> Floats:
    return np.array([np.nanmin(values), np.nanmax(values)])


def _true_backlash_deg(maps: TransmissionMaps, units: Units) -> Floats:
    """(N, 2, K) motor deg at the knots of positive contact."""
    true = np.empty_like(maps.output_deg[:, :, 1])
    for row, axis in np.ndindex(true.shape[:2]):
        true[row, axis] = units.transmission(row, axis, maps.output_deg[row, axis, 1])[1]
    return true


def _peaks(maps: TransmissionMaps) -> Floats:
    theta = np.arange(0.5, 360.5, 0.5)[:720]
    delta = maps.delta_deg(theta)[:, 0]
    spectrum = np.abs(np.fft.rfft(delta, axis=-1))[:, _TEETH[0] : _TEETH[1]]
    teeth: Floats = _TEETH[0] + np.argmax(spectrum, axis=-1).astype(float)
    return teeth


def _errors(maps: TransmissionMaps, units: Units) -> Floats:
    theta = np.arange(5.0, 175.0, 0.03)
    found = maps.delta_deg(theta)
    off = np.empty_like(found)
    for row in range(len(units)):
        for axis in (0, 1):
            off[row, axis] = found[row, axis] + theta - units.transmission(row, axis, theta)[0]
    rms: Floats = 1e3 * np.sqrt(off.var(axis=-1).mean(axis=0))
    return rms


def run(settings: Settings) -> FigureOutcome:
    """Ours beside the paper's 36 peaks and 40 to 250 motor degrees."""
    found, more = [], []
    for seed in settings.seeds:
        settings.say(f"Figure 10: seed {seed}")
        found.append(measure(seed, POINTS))
        more.append(measure(seed, MORE_POINTS))
    return FigureOutcome(
        quantities=[
            *_paper_quantities(found),
            *_corrected(found, more),
            *_errors_of(found, POINTS, False),
            *_errors_of(more, MORE_POINTS, True),
        ],
        drawings=[_draw(calibrated(settings.seed, UNITS, POINTS).maps)],
        how=(
            f"{UNITS} units per seed, calibrated over bus and camera (0.669 um rms): {POINTS} points per "
            "axis and direction of contact, both axes. The paper shows one unit; here the smallest and the "
            "largest backlash of all of them."
        ),
        beyond=[
            f"The map's own error is known, because the twin's gear is: {MORE_POINTS} points follow the "
            f"ripple of the gear's earlier stage, 204 times a turn, which {POINTS} cannot. That ripple is an "
            "assumption of the twin (docs/twin.md).",
            "The gap between both contacts at one motor angle is the backlash over the local slope of the "
            "gear, so that its largest value is too large by the ripple's slope. Eq. 7 with a spline "
            "between the knots takes the slope out where the knots are close enough to see it; with "
            f"{POINTS} points nothing does.",
        ],
    )


def _paper_quantities(found: list[GearCurves]) -> list[Quantity]:
    rows = [
        quantity(
            f"fig10.backlash.{word}_motor_deg",
            f"{name} backlash",
            [g.gap_deg[side] for g in found],
            "motor deg",
            Kind.PUT_IN,
            paper=PAPER_BACKLASH_DEG[side],
            note="the extremes of Fig. 10 were put into the units as true backlash; this is the gap between "
            "the contacts, which is backlash over the slope of the gear: the ripple widens the range",
        )
        for side, (word, name) in enumerate((("min", "smallest"), ("max", "largest")))
    ]
    peaks = quantity(
        "fig10.peaks_per_turn",
        "tooth pairings seen as peaks of delta, per turn (alpha)",
        [float(g.peaks.mean()) for g in found],
        "1",
        Kind.PUT_IN,
        paper=PAPER_PEAKS,
        note="strongest order between 12 and 100 of the calibrated map, mean over units",
    )
    return [*rows, peaks]


def _corrected(found: list[GearCurves], more: list[GearCurves]) -> list[Quantity]:
    """What the slope of the gear does to the estimate, and what is left of it."""
    ends = [
        quantity(
            f"fig10.backlash.corrected.{word}_motor_deg",
            f"{name} backlash by Eq. 7 and a spline, {MORE_POINTS} points",
            [g.backlash_deg[side] for g in more],
            "motor deg",
            Kind.PUT_IN,
            paper=PAPER_BACKLASH_DEG[side],
            note="the slope of the gear taken out; the camera's noise stays",
            beyond=True,
        )
        for side, (word, name) in enumerate((("min", "smallest"), ("max", "largest")))
    ]
    ways = (("gap", "gap between the contacts"), ("eq7", "backlash by Eq. 7 and a spline"))
    return [
        *ends,
        *(
            quantity(
                f"fig10.backlash.{way}_{points}.off_motor_deg",
                f"{name}, {points} points, less the true backlash, rms",
                [g.off_deg[k] for g in runs],
                "motor deg",
                beyond=True,
            )
            for k, (way, name) in enumerate(ways)
            for points, runs in ((POINTS, found), (MORE_POINTS, more))
        ),
    ]


def _errors_of(found: list[GearCurves], points: int, beyond: bool) -> list[Quantity]:
    return [
        quantity(
            f"fig10.map_{points}.{name}.error_mdeg",
            f"error of a map of {points} points, {name}, rms",
            [g.error_mdeg[axis] for g in found],
            "mdeg",
            Kind.TUNED,
            note="against the true gear; the ripple beyond the sampling was chosen for Fig. 19's blind error",
            beyond=beyond,
        )
        for axis, name in enumerate(AXES)
    ]


def _draw(maps: TransmissionMaps) -> Drawing:
    canvas, panels = plt.subplots(2, 2, figsize=(11, 6.4), layout="constrained")
    theta = np.linspace(1.0, 359.0, 2400)
    for axis, name in enumerate(AXES):
        x = theta if axis == 0 else theta / 2.0
        for direction, label in ((POSITIVE, "δ+"), (NEGATIVE, "δ−")):
            panels[0, axis].plot(x, maps.delta_deg(x, direction)[0, axis], linewidth=0.8, label=label)
        panels[0, axis].set(title=name, ylabel="δ [deg]")
        panels[0, axis].legend(fontsize=8)
        panels[1, axis].plot(x, maps.backlash_motor_deg(x)[0, axis], linewidth=0.8, color="0.3")
        panels[1, axis].set(xlabel="θ [deg]", ylabel="backlash [motor deg]")
        for limit in PAPER_BACKLASH_DEG:
            panels[1, axis].axhline(limit, color="crimson", linestyle=":", linewidth=1)
    return drawing(
        "transmission",
        "One unit as calibrated: deviation from a linear gear for both contacts, and the backlash; "
        "dotted: the paper's 40 and 250 motor degrees.",
        canvas,
    )
