"""Figures for files: drawn once, and as matplotlib would by itself."""

import numpy as np
from matplotlib.image import imread
from matplotlib.lines import Line2D

from fiberloom.report.figures import figure_with, save


class Counted(Line2D):
    """A line that counts how often it is drawn."""

    drawn = 0

    def draw(self, renderer):
        Counted.drawn += 1
        super().draw(renderer)


def figure_of(line):
    figure, (left, right) = figure_with((8, 4), 1, 2)
    left.add_line(line)
    left.set(title="two lines\nof a title", xlabel="x [mm]", ylabel="y [mm]", ylim=(0, 1e5))
    figure.colorbar(right.scatter([0, 1], [0, 1], c=[0, 1]), ax=right, label="error [µm]")
    return figure


def test_a_figure_is_drawn_once_and_laid_out_as_by_matplotlib(tmp_path):
    save(figure_of(Counted([0, 1], [0, 1e5])), tmp_path / "ours.png", dpi=90)
    assert Counted.drawn == 1
    figure_of(Line2D([0, 1], [0, 1e5])).savefig(tmp_path / "theirs.png", dpi=90)
    assert np.array_equal(imread(tmp_path / "ours.png"), imread(tmp_path / "theirs.png"))
