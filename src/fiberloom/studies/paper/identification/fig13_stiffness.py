"""Fig. 13: stiffness of the gears from known torques on the arms."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.instruments.model import AXES
from fiberloom.studies.paper.identification.identified import UNITS, Identified, each_seed
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Kind, Quantity, quantity

PAPER_MNM_PER_DEG = (337.0, 25.0)
TORQUE_MNM = (11.8, 1.4)


def run(settings: Settings) -> FigureOutcome:
    """Ours beside the paper's 337 and 25 mNm/deg."""
    found = each_seed(settings, 13)
    return FigureOutcome(
        quantities=[q for axis in (0, 1) for q in _quantities(found, axis)],
        drawings=[_draw(found)],
        how=(
            f"{UNITS} units per seed: {TORQUE_MNM[0]:g} mNm on alpha and {TORQUE_MNM[1]:g} mNm on beta, to "
            "both sides, ten times, motors at rest; the camera of the full workspace (0.669 um) sees by how "
            "much the arms turn, four images at each torque. The weights are known to 0.3 %."
        ),
    )


def _off(found: Identified, axis: int) -> float:
    """rms relative difference from the true stiffness."""
    true = found.bench.units.plant["stiffness"][:, axis] * np.pi / 180.0 * 1e3
    return float(np.sqrt(np.mean((found.stiffness[axis].value / true - 1.0) ** 2)))


def _quantities(found: list[Identified], axis: int) -> list[Quantity]:
    name = AXES[axis]
    return [
        quantity(
            f"fig13.{name}.stiffness",
            f"{name}: torque over angle, mean of the units",
            [float(np.mean(f.stiffness[axis].value)) for f in found],
            "mNm/deg",
            Kind.PUT_IN,
            paper=PAPER_MNM_PER_DEG[axis],
            note="the paper's value is the mean of the units, which scatter by 5 %; the camera measures them",
        ),
        quantity(
            f"fig13.{name}.error_percent",
            f"{name}: measured against true stiffness, rms",
            [100.0 * _off(f, axis) for f in found],
            "%",
            beyond=True,
        ),
    ]


def _draw(found: list[Identified]) -> Drawing:
    canvas, panels = plt.subplots(1, 2, figsize=(9.5, 4), layout="constrained")
    for axis, axes in enumerate(panels):
        true, seen, error = [], [], []
        for f in found:
            true += list(f.bench.units.plant["stiffness"][:, axis] * np.pi / 180.0 * 1e3)
            seen += list(f.stiffness[axis].value)
            error += list(f.stiffness[axis].standard_error)
        axes.errorbar(true, seen, yerr=error, fmt="o", markersize=4, capsize=2)
        ends = np.array([min(true), max(true)])
        axes.plot(ends, ends, color="0.6", linewidth=0.8)
        axes.axhline(PAPER_MNM_PER_DEG[axis], color="crimson", linestyle=":", label="paper")
        axes.set(title=AXES[axis], xlabel="true stiffness [mNm/deg]", ylabel="measured [mNm/deg]")
        axes.legend(fontsize=8)
    return drawing("stiffness", "Every unit: measured against true stiffness, with standard errors.", canvas)
