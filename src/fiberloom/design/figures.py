"""Diagrams of the design tools; titles say the result."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes

from fiberloom.design.array_coverage import ArrayCoverage
from fiberloom.design.coverage import Coverage
from fiberloom.design.lattice import Lattice, Pattern
from fiberloom.report.figures import figure_with, save

GRID = 400


def draw_coverage(
    path: Path,
    name: str,
    lattice: Lattice,
    pattern: Pattern,
    found: Coverage,
    array: ArrayCoverage | None,
) -> None:
    """A map of the lattice, and of the whole array where there is one, as an image file."""
    figure, panels = figure_with((13.0 if array else 7.0, 6.0), 1, 2 if array else 1, squeeze=False)
    most = max(found.most, int(array.number.max()) if array else 0)
    image = _draw_lattice(panels[0, 0], lattice, pattern, most)
    panels[0, 0].set_title(f"{name}: {_reached(found)}, {found.mean:.2f} fibres at a point")
    if array is not None:
        _draw_array(panels[0, 1], array, most)
        panels[0, 1].set_title(
            f"whole array: {array.covered:.2%} reached, {array.blocked.mean():.2%} blocked"
        )
    figure.colorbar(image, ax=panels, label="fibres that reach the point", ticks=range(most + 1))
    save(figure, path)


def _reached(found: Coverage) -> str:
    """In words: a hole may be too small for a share."""
    if found.least > 0:
        return f"every point reached by {found.least} or more"
    return f"{found.at_least[1]:.2%} reached, with holes"


def _colours(most: int) -> dict[str, Any]:
    return {"cmap": colormaps["viridis"].resampled(most + 1), "vmin": -0.5, "vmax": most + 0.5}


def _draw_lattice(axes: Axes, lattice: Lattice, pattern: Pattern, most: int) -> Any:
    half = 2.0 * lattice.pitch_mm
    side = np.linspace(-half, half, GRID)
    points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    number = lattice.count(points, pattern, free=False).reshape(GRID, GRID)
    image = axes.imshow(number, origin="lower", extent=(-half, half, -half, half), **_colours(most))
    q, r = (a.ravel() for a in np.meshgrid(np.arange(-6, 7), np.arange(-6, 7)))
    with_fibre = pattern.carries(q, r)
    axes.plot(*lattice.centres_mm(q, r)[with_fibre].T, "o", color="white", markeredgecolor="black", ms=4)
    axes.set(xlim=(-half, half), ylim=(-half, half), xlabel="x [mm]", ylabel="y [mm]")
    return image


def _draw_array(axes: Axes, array: ArrayCoverage, most: int) -> None:
    low, high = array.xy_mm.min(axis=0), array.xy_mm.max(axis=0)
    column, row = np.rint((array.xy_mm - low) / array.step_mm).astype(int).T
    image = np.full((row.max() + 1, column.max() + 1), np.nan)
    image[row, column] = array.number
    axes.imshow(image, origin="lower", extent=(low[0], high[0], low[1], high[1]), **_colours(most))
    axes.set(xlabel="x [mm]", ylabel="y [mm]")
