"""Numbers beside points: the same glyphs as matplotlib's texts, in the same place."""

import numpy as np
import pytest
from matplotlib.image import imread
from matplotlib.textpath import TextPath

from fiberloom.report.figures import figure_with, number_outline, number_points

DPI = 200
AT = np.array([[0.2, 0.2], [0.5, 0.7], [0.3, 0.5]])
NUMBERS = [0, 17, 2048]


def axes():
    figure, axes = figure_with((3, 3))
    axes.set(xlim=(0, 1), ylim=(0, 1))
    return figure, axes


def ink(figure, path):
    """(rows, columns): how dark a pixel is."""
    figure.savefig(path, dpi=DPI)
    return 1.0 - imread(path)[..., :3].mean(axis=-1)


def test_digits_stand_as_far_apart_as_in_a_text():
    for number in (1, 40, 317, 10592):
        ours, theirs = number_outline(number), TextPath((0, 0), str(number), size=1.0)
        # in em; a text's digits are moved to whole units of the font
        assert np.ptp(ours.vertices, axis=0) == pytest.approx(np.ptp(theirs.vertices, axis=0), abs=0.01)
        assert np.array_equal(ours.codes, theirs.codes)


def test_they_look_as_texts_do(tmp_path):
    figure, ours = axes()
    bare = ink(figure, tmp_path / "bare.png")
    number_points(ours, NUMBERS, AT, "black", 9)
    seen = ink(figure, tmp_path / "ours.png") - bare
    figure, theirs = axes()
    for number, at in zip(NUMBERS, AT, strict=True):
        theirs.text(*at, f"  {number}", fontsize=9, va="bottom", color="black")
    text = ink(figure, tmp_path / "theirs.png") - bare
    assert seen.sum() == pytest.approx(text.sum(), rel=0.1)
    for a, b in zip(np.nonzero(seen > 0.5), np.nonzero(text > 0.5), strict=True):
        # glyphs of texts are moved to whole pixels
        assert np.abs(np.percentile(a, [0, 50, 100]) - np.percentile(b, [0, 50, 100])).max() <= 4


def test_no_number_is_drawn_for_none():
    _, some = axes()
    number_points(some, [], np.zeros((0, 2)), "black", 9)
    assert len(some.collections[0].get_offsets()) == 0
