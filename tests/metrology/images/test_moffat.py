"""Moffat spots whose exponent is a whole number are painted by multiplication in single precision: as those
beside it, and as one pixel after the other in double.
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
    # of the mean of both the curvature is left, 1e-8 of the light, and single precision of a product of eight
    np.testing.assert_allclose(painted(beta), middle, rtol=4e-6)
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


def light_of_a_pixel(inverse, i, j, x, y, power):
    """Of the spot at (x, y) px; `inverse`: xx, 2 xy and yy of the inverse of its ellipse."""
    xx, xy, yy = inverse

    def q(dx, dy):
        return xx * dx * dx + xy * dx * dy + yy * dy * dy

    at = q(i - x, j - y)
    nodes, weights = RULES[4 if at < 12 else 2 if at < 60 else 1]
    light = 0.0
    for b, a in itertools.product(range(len(nodes)), repeat=2):
        from_one = 1 + q(i + nodes[a] - x, j + nodes[b] - y)
        product = from_one
        for _ in range(1, power):
            product *= from_one
        light += weights[a] * weights[b] * (1 / product)
    return light


@pytest.mark.parametrize("power", [2, 4])
def test_pixels_side_by_side_have_the_light_of_one_after_the_other(power):
    x, y, flux, s_xx, s_xy, s_yy = 30.3, 9.8, 1e4, 9.0, 0.6, 3.0  # over three edges, rows longer than a run
    image = np.zeros((40, 150), np.float32)
    spot = np.array([[x, y, flux, s_xx, s_xy, s_yy, power]])
    metrology.render_spots(image, spot, MOFFAT, 1600.0)
    det = s_xx * s_yy - s_xy * s_xy
    inverse = (s_yy / det, -2 * s_xy / det, s_xx / det)
    norm = flux / (np.pi / (power - 1) * np.sqrt(det))
    end = int(np.ceil(x + np.sqrt(1600.0 * s_xx) + 0.5))
    expected = np.zeros_like(image)
    for j, i in itertools.product(range(40), range(min(end, 149) + 1)):
        expected[j, i] = np.float32(norm * light_of_a_pixel(inverse, i, j, x, y, power))
    np.testing.assert_allclose(image, expected, rtol=2e-6)  # of which single precision takes half
