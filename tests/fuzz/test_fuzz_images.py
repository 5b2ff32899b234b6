"""Pixels that no detector gives hold no light: they neither crash nor make spots."""

import numpy as np
import pytest
from images import look

from fiberloom.metrology import find_expected, find_spots


@pytest.mark.parametrize("first", range(0, 240, 40))
def test_images_of_any_bytes_give_finite_spots_or_none(first):
    for seed in range(first, first + 40):
        look(seed)


def field(dtype):
    y, x = np.mgrid[:120, :160]
    noise = np.random.default_rng(0).normal(100.0, 3.0, (120, 160))
    return (noise + 5000.0 * np.exp(-((x - 50.3) ** 2 + (y - 60.7) ** 2) / 4.0)).astype(dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("wild", [np.nan, np.inf, -np.inf, 1e30, -1e30])
def test_a_value_that_no_detector_gives_is_a_pixel_without_light(dtype, wild):
    image = field(dtype)
    whole = find_spots(image).spots
    for y, x in [(30, 30), (31, 31), (90, 120), (0, 0), (119, 159), (60, 100)]:
        image[y, x] = wild
    spots = find_spots(image).spots
    assert len(spots) == len(whole) == 1
    np.testing.assert_allclose(spots.xy_px, whole.xy_px, atol=2e-3)
    assert not spots.flags.any()


def test_the_largest_values_of_a_detector_are_light():
    image = field(np.float64) * 1e5  # 5e8 ADU
    np.testing.assert_allclose(find_spots(image).spots.xy_px, [[50.3, 60.7]], atol=0.02)


def test_no_light_at_all_is_no_spot():
    assert len(find_spots(np.full((300, 300), np.inf, np.float32)).spots) == 0
    half = field(np.float32)
    half[:, 80:] = np.nan
    np.testing.assert_allclose(find_spots(half).spots.xy_px, [[50.3, 60.7]], atol=0.02)


def test_places_beyond_any_image_find_nothing():
    far = [[1e300, 0.0], [0.0, -1e300], [1e10, 1e10], [-5e9, 60.0]]
    assert find_expected(field(np.float32), far, 8.0).spots.has(32).all()
    # from far away with an endless radius everything is near
    assert find_expected(field(np.float32), [[50.0, 60.0]], 1e300).spots.flags.tolist() == [0]
