"""The same image in any type of pixels gives the same spots, to the bit."""

from functools import cache

import numpy as np
import pytest
from scenes import Scene, make

from fiberloom._core import metrology

# low enough that the brightest spots are saturated, and have flat tops
CAMERA = metrology.Settings(1.0, 9000.0, 6.0, 0.0)
SCENE = Scene(n=120, width=700, height=620, hot=2e-4, cosmic=6, peaks=(2e3, 3e4), gap=2.5, seed=3)


def fits_u16(adu):
    return (adu.astype(np.int32) - 32768).astype(">i2").view(np.uint16)


def fits_f32(adu):
    return adu.astype(">f4").view(np.uint32)


TYPES = {
    "f32": (lambda adu: adu.astype(np.float32), False),
    "f64": (lambda adu: adu.astype(np.float64), False),
    "u16 of FITS": (fits_u16, True),
    "f32 of FITS": (fits_f32, True),
}


@cache
def frame():
    return make(SCENE)


def expected_xy():
    """Spots, places between them, and places near the corners and beyond the edges."""
    xy = frame().spots[:, :2]
    edges = [[0.5, 0.5], [699.0, 619.0], [-3.0, 300.0], [350.0, 624.0], [1.0, 618.0], [900.0, 900.0]]
    return np.vstack([xy, xy[:20] + 9.0, edges])


def found(image, fits):
    free = metrology.find_spots(image, fits, CAMERA, np.zeros(0))
    guided = metrology.find_expected(image, fits, CAMERA, free[2], expected_xy(), 4.0)
    unguided = metrology.find_expected(image, fits, CAMERA, np.zeros(0), expected_xy(), 4.0)
    return [part for result in (free, guided, unguided) for part in result]


@pytest.mark.parametrize("name", TYPES)
def test_every_type_of_pixels_shows_the_same_spots(name):
    convert, fits = TYPES[name]
    adu = frame().image
    theirs, ours = found(adu, False), found(convert(adu), fits)
    saturated, not_found = theirs[1] & 1, theirs[6] & 32
    assert saturated.any()
    assert not_found.any()
    for a, b in zip(theirs, ours, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("name", ["f32", "f64", "f32 of FITS"])
def test_pixels_that_are_no_number_cost_nothing_but_themselves(name):
    convert, fits = TYPES[name]
    adu = frame().image.astype(np.float64)
    rng = np.random.default_rng(1)
    x, y = frame().spots[:, :2].T
    far = [(i, j) for i, j in rng.integers(20, 600, (60, 2)) if np.hypot(x - i, y - j).min() > 8 * SCENE.fwhm]
    assert len(far) > 3
    broken = adu.copy()
    for k, (i, j) in enumerate(far):
        broken[j, i] = (np.nan, np.inf, -np.inf)[k % 3]
    table = metrology.find_spots(convert(adu), fits, CAMERA, np.zeros(0))
    again = metrology.find_spots(convert(broken), fits, CAMERA, table[2])
    whole = metrology.find_spots(convert(adu), fits, CAMERA, table[2])
    # the background's tiles lose some of their pixels: centres move by far less than their errors
    gaps = np.hypot(*(again[0][:, None, :2] - whole[0][None, :, :2]).transpose(2, 0, 1)).min(axis=0)
    errors = np.sqrt(whole[0][:, 2] + whole[0][:, 4])
    assert np.median(gaps / errors) < 0.2
    assert (gaps < 3 * errors).mean() > 0.97
