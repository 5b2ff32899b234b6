"""Figures for files and for notebooks, without choosing a display for the caller."""

from __future__ import annotations

import io
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline
from matplotlib.textpath import TextPath
from matplotlib.transforms import Affine2D
from numpy.typing import ArrayLike
from PIL import Image

from fiberloom.timing import part
from fiberloom.typing import Floats
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


_ROOM_IN = {"left": 0.8, "right": 0.2, "bottom": 0.6, "top": 0.45}
_BETWEEN_IN = 0.85


def figure_with_room(size_in: tuple[float, float], columns: int = 1) -> tuple[Figure, Any]:
    """As `figure_with` one row of axes, whose room is measured beforehand: two lines of text above them, and
    numbers of five figures and a line of text beside and below.

    To measure what is written there takes as long as to draw it. `size_in`: width and height in inches,
    25.4 mm each; `columns` of axes.
    """
    (width, height), room = size_in, _ROOM_IN
    each = (width - room["left"] - room["right"] - (columns - 1) * _BETWEEN_IN) / columns
    figure = Figure(figsize=size_in)
    return figure, figure.subplots(
        1,
        columns,
        gridspec_kw={
            "left": room["left"] / width,
            "right": 1.0 - room["right"] / width,
            "bottom": room["bottom"] / height,
            "top": 1.0 - room["top"] / height,
            "wspace": _BETWEEN_IN / each,
        },
    )


def set_title(axes: Axes, text: str, **how: Any) -> None:
    """A title right above the `axes`, which have nothing else there. `how`: as matplotlib's `set_title`.

    Where its height is not told, matplotlib measures all that is written at the axes, to be clear of it.
    """
    axes.set_title(text, y=1.0, **how)


@part("figures")
def save(figure: Figure, path: Path, dpi: int = 120) -> None:
    """As an image of `dpi` per inch, by the suffix of the path."""
    _lay_out(figure, dpi)
    with whole(path) as part:
        if path.suffix == ".png":
            _save_png(figure, part, dpi)
        else:
            figure.savefig(part, dpi=dpi)


def _save_png(figure: Figure, path: Path, dpi: int) -> None:
    """Without a layer of transparency, and compressed quickly: by the usual level the file would be little
    smaller, and take longer.
    """
    drawn = io.BytesIO()
    figure.savefig(drawn, format="rgba", dpi=dpi)
    figure.set_dpi(dpi)
    image = Image.frombuffer("RGBA", figure.canvas.get_width_height(), drawn.getvalue())
    image.convert("RGB").save(path, format="png", compress_level=1, dpi=(dpi, dpi))


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


_BESIDE_EM = (0.64, 0.24)
"""From the point to the lower left of its number."""


@cache
def _digits() -> tuple[list[Any], float]:
    """Outlines of 0 to 9 in em, and how far one stands from the next."""
    paths = [TextPath((0.0, 0.0), str(digit), size=1.0) for digit in range(10)]
    pair = TextPath((0.0, 0.0), "00", size=1.0)
    return paths, float(pair.vertices[:, 0].max() - paths[0].vertices[:, 0].max())


def number_outline(number: int) -> Any:
    """Of a whole `number` that is not negative, in em."""
    paths, step = _digits()
    figures = [paths[int(figure)] for figure in str(number)]
    x, y = _BESIDE_EM
    moved = [path.vertices + np.array([x + k * step, y]) for k, path in enumerate(figures)]
    return Outline(np.concatenate(moved), np.concatenate([path.codes for path in figures]))


def number_points(axes: Axes, numbers: ArrayLike, at: Floats, colour: str, size_pt: float) -> None:
    """Puts whole `numbers` (n,), none of them negative, beside points `at` (n, 2) of the `axes`.

    `colour`, and `size_pt`: of the digits, 0.353 mm each. One artist for hundreds of numbers: as texts each
    would be laid out for itself.
    """
    outlines = [number_outline(number) for number in np.asarray(numbers).tolist()]
    figure = axes.figure
    texts = PathCollection(
        outlines,
        offsets=at,
        offset_transform=axes.transData,
        facecolors=colour,
        linewidths=0.0,
    )
    texts.set_transform(Affine2D().scale(size_pt / 72.0) + figure.dpi_scale_trans)
    texts.set_in_layout(False)
    axes.add_collection(texts, autolim=False)
