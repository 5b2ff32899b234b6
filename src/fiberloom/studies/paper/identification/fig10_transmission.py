"""Fig. 10: deviation from a linear gear and backlash, as the calibration finds them."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.calibration import NEGATIVE, POSITIVE, TransmissionMaps
from fiberloom.instruments.model import AXES
from fiberloom.studies.paper.bench import calibrated, make_bench
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Kind, Quantity, quantity
from fiberloom.twin import Units
from fiberloom.typing import Floats

UNITS = 8
POINTS, MORE_POINTS = 200, 400
PAPER_PEAKS, PAPER_BACKLASH_DEG = 36.0, (40.0, 250.0)
_TEETH = (12, 100)
"""Orders among which the tooth pairings are looked for: above eccentricities, below what 200 points see."""


@dataclass(frozen=True)
class GearCurves:
    """What the calibration of one seed's units says."""

    backlash_deg: Floats
    """(2,) smallest and largest backlash of any unit and angle, motor deg."""
    peaks: Floats
    """(units,) strongest order of delta among those of tooth pairings, alpha, per turn."""
    error_mdeg: Floats
    """(2,) rms error of the map of each axis against the true gear, a constant taken off."""


def measure(seed: int, n_points: int, n_units: int = UNITS) -> GearCurves:
    """Calibrates `n_units` units with `n_points` points per axis and direction."""
    maps = calibrated(seed, n_units, n_points).maps
    return GearCurves(_backlash_range(maps), _peaks(maps), _errors(maps, make_bench(seed, n_units).units))


def _backlash_range(maps: TransmissionMaps) -> Floats:
    """At the knots: in between the interpolation of both directions would come in."""
    gap = maps.provenance.gear * (maps.output_deg[:, :, 0] - maps.output_deg[:, :, 1])
    return np.array([gap.min(), gap.max()])


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
            "The map's own error is known, because the twin's gear is: twice the points halve the blind "
            "error, since the gear's earlier stage ripples 204 times a turn, which 200 points cannot "
            "follow. That ripple is an assumption of the twin (docs/twin.md)."
        ],
    )


def _paper_quantities(found: list[GearCurves]) -> list[Quantity]:
    rows = [
        quantity(
            f"fig10.backlash.{word}_motor_deg",
            f"{name} backlash",
            [g.backlash_deg[side] for g in found],
            "motor deg",
            Kind.PUT_IN,
            paper=PAPER_BACKLASH_DEG[side],
            note="the extremes of Fig. 10 were put into the units; the calibration gives them back",
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
