"""Cut-outs of an image: each pixel is where the image has it; marks are where they were measured."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from fiberloom.service.cutout import CENTROID, GOAL, ZOOM, cutout_png, stretched
from fiberloom.service.stamps import HALF_PX, Stamps

SIZE = 100
SPOTS = np.array([[40.3, 60.8], [2.0, 97.6]])
PX_MM = 0.1


class Scaled:
    """Pixels of 0.1 mm."""

    def to_px(self, xy_mm):
        return np.asarray(xy_mm) / PX_MM


@pytest.fixture
def stamps():
    y, x = np.mgrid[:SIZE, :SIZE]
    pixels = (100 * y + x).astype(">u2")  # as FITS has them
    reduction = SimpleNamespace(
        xy_mm=np.zeros((4, 2)),
        seen=np.array([False, True, True, False]),
        spot_of_match=np.array([-1, 0, 1, -1]),
        spots=SimpleNamespace(xy_px=SPOTS),
        expected_mm=np.array([[5.0, 7.0], [9.0, 9.0], [np.nan] * 2, [np.nan] * 2]),
        transform=Scaled(),
        image=SimpleNamespace(pixels=pixels, time_s=3.0),
    )
    return Stamps.of(reduction)


@pytest.mark.parametrize(("row", "place"), [(0, (50, 70)), (1, (40, 61)), (2, (2, 98))])
def test_a_cut_out_is_around_its_spot_or_where_it_was_expected(stamps, row, place):
    x, y = place
    assert stamps.pixels[row, HALF_PX, HALF_PX] == 100 * y + x
    assert tuple(stamps.corner_px[row]) == (x - HALF_PX, y - HALF_PX)
    for dx, dy in ((3, 0), (0, -5), (-16, 16), (16, 16)):
        inside = 0 <= x + dx < SIZE and 0 <= y + dy < SIZE
        want = 100 * (y + dy) + x + dx if inside else 0
        assert stamps.pixels[row, HALF_PX + dy, HALF_PX + dx] == want


def test_one_that_is_nowhere_has_an_empty_cut_out(stamps):
    assert not stamps.pixels[3].any()
    assert np.isnan(stamps.spot_within(3)).all()
    assert Image.open(io.BytesIO(cutout_png(stamps, 3, np.full(2, np.nan)))).size == (ZOOM * 33,) * 2


def test_marks_are_at_the_centroid_and_at_the_goal(stamps):
    assert stamps.spot_within(1) == pytest.approx((HALF_PX + 0.3, HALF_PX - 0.2))
    goal_mm = np.array([4.5, 5.9])  # 5 px right of the middle of the cut-out, 2 px above it
    assert stamps.within(1, goal_mm) == pytest.approx((HALF_PX + 5, HALF_PX - 2))
    shown = np.asarray(Image.open(io.BytesIO(cutout_png(stamps, 1, goal_mm))).convert("RGB")).astype(int)
    for colour, (x, y) in ((CENTROID, (16.3, 15.8)), (GOAL, (21.0, 14.0))):
        rows, columns = np.nonzero((shown == colour).all(axis=2))
        middle = (columns.min() + columns.max()) / 2, (rows.min() + rows.max()) / 2
        assert middle == pytest.approx((ZOOM * (x + 0.5), ZOOM * (y + 0.5)), abs=1.5)


def test_a_spot_is_white_and_its_background_black():
    pixels = np.full((33, 33), 1000, dtype=np.uint16)
    pixels[10, 12] = 9000
    pixels[10, 13] = 3000
    grey = stretched(pixels)
    assert (grey[10, 12], grey[0, 0], grey[10, 13]) == (255, 0, round(255 * np.sqrt(0.25)))
