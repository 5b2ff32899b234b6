"""Fig. 5: how many fibres reach each point of a focal plane with p = l_a + l_b."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from fiberloom.design.lattice import EVERY, Lattice, Pattern
from fiberloom.instruments.model import METROLOGY
from fiberloom.studies.paper.bench import paper_instrument
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Kind, Quantity, ordering, quantity
from fiberloom.typing import Floats

Counts = NDArray[np.int64]

EVERY_SECOND = Pattern(2, 1, (0,), staggered=True)
"""Along each row, rows shifted against each other so that gaps do not line up."""
STEP_MM, FINE_MM = 0.5, 0.2


@dataclass(frozen=True)
class CoverageMap:
    """Fibres that reach the points of a grid around the centre of the field."""

    x_mm: Floats
    y_mm: Floats
    count: Counts
    """(len(y), len(x))"""

    @property
    def covered(self) -> float:
        """Share of the points that at least one fibre reaches."""
        return float((self.count > 0).mean())

    @property
    def mean(self) -> float:
        """Mean count of fibres per point."""
        return float(self.count.mean())


def cover(lattice: Lattice, pattern: Pattern, step_mm: float) -> CoverageMap:
    """Counts the fibres that reach each point of four pitches, by Eq. 2 and the ranges."""
    half = 2.0 * lattice.pitch_mm
    x, y = (np.arange(-side, side, step_mm) + 0.5 * step_mm for side in (half, half * np.sqrt(0.75)))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return CoverageMap(x, y, lattice.count(grid, pattern, free=False).reshape(len(y), len(x)))


def run(settings: Settings) -> FigureOutcome:
    """Ours beside the paper's two maps: full coverage, and almost full coverage."""
    lattice = Lattice.of(paper_instrument(), METROLOGY)
    step_mm = FINE_MM if settings.full else STEP_MM
    settings.say("Figure 5: coverage")
    one = cover(lattice, EVERY, step_mm)
    half = cover(lattice, EVERY_SECOND, step_mm)
    return FigureOutcome(
        quantities=_quantities(lattice, one, half),
        drawings=[_draw(lattice, one, half)],
        how=(
            "A lattice of perfect units with the paper's arms (7.4 and 15 mm) and p = 22.4 "
            f"mm; for every point of a grid of {step_mm:g} mm over four pitches of the middle, who reaches "
            "it by Eq. 2 and the ranges of the axes."
        ),
    )


def _quantities(lattice: Lattice, one: CoverageMap, half: CoverageMap) -> list[Quantity]:
    mean = lattice.mean
    return [
        ordering(
            "fig05.order.full_coverage",
            "every point of the plane is reached if every positioner has a fibre",
            one.covered == 1.0,
            Kind.IDENTITY,
            note="geometry: every positioner reaches the centre of its neighbours",
        ),
        quantity(
            "fig05.every.mean",
            "fibres per point, every positioner",
            one.mean,
            "1",
            Kind.IDENTITY,
            note=f"the paper prints a map and no number; the ratio of areas of its design is {mean:.3f}",
        ),
        quantity(
            "fig05.every.min",
            "fewest fibres at any point, every positioner",
            float(one.count.min()),
            "1",
            Kind.IDENTITY,
            note="the paper prints a map and no number",
        ),
        quantity(
            "fig05.second.covered",
            "share of the plane reached, every second positioner",
            half.covered,
            "1",
            Kind.IDENTITY,
            note="the paper: almost full coverage, no number; which ones carry a fibre is our choice (every "
            "second along rows that are shifted against each other)",
        ),
        quantity(
            "fig05.second.mean",
            "fibres per point, every second positioner",
            half.mean,
            "1",
            Kind.IDENTITY,
            note=f"half the ratio of areas is {0.5 * mean:.3f}; no number in the paper",
        ),
    ]


def _draw(lattice: Lattice, one: CoverageMap, half: CoverageMap) -> Drawing:
    canvas, panels = plt.subplots(1, 2, figsize=(11.5, 4.9), layout="constrained")
    q, r = (a.ravel() for a in np.meshgrid(np.arange(-5, 6), np.arange(-5, 6)))
    titles = ("every positioner has a fibre", "every second positioner has one")
    top = int(one.count.max())
    for axes, found, pattern, title in zip(panels, (one, half), (EVERY, EVERY_SECOND), titles, strict=True):
        extent = (found.x_mm[0], found.x_mm[-1], found.y_mm[0], found.y_mm[-1])
        image = axes.imshow(
            found.count,
            origin="lower",
            extent=extent,
            cmap=plt.get_cmap("viridis", top + 1),
            vmin=-0.5,
            vmax=top + 0.5,
        )
        centres = lattice.centres_mm(q, r)[pattern.carries(q, r)]
        axes.plot(*centres.T, "o", color="white", markersize=3, markeredgecolor="black")
        axes.set(title=title, xlabel="x [mm]", ylabel="y [mm]", xlim=extent[:2], ylim=extent[2:])
    canvas.colorbar(image, ax=panels, label="fibres that reach the point", ticks=range(top + 1))
    return drawing(
        "coverage", "Fibres that reach each point; dots: centres of positioners with a fibre.", canvas
    )
