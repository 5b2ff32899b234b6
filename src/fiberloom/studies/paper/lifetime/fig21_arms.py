"""Fig. 21: calibrated arm lengths over a lifetime test."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.instruments.model import AXES
from fiberloom.studies.paper.lifetime.wearing import Study, compared
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Kind, Quantity, quantity
from fiberloom.units import UM_PER_MM

PAPER_SPAN_UM = 1.0


def span_um(study: Study) -> float:
    """Largest less smallest calibrated length over the cycles, of the arm that changes most."""
    return float(UM_PER_MM * np.ptp(study.rows["arms_mm"], axis=1).max())


def scatter_um(study: Study) -> float:
    """rms of calibrated less true lengths."""
    off = study.rows["arms_mm"] - study.rows["true_arms_mm"]
    return float(UM_PER_MM * np.sqrt(np.mean(off**2)))


def run(settings: Settings) -> FigureOutcome:
    """Ours beside the paper's: within about one micrometre."""
    return compared(settings, 21, _quantities, _draw)


def _quantities(found: list[Study]) -> list[Quantity]:
    return [
        quantity(
            "fig21.span_um",
            "largest change of a calibrated arm length over the test",
            [span_um(s) for s in found],
            "um",
            Kind.PUT_IN,
            paper=PAPER_SPAN_UM,
            note="true lengths change by what the paper shows; the calibration adds its own scatter",
        ),
        quantity(
            "fig21.calibration_um",
            "calibrated against true length, rms",
            [scatter_um(s) for s in found],
            "um",
            beyond=True,
        ),
    ]


def _draw(study: Study) -> Drawing:
    canvas, axes = plt.subplots(figsize=(7.5, 4), layout="constrained")
    for row in range(2):
        for arm, name in enumerate(AXES):
            true, seen = study.rows["true_arms_mm"][row, :, arm], study.rows["arms_mm"][row, :, arm]
            (line,) = axes.plot(study.cycles, UM_PER_MM * (true - true[0]), linewidth=0.9)
            label = f"unit {row + 1}, {name} arm"
            axes.plot(study.cycles, UM_PER_MM * (seen - true[0]), "o", color=line.get_color(), label=label)
    axes.set(xlabel="cycle", ylabel="change of length [µm]")
    axes.legend(fontsize=8)
    axes.grid(True, alpha=0.3)
    return drawing("lengths", "Two units: arm lengths as calibrated (dots) and in truth (lines).", canvas)
