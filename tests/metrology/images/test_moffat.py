"""Moffat spots whose exponent is a whole number are painted by multiplication: as those beside it."""

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
