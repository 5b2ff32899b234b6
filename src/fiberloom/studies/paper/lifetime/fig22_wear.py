"""Fig. 22: the non-linear transmission over a lifetime test."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.studies.paper.lifetime.wearing import Study, compared
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Kind, Quantity, quantity

PAPER_CHANGE_DEG = 0.15


def largest_change_deg(study: Study) -> float:
    """Of delta as recalibrated, anywhere, from the first to the last cycle."""
    seen = study.delta_deg("recalibrated")
    return float(np.abs(seen[:, -1] - seen[:, 0]).max())


def run(settings: Settings) -> FigureOutcome:
    """Ours beside the paper's local changes of up to 0.15 deg."""
    return compared(settings, 22, _quantities, _draw)


def _quantities(found: list[Study]) -> list[Quantity]:
    return [
        quantity(
            "fig22.largest_change_deg",
            "largest change of beta's delta, as recalibrated",
            [largest_change_deg(s) for s in found],
            "deg",
            Kind.TUNED,
            paper=PAPER_CHANGE_DEG,
            note="the heights of the marks were chosen for it; the paper shows two units, here the most of "
            "four",
        )
    ]


def _draw(study: Study) -> Drawing:
    canvas, panels = plt.subplots(2, 1, figsize=(8.5, 6), sharex=True, layout="constrained")
    seen = study.delta_deg("recalibrated")
    for row, axes in enumerate(panels):
        for place, cycle in enumerate(study.settings.kept):
            axes.plot(study.angles_deg, seen[row, place], linewidth=0.9, label=f"cycle {cycle}")
        axes.set(ylabel="δ of beta [deg]", title=f"unit {row + 1}")
        axes.grid(True, alpha=0.3)
    panels[0].legend(fontsize=8)
    panels[1].set_xlabel("θ [deg]")
    return drawing("delta", "Two units: deviation from a linear gear as calibrated in these cycles.", canvas)
