"""Fig. 20: errors of centre and arm lengths against the number of configurations (Eq. 26)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.blocking import finish
from fiberloom.bus import Client
from fiberloom.calibration import TransmissionMaps, calibrate_transmission
from fiberloom.calibration.focal_plane.fit import FitSettings, fit_focal_plane, layout_parameters
from fiberloom.instruments import FocalPlane
from fiberloom.operation.survey import SurveySettings, survey
from fiberloom.studies.paper.bench import Mover, PaperBench, calibrated, make_bench, paper_plane
from fiberloom.studies.paper.no_record import NoRecord
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Bound, Kind, Quantity, quantity
from fiberloom.twin import bench_hardware, draw_units, field_hardware
from fiberloom.twin.draw import misplaced
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

BENCH_UNITS, FIELD_UNITS, MANY_UNITS = 12, 7, 37
STEPS = (10, 14, 20, 28, 40, 57, 80, 113, 160)
FIELD_STEPS = (6, 8, 10, 14, 20)
PAPER_CONFIGURATIONS, PAPER_UM = 80.0, 1.0
MOUNTED_UM, MOUNTED_DEG = 50.0, 0.2
"""How far the first guess is off, rms: Eq. 26 begins there."""
EQUAL_WEIGHTS = FitSettings(camera_um=10.0, angles_deg=(0.0, 0.0), fit_angles=False)
"""Eq. 26 weighs all alike; 10 um is what a residual is about, so that no honest one is an outlier."""


@dataclass(frozen=True)
class Convergence:
    """rms errors over units, um, by number of configurations."""

    steps: tuple[int, ...]
    centre_um: Floats
    arms_um: Floats
    """Of both arm lengths."""

    def needed(self) -> float:
        """Configurations from which both stay below 1 um; interpolated, NaN if never."""
        worst = np.log(np.maximum(self.centre_um, self.arms_um) / PAPER_UM)
        above = np.flatnonzero(worst > 0.0)
        if not len(above):
            return float(self.steps[0])
        last = int(above[-1])
        if last + 1 == len(self.steps):
            return float("nan")
        share = worst[last] / (worst[last] - worst[last + 1])
        logs = np.log(self.steps)
        return float(np.exp(logs[last] + share * (logs[last + 1] - logs[last])))


async def spread_out(
    bench: PaperBench, maps: TransmissionMaps, number: int, seed: int
) -> tuple[Floats, Floats]:
    """Angles in deg by the `maps` and seen positions in mm, both (N, S, 2), on a `bench`.

    S = `number` configurations drawn evenly over both axes from the `seed`.
    """
    rng = np.random.default_rng([seed, 20])
    mover = Mover(bench)
    await bench.client.set_precise_moves(bench.ids, on=True)
    (low, high), size = bench.plane.limits_deg.T, (len(bench.plane), 2)
    theta, xy = np.empty((2, len(bench.plane), number, 2))
    for k in range(number):
        await mover.goto(maps.to_wire(rng.uniform(low, high, size)))
        xy[:, k] = bench.camera.measure().xy_mm
        theta[:, k] = maps.to_output((await bench.client.positions_deg(bench.ids))[0])
    return theta, xy


def errors(
    guess: FocalPlane, data: tuple[Floats, Floats], fit: FitSettings, truth: Floats, steps: tuple[int, ...]
) -> Convergence:
    """Fits the first so many configurations, for each of the `steps`.

    `guess`: the layout before; `data`: angles in deg and places in mm, (N, S, 2); `fit`: settings;
    `truth` (N, 6) in mm and rad.
    """
    rows = []
    for number in steps:
        found = fit_focal_plane(guess, data[0][:, :number], data[1][:, :number], fit)
        off = UM_PER_MM * (found.parameters[:, :4] - truth[:, :4])
        rows.append([np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1))), np.sqrt(np.mean(off[:, 2:] ** 2))])
    centre, arms = np.array(rows).T
    return Convergence(steps, centre, arms)


def as_printed(seed: int, n_units: int = BENCH_UNITS, steps: tuple[int, ...] = STEPS) -> Convergence:
    """Eq. 26 with equal weights, on single units, at configurations all over the workspace."""
    bench = make_bench(seed, n_units)
    data = finish(spread_out(bench, calibrated(seed, n_units).maps, steps[-1], seed))
    guess = misplaced(bench.plane, MOUNTED_UM, MOUNTED_DEG, seed)
    return errors(guess, data, EQUAL_WEIGHTS, _truth(bench.plane, bench.units.arms), steps)


def designed(seed: int, n_units: int = FIELD_UNITS, steps: tuple[int, ...] = FIELD_STEPS) -> Convergence:
    """Among neighbours, planned and verified: chosen configurations, weights by what is known."""
    plane = paper_plane(seed, n_units)
    units = draw_units(plane, seed)
    bench = bench_hardware(plane, units, seed)
    client = Client(bench.bus)

    async def calibrate() -> TransmissionMaps:
        await client.discover()
        return (await calibrate_transmission(client, bench.camera, plane, seed=seed)).maps

    maps = finish(calibrate())
    guess = misplaced(plane, MOUNTED_UM, MOUNTED_DEG, seed)
    settings = SurveySettings(configurations=steps[-1], seed=seed)
    data = finish(survey(guess, maps, field_hardware(plane, units, seed), settings, NoRecord()))
    return errors(guess, (data.theta_deg, data.xy_mm), settings.fit, _truth(plane, units.arms), steps)


def _truth(plane: FocalPlane, arms: Floats) -> Floats:
    return layout_parameters(replace(plane, arms=arms))


def run(settings: Settings) -> FigureOutcome:
    """Ours beside the paper's 80 configurations for 1 um."""
    n_field = MANY_UNITS if settings.full else FIELD_UNITS
    printed, better = [], []
    for seed in settings.seeds:
        settings.say(f"Figure 20: seed {seed}, Eq. 26")
        printed.append(as_printed(seed))
        settings.say(f"Figure 20: seed {seed}, survey of a field")
        better.append(designed(seed, n_field))
    return FigureOutcome(
        quantities=_quantities(printed, better),
        drawings=[_draw(printed, better)],
        how=(
            f"{BENCH_UNITS} single units per seed, up to {STEPS[-1]} configurations drawn evenly over both "
            "axes, angles by maps of 200 points, camera of 0.669 um, first guess 50 um and 0.2 deg off; "
            "least squares with equal weights for centre, both lengths and both zeros. Errors are against "
            "the true unit."
        ),
        beyond=[
            f"The survey of `fiberloom calibrate focal-plane`, {n_field} units among their neighbours: every "
            "next configuration is the one that tells most, and residuals across a lever, where the maps are "
            "wrong, weigh less than those along it. It needs fewer configurations for the same micrometre."
        ],
    )


def _at(runs: list[Convergence], number: int, what: str) -> list[float]:
    return [float(getattr(c, what)[c.steps.index(number)]) for c in runs]


_WHAT = (("centre_um", "centre"), ("arms_um", "arm lengths"))


def _quantities(printed: list[Convergence], better: list[Convergence]) -> list[Quantity]:
    last = better[0].steps[-1]
    return [
        quantity(
            "fig20.configurations",
            "configurations until centre and arms are below 1 um rms, Eq. 26",
            [c.needed() for c in printed],
            "1",
            paper=PAPER_CONFIGURATIONS,
            note="the maps' error (tuned to the blind error of Fig. 19) is what is averaged away, so the "
            "number goes with its square: 10 to 15 % less would give 80. Ours is against the true unit; the "
            "paper does not say what its errors are against, and its own best estimate would hide what is "
            "common to both",
        ),
        *(
            quantity(
                f"fig20.at_80.{what}",
                f"error of the {name} after 80 configurations, rms",
                _at(printed, 80, what),
                "um",
                Kind.BOUND,
                paper=PAPER_UM,
                bound=Bound.AT_MOST,
                note="the paper: well below one micrometre with about 80. Ours averages the maps' error, 9 "
                "um a configuration"
                " on the twin, down to this: 15 % less would do",
            )
            for what, name in _WHAT
        ),
        quantity(
            "fig20.designed.configurations",
            "configurations until both are below 1 um rms, survey of a field",
            [c.needed() for c in better],
            "1",
            Kind.BOUND,
            paper=PAPER_CONFIGURATIONS,
            bound=Bound.AT_MOST,
            beyond=True,
        ),
        *(
            quantity(
                f"fig20.designed.at_{last}.{what}",
                f"error of the {name} after {last} configurations, survey of a field",
                _at(better, last, what),
                "um",
                beyond=True,
            )
            for what, name in _WHAT
        ),
    ]


def _draw(printed: list[Convergence], better: list[Convergence]) -> Drawing:
    canvas, axes = plt.subplots(figsize=(7.5, 4.8), layout="constrained")
    for runs, label, colour in ((printed, "Eq. 26", "tab:blue"), (better, "survey", "tab:green")):
        for (what, name), style in zip(_WHAT, ("o-", "s--"), strict=True):
            curves = np.array([getattr(c, what) for c in runs])
            mean = np.sqrt(np.mean(curves**2, axis=0))
            axes.plot(runs[0].steps, mean, style, color=colour, markersize=4, label=f"{label}: {name}")
    axes.axhline(PAPER_UM, color="crimson", linestyle=":")
    axes.plot(PAPER_CONFIGURATIONS, PAPER_UM, "o", color="crimson", label="paper")
    axes.set(xscale="log", yscale="log", xlabel="configurations", ylabel="error, rms over units [µm]")
    ticks = sorted({*STEPS, *FIELD_STEPS} - {113, 57, 28})
    axes.set_xticks(ticks, [str(s) for s in ticks])
    axes.set_yticks((0.2, 0.5, 1.0, 2.0, 5.0), ("0.2", "0.5", "1", "2", "5"))
    axes.minorticks_off()
    axes.grid(True, alpha=0.3)
    axes.legend(fontsize=8)
    return drawing("convergence", "Error of the calibrated centre and arm lengths.", canvas)
