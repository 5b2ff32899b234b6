"""Motor maps: steps and ways are each other's inverse, and the sum over bins is that of small pieces."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom.drive.piezo import FORWARD, REVERSE, MotorMaps, pulse_factor
from fiberloom.errors import InputError
from fiberloom.twin.actuators import drawn_maps

MAPS = drawn_maps(10, 5)


@given(seed=st.integers(0, 10_000), start=st.floats(20.0, 380.0), end=st.floats(20.0, 380.0))
@settings(max_examples=60, deadline=None)
def test_steps_and_ways_are_inverse(seed, start, end):
    rng = np.random.default_rng(seed)
    at = start + rng.uniform(-15.0, 15.0, MAPS.motors)
    way = end - start + rng.uniform(-4.0, 4.0, MAPS.motors)
    steps = MAPS.steps(at, way)
    assert np.all(np.sign(steps) == np.sign(way))
    np.testing.assert_allclose(MAPS.way_deg(at, steps), way, atol=1e-9)


def test_steps_are_the_sum_over_small_pieces():
    start, way = np.full(MAPS.motors, 33.3), np.linspace(-30.0, 200.0, MAPS.motors)
    pieces = (np.arange(4000) + 0.5) / 4000
    for k in range(MAPS.motors):
        direction = FORWARD if way[k] > 0.0 else REVERSE
        bins = ((start[k] + pieces * way[k]) / MAPS.bin_deg).astype(int)
        summed = np.mean(way[k] / MAPS.step_deg[k, direction, bins])
        assert MAPS.steps(start, way)[k] == pytest.approx(summed, rel=2e-3, abs=0.5)


def test_directions_have_maps_of_their_own():
    step = np.empty((1, 2, 4))
    step[0, FORWARD], step[0, REVERSE] = 0.1, 0.2
    maps = MotorMaps(step, 90.0, np.full((1, 2), 40.0))
    at = np.array([100.0])
    assert maps.steps(at, np.array([10.0]))[0] == pytest.approx(100.0)
    assert maps.steps(at, np.array([-10.0]))[0] == pytest.approx(-50.0)


def test_a_step_by_a_longer_pulse():
    """sqrt(t^2 + p1^2) - p1: 4 % of a theta step, 9 % of a phi step by 1 us more (published pulses)."""
    assert pulse_factor(45.0, 44.0, 88.0) == pytest.approx(1.04, abs=0.005)
    assert pulse_factor(23.0, 22.0, 72.0) == pytest.approx(1.09, abs=0.005)
    assert pulse_factor(44.0, 44.0, 88.0) == 1.0


@pytest.mark.parametrize("bad", [0.0, -0.1, np.nan])
def test_a_step_that_is_no_step_is_named(bad):
    step = np.full((3, 2, 5), 0.07)
    step[2, REVERSE, 4] = bad
    with pytest.raises(InputError, match="motor 2, reverse, bin 4"):
        MotorMaps(step, 10.0, np.full((3, 2), 40.0))


def test_maps_of_other_shapes_are_refused():
    with pytest.raises(InputError, match=r"\(M, 2, bins\)"):
        MotorMaps(np.full((3, 5), 0.07), 10.0, np.full((3, 2), 40.0))
