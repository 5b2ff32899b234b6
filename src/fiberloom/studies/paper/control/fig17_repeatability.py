"""Fig. 17: three targets 1 um apart, each approached again and again, seen by the close-up camera."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.blocking import finish
from fiberloom.instruments.model import AXES
from fiberloom.studies.paper.bench import CLOSE_UP_UM, Mover, PaperBench, make_bench
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Kind, Quantity, quantity
from fiberloom.twin import Units
from fiberloom.typing import Floats
from fiberloom.units import GEAR, RUN_UP_MOTOR_DEG, UM_PER_MM, motor_to_output_deg, rad_to_deg

UNITS = 6
VISITS = 300
TARGETS = 3
BACK_AND_FORTH_DEG = motor_to_output_deg(RUN_UP_MOTOR_DEG, GEAR)
LEVER_MM = (7.6, 15.0)
PAPER_NM = (160.0, 130.0)
PAPER_STEP_DEG = (7.7, 3.9)
START_DEG = (100.0, 178.0)
"""Folded, as in the paper: a lever of 15 - 7.4 = 7.6 mm for alpha."""


@dataclass(frozen=True)
class Visits:
    """Seen positions (visits, targets, units, 2) in um about the first one of each unit."""

    axis: int
    xy_um: Floats

    def rms_nm(self) -> Floats:
        """(units,) rms distance from the mean position of each target, camera included."""
        off = self.xy_um - self.xy_um.mean(axis=0)
        visits = len(self.xy_um)
        variance = (off**2).sum(axis=-1).mean(axis=(0, 1)) * visits / (visits - 1)
        rms: Floats = 1e3 * np.sqrt(variance)
        return rms

    @property
    def mean_rms_nm(self) -> float:
        """Over units."""
        return float(np.sqrt(np.mean(self.rms_nm() ** 2)))

    def apart_um(self) -> Floats:
        """(units, 2) distances between the means of neighbouring targets."""
        steps: Floats = np.linalg.norm(np.diff(self.xy_um.mean(axis=0), axis=0), axis=-1).T
        return steps


def visit(bench: PaperBench, axis: int, visits: int) -> Visits:
    """Sends one axis to the three targets in turn, `visits` times; the other one does not move."""
    return finish(_visit(bench, axis, visits))


async def _visit(bench: PaperBench, axis: int, visits: int) -> Visits:
    home_deg = bench.rest_wire_deg(START_DEG)
    step_deg = float(rad_to_deg(1.0 / UM_PER_MM / LEVER_MM[axis]))
    mover = Mover(bench)
    xy = np.empty((visits, TARGETS, len(bench.plane), 2))
    for turn in range(visits):
        for target in range(TARGETS):
            for leg_deg in (BACK_AND_FORTH_DEG, 0.0):
                wire_deg = home_deg.copy()
                wire_deg[:, axis] += target * step_deg + leg_deg
                await mover.goto(wire_deg)
            xy[turn, target] = bench.camera.measure().xy_mm
    return Visits(axis, UM_PER_MM * (xy - xy[0, 0]))


def run(settings: Settings) -> FigureOutcome:
    """Ours beside the paper's 160 nm (alpha) and 130 nm (beta)."""
    found: dict[int, list[Visits]] = {0: [], 1: []}
    exact: dict[int, list[Visits]] = {0: [], 1: []}
    for seed in settings.seeds:
        for axis in (0, 1):
            settings.say(f"Figure 17: seed {seed}, {AXES[axis]}")
            bench = make_bench(seed, UNITS, noise_um=CLOSE_UP_UM, start_deg=START_DEG)
            found[axis].append(visit(bench, axis, VISITS))
            perfect = make_bench(seed, UNITS, noise_um=0.0, change=_exact_gears, start_deg=START_DEG)
            exact[axis].append(visit(perfect, axis, VISITS // 6))
    return FigureOutcome(
        quantities=[q for axis in (0, 1) for q in _quantities(axis, found[axis], exact[axis])],
        drawings=[_scatter(found[0][0], found[1][0])],
        how=(
            f"{UNITS} units per seed, {VISITS} visits to each of three targets, 840 motor degrees back and "
            "forth before each; beta folded while alpha moves (a lever of 7.6 mm), as in the paper. The "
            "camera repeats to 101 nm."
        ),
    )


def _exact_gears(units: Units) -> None:
    units.plant["seat_rms"] = 0.0


def _quantities(axis: int, found: list[Visits], exact: list[Visits]) -> list[Quantity]:
    name = AXES[axis]
    return [
        quantity(
            f"fig17.{name}.rms_nm",
            f"{name}: repeatability with the camera, rms",
            [v.mean_rms_nm for v in found],
            "nm",
            Kind.TUNED,
            paper=PAPER_NM[axis],
            note="how a gear seats anew after each move is a parameter of the twin, chosen for this figure",
        ),
        quantity(
            f"fig17.{name}.step_motor_deg",
            f"{name}: 1 um at the fibre, in motor degrees",
            float(rad_to_deg(1.0 / UM_PER_MM / LEVER_MM[axis])) * GEAR,
            "deg",
            Kind.IDENTITY,
            paper=PAPER_STEP_DEG[axis],
            note=f"geometry: 1 um over the lever, times {GEAR:g}",
        ),
        quantity(
            f"fig17.{name}.apart_um",
            f"{name}: targets apart, as seen",
            [float(v.apart_um().mean()) for v in found],
            "um",
            Kind.PUT_IN,
            paper=1.0,
            note="what was sent, by a linear ratio: the local slope of the gear stays in it",
        ),
        quantity(
            f"fig17.{name}.control_nm",
            f"{name}: what hall noise and control alone leave, rms",
            [v.mean_rms_nm for v in exact],
            "nm",
            note="perfect gears, perfect camera",
            beyond=True,
        ),
    ]


def _scatter(alpha: Visits, beta: Visits) -> Drawing:
    canvas, panels = plt.subplots(1, 2, figsize=(10, 4.8), layout="constrained")
    for axes, seen in zip(panels, (alpha, beta), strict=True):
        xy = seen.xy_um[:, :, 0]
        xy = xy - xy.mean(axis=(0, 1))
        for target in range(TARGETS):
            axes.plot(*xy[:, target].T, ".", markersize=4, label=f"target {target + 1}")
        axes.set(aspect="equal", xlabel="x [µm]", ylabel="y [µm]", xlim=(-1.8, 1.8), ylim=(-1.8, 1.8))
        rms = seen.rms_nm()[0]
        axes.set_title(f"{AXES[seen.axis]}: {rms:.0f} nm rms (paper: {PAPER_NM[seen.axis]:.0f})")
        axes.grid(True, alpha=0.3)
    panels[0].legend()
    return drawing(
        "targets", "One unit: every dot is one visit, seen by the camera. Left alpha, right beta.", canvas
    )
