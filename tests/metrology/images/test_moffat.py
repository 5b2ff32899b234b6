"""Moffat spots whose exponent is a whole number are painted by multiplication in single precision: as those
beside it, to the last bit as one pixel after the other, and to their roundings as in double.
"""

import itertools

import numpy as np
import pytest

from fiberloom._core import metrology

MOFFAT, RADIUS_Q = 1, 200.0


def painted(beta):
    """A spot of 10 000 electrons off the middle of a pixel."""
    image = np.zeros((41, 41), np.float32)
    metrology.render_spots(image, np.array([[20.3, 19.8, 1e4, 4.0, 0.6, 3.0, beta]]), MOFFAT, RADIUS_Q)
    return image


@pytest.mark.parametrize("beta", [2.0, 3.0, 8.0, 9.0])
def test_whole_exponents_lie_between_their_neighbours(beta):
    step = 1e-4
    middle = (painted(beta - step).astype(float) + painted(beta + step)) / 2
    assert painted(beta).max() > 100.0
    # of the mean of both the curvature is left, 1e-8 of the light, and single precision
    np.testing.assert_allclose(painted(beta), middle, rtol=2e-6)
    assert not np.allclose(painted(beta), painted(beta + 0.01), rtol=1e-4)


RULES = {
    4: (
        (-0.43056815579702629, -0.16999052179242813, 0.16999052179242813, 0.43056815579702629),
        (0.17392742256872693, 0.32607257743127307, 0.32607257743127307, 0.17392742256872693),
    ),
    2: ((-0.28867513459481288, 0.28867513459481288), (0.5, 0.5)),
    1: ((0.0,), (1.0,)),
}
"""Gauss-Legendre points and weights of a pixel."""


MOST = 64
"""Pixels that are painted at once; places are counted from the first of them."""

X, Y, FLUX, S_XX, S_XY, S_YY = 30.3, 9.8, 1e4, 9.0, 0.6, 3.0
RADIUS_Q = 1600.0
WIDTH, HEIGHT = 160, 40
"""Of an image that the spot overlaps at three edges, in rows longer than a run."""

END = int(np.ceil(X + np.sqrt(RADIUS_Q * S_XX) + 0.5)) + 1
"""Column from which on nothing is painted."""

DET = S_XX * S_YY - S_XY * S_XY
INVERSE = np.array([S_YY, -2 * S_XY, S_XX]) / DET
"""xx, 2 xy and yy of the inverse of its ellipse."""


def q(dx, dy):
    xx, xy, yy = INVERSE.astype(np.asarray(dx).dtype)
    return xx * dx * dx + xy * dx * dy + yy * dy * dy


def points_at(i, j):
    at = q(np.float64(i - X), np.float64(j - Y))
    return 4 if at < 12 else 2 if at < 60 else 1


def runs(j):
    """First pixel, number of pixels and points a pixel of all runs in row `j`."""
    first = 0
    while first < END:
        points, end = points_at(first, j), first + 1
        while end < END and end - first < MOST and points_at(end, j) == points:
            end += 1
        yield first, end - first, points
        first = end


def light(first, count, j, points, power, precision):
    """(count,) of a run, for a density of one in the middle."""
    nodes, weights = RULES[points]
    light = np.zeros(count, precision)
    for b, a in itertools.product(range(points), repeat=2):
        dx = precision(first + nodes[a] - X) + np.arange(count, dtype=precision)
        from_one = 1 + q(dx, precision(j + nodes[b] - Y))
        product = from_one
        for _ in range(1, power):
            product = product * from_one
        light += precision(weights[a] * weights[b]) * (1 / product)
    return light


def reckoned(power, precision):
    image = np.zeros((HEIGHT, WIDTH), precision)
    norm = precision(FLUX / (np.pi / (power - 1) * np.sqrt(DET)))
    for j in range(HEIGHT):
        for first, count, points in runs(j):
            image[j, first : first + count] = norm * light(first, count, j, points, power, precision)
    return image


@pytest.mark.parametrize("power", [2, 4, 8])
def test_pixels_side_by_side_have_the_bits_of_one_after_the_other(power):
    image = np.zeros((HEIGHT, WIDTH), np.float32)
    spot = np.array([[X, Y, FLUX, S_XX, S_XY, S_YY, power]])
    metrology.render_spots(image, spot, MOFFAT, RADIUS_Q)
    np.testing.assert_array_equal(image, reckoned(power, np.float32))
    assert image[:, END - 1].all()
    in_double = reckoned(power, np.float64)
    np.testing.assert_allclose(image, in_double, rtol=(power + 2) * 3e-7)  # a rounding for each factor
