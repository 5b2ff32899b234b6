"""Figures for files: drawn once, and as matplotlib would by itself."""

import numpy as np
from matplotlib.image import imread
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from fiberloom.report.figures import figure_with, figure_with_room, save, set_title
from fiberloom.report.focal_plane import _draw_discs


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
    theirs = imread(tmp_path / "theirs.png")
    assert (theirs[..., 3] == 1).all()  # nothing is transparent, so ours has no such layer
    assert np.array_equal(imread(tmp_path / "ours.png"), theirs[..., :3])


def saved(path, draw):
    figure, axes = figure_with_room((6, 4))
    axes.plot([0, 1e5], [0, 1e5])
    draw(axes)
    save(figure, path)
    return imread(path)


def test_a_title_is_where_matplotlib_puts_it(tmp_path):
    text = "two lines\nof a title"
    ours = saved(tmp_path / "a.png", lambda axes: set_title(axes, text, fontsize=10))
    theirs = saved(tmp_path / "b.png", lambda axes: axes.set_title(text, fontsize=10))
    assert np.array_equal(ours, theirs)


def test_discs_are_circles(tmp_path):
    """But for the last digit of a shade."""
    discs = np.array([[2e4, 3e4, 5e3], [7e4, 2e4, 9e3], [99e3, 5e4, 8e3]])

    def patches(axes):
        for x, y, radius in discs:
            axes.add_patch(Circle((x, y), radius, color="0.88", zorder=0))
        axes.set(xlim=(0, 1e5), ylim=(0, 1e5))

    def artist(axes):
        _draw_discs(axes, discs)
        axes.set(xlim=(0, 1e5), ylim=(0, 1e5))

    ours, theirs = saved(tmp_path / "a.png", artist), saved(tmp_path / "b.png", patches)
    assert (ours < 0.95).sum() > 1000
    np.testing.assert_allclose(ours, theirs, atol=1.5 / 255)


def test_no_disc_is_drawn_of_none(tmp_path):
    bare = saved(tmp_path / "a.png", lambda axes: None)
    assert np.array_equal(bare, saved(tmp_path / "b.png", lambda axes: _draw_discs(axes, np.zeros((0, 3)))))
