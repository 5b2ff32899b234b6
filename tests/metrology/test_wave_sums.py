"""Sums of plane waves, against numpy's cosine."""

import numpy as np
import pytest

from fiberloom._core import metrology

PLACES, WAVES = 131, 50
"""Two whole blocks of 64 places and some."""


def test_sums_are_those_of_the_cosines():
    rng = np.random.default_rng(0)
    xy, waves = rng.uniform(-300, 300, (PLACES, 2)), rng.normal(0.0, 1.0, (WAVES, 3))
    xy[[3, 70], [0, 1]] = np.nan
    sums = metrology.wave_sums(xy, waves)
    plain = np.cos(xy @ waves[:, :2].T + waves[:, 2]).sum(axis=1)
    assert np.array_equal(np.isnan(sums), np.isnan(plain))
    # angles of 1000 rad are rounded to 1e-13
    assert np.nanmax(np.abs(sums - plain)) < 1e-13 * WAVES


@pytest.mark.parametrize("scale", [1.0, 40.0])
def test_a_cosine_is_exact_to_its_last_digits(scale):
    phase = scale * np.linspace(-4.0, 4.0, 1001)
    one = np.array([metrology.wave_sums(np.zeros((1, 2)), np.array([[0.0, 0.0, p]]))[0] for p in phase])
    assert np.abs(one - np.cos(phase)).max() < 4e-16


def test_a_place_does_not_depend_on_the_others():
    rng = np.random.default_rng(1)
    xy, waves = rng.uniform(-300, 300, (PLACES, 2)), rng.normal(0.0, 0.02, (WAVES, 3))
    assert np.array_equal(metrology.wave_sums(xy, waves)[60:], metrology.wave_sums(xy[60:], waves))


def test_no_place_and_no_wave():
    assert metrology.wave_sums(np.zeros((0, 2)), np.zeros((4, 3))).shape == (0,)
    assert metrology.wave_sums(np.zeros((2, 2)), np.zeros((0, 3))).tolist() == [0.0, 0.0]
