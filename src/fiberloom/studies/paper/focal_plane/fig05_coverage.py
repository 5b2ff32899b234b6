"""Fig. 5: how many fibres reach each point of a focal plane with p = l_a + l_b."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from fiberloom.instruments import FocalPlane, Instrument, generate
from fiberloom.instruments.model import METROLOGY
from fiberloom.studies.paper.bench import paper_instrument
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Kind, Quantity, ordering, quantity
from fiberloom.typing import Floats

Counts = NDArray[np.int64]

RINGS = 5
STEP_MM, FINE_MM = 0.5, 0.2


@dataclass(frozen=True)
class Coverage:
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


def hexagonal(instrument: Instrument) -> FocalPlane:
    """Perfect units in every hole: a coverage is a matter of the design."""
    none = {"sd": 0.0, "min": 0.0, "max": 0.0, "mean": 0.0}
    scatter = instrument.scatter
    exact = {name: type(getattr(scatter, name))(**none) for name in type(scatter).model_fields}
    exact["l_alpha_mm"] = scatter.l_alpha_mm.model_copy(
        update={"mean": instrument.positioner.l_alpha_mm, "sd": 0.0, "min": None, "max": None}
    )
    n_holes = 3 * RINGS * (RINGS + 1) + 1
    layout = instrument.layout.model_copy(
        update={"rings": RINGS, "n_positioners": n_holes, "fiducial_lattice": None, "guide_cameras": None}
    )
    perfect = scatter.model_copy(update=exact)
    return generate(instrument.model_copy(update={"layout": layout, "scatter": perfect}), seed=0)


def cover(plane: FocalPlane, rows: NDArray[np.intp], step_mm: float) -> Coverage:
    """Counts the fibres that reach each point of four pitches of the middle, by Eq. 2 and the ranges."""
    half = 2.0 * plane.instrument.layout.pitch_mm
    x, y = (np.arange(-side, side, step_mm) + 0.5 * step_mm for side in (half, half * np.sqrt(0.75)))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    count = np.zeros(len(grid), dtype=np.int64)
    for row in rows:
        count += plane.inverse(grid, METROLOGY, index=np.full(len(grid), row)).reachable
    return Coverage(x, y, count.reshape(len(y), len(x)))


def every_second(plane: FocalPlane) -> NDArray[np.intp]:
    """Every second one along each row, rows shifted against each other so that gaps do not line up."""
    pitch = plane.instrument.layout.pitch_mm
    x, y = plane.centres_mm.T
    r = np.rint(y / (pitch * np.sqrt(0.75))).astype(int)
    q = np.rint(x / pitch - 0.5 * r).astype(int)
    return np.flatnonzero((q + r // 2) % 2 == 0)


def run(settings: Settings) -> FigureOutcome:
    """Ours beside the paper's two maps: full coverage, and almost full coverage."""
    instrument = paper_instrument()
    plane = hexagonal(instrument)
    step_mm = FINE_MM if settings.full else STEP_MM
    settings.say("Figure 5: coverage")
    one = cover(plane, np.arange(len(plane)), step_mm)
    half = cover(plane, every_second(plane), step_mm)
    return FigureOutcome(
        quantities=_quantities(instrument, one, half),
        drawings=[_draw(plane, one, half)],
        how=(
            f"A hexagon of {len(plane)} perfect units with the paper's arms (7.4 and 15 mm) and p = 22.4 "
            f"mm; for every point of a grid of {step_mm:g} mm over four pitches of the middle, who reaches "
            "it by Eq. 2 and the ranges of the axes."
        ),
    )


def area_ratio(instrument: Instrument) -> float:
    """Mean number of fibres per point, a ratio: area of the annulus over the area per positioner."""
    l_alpha, l_beta = instrument.positioner.l_alpha_mm, instrument.positioner.points[METROLOGY].x_mm
    annulus = np.pi * ((l_alpha + l_beta) ** 2 - (l_alpha - l_beta) ** 2)
    return float(annulus / (instrument.layout.pitch_mm**2 * np.sqrt(0.75)))


def _quantities(instrument: Instrument, one: Coverage, half: Coverage) -> list[Quantity]:
    mean = area_ratio(instrument)
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


def _draw(plane: FocalPlane, one: Coverage, half: Coverage) -> Drawing:
    canvas, panels = plt.subplots(1, 2, figsize=(11.5, 4.9), layout="constrained")
    rows = (np.arange(len(plane)), every_second(plane))
    titles = ("every positioner has a fibre", "every second positioner has one")
    top = int(one.count.max())
    for axes, found, with_fibre, title in zip(panels, (one, half), rows, titles, strict=True):
        extent = (found.x_mm[0], found.x_mm[-1], found.y_mm[0], found.y_mm[-1])
        image = axes.imshow(
            found.count,
            origin="lower",
            extent=extent,
            cmap=plt.get_cmap("viridis", top + 1),
            vmin=-0.5,
            vmax=top + 0.5,
        )
        axes.plot(*plane.centres_mm[with_fibre].T, "o", color="white", markersize=3, markeredgecolor="black")
        axes.set(title=title, xlabel="x [mm]", ylabel="y [mm]", xlim=extent[:2], ylim=extent[2:])
    canvas.colorbar(image, ax=panels, label="fibres that reach the point", ticks=range(top + 1))
    return drawing(
        "coverage", "Fibres that reach each point; dots: centres of positioners with a fibre.", canvas
    )
