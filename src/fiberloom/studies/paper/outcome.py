"""What a figure is given, and what it gives back."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # files only

from matplotlib.figure import Figure as Canvas

from fiberloom.studies.paper.quantity import Quantity


def _silent(text: str) -> None:
    pass


@dataclass(frozen=True)
class Settings:
    """How a figure is made."""

    seed: int = 0
    """The first seed; `n_seeds` in a row are used where a figure gives a spread."""
    n_seeds: int = 3
    full: bool = False
    """The paper's own size."""
    say: Callable[[str], None] = _silent
    """Told what is being done."""
    folder: Path | None = None
    """Where a figure may keep parts of itself, so that a later run goes on there; None: nowhere."""
    fresh: bool = False
    """Make anew what is kept there."""

    @property
    def seeds(self) -> range:
        """Each draws its own units, camera noise and hall noise."""
        return range(self.seed, self.seed + self.n_seeds)


@dataclass(frozen=True)
class Drawing:
    """A picture with a caption."""

    name: str
    caption: str
    png: bytes


@dataclass(frozen=True)
class FigureOutcome:
    """What came out of a figure."""

    quantities: list[Quantity]
    drawings: list[Drawing]
    how: str
    """What was done, in a few sentences."""
    smaller: str = ""
    """Where the experiment was made smaller than the paper's; empty where it was not."""
    beyond: list[str] = field(default_factory=list)
    """What goes beyond the paper."""
    table: str = ""
    """All of it in one table (Markdown), where that says more than the list of quantities."""


def drawing(name: str, caption: str, canvas: Canvas) -> Drawing:
    """The canvas as PNG; it is closed."""
    import matplotlib.pyplot as plt

    buffer = io.BytesIO()
    canvas.savefig(buffer, format="png", dpi=110)
    plt.close(canvas)
    return Drawing(name, caption, buffer.getvalue())
