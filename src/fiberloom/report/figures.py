"""Figures for files and for notebooks, without choosing a display for the caller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fiberloom.timing import part
from fiberloom.wholefile import whole


def figure_with(
    size_in: tuple[float, float], rows: int = 1, columns: int = 1, **how: Any
) -> tuple[Figure, Any]:
    """A figure for a file, with its axes; no window knows of it, so nothing has to close it.

    `size_in`: width and height in inches, 25.4 mm each; `rows` times `columns` of axes; `how`: as
    matplotlib's `subplots`.
    """
    figure = Figure(figsize=size_in, layout="constrained")
    return figure, figure.subplots(rows, columns, **how)


@part("figures")
def save(figure: Figure, path: Path, dpi: int = 120, **how: Any) -> None:
    """As an image, by the suffix of the path. `how`: as matplotlib's `savefig`."""
    _lay_out(figure, dpi)
    with whole(path) as part:
        figure.savefig(part, dpi=dpi, **how)


def _lay_out(figure: Figure, dpi: int) -> None:
    """Places the axes now. Where a layout is left to do, matplotlib draws everything twice, once for it."""
    engine = figure.get_layout_engine()
    if engine is not None:
        figure.set_dpi(dpi)
        engine.execute(figure)
        figure.set_layout_engine(None)


def new_axes(size_in: tuple[float, float]) -> Axes:
    """Axes of a figure that pyplot knows: a notebook shows it, a script may show it.

    `size_in`: width and height in inches, 25.4 mm each.
    """
    import matplotlib.pyplot as plt

    _, axes = plt.subplots(figsize=size_in, layout="constrained")
    return axes
