"""Backlash by the gap and by Eq. 7: what the slope of a ripple does to either."""

import numpy as np
import pytest

from fiberloom.calibration.transmission.backlash import backlash_at_knots_deg, gap_motor_deg
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.units import GEAR

ORDER, AMPLITUDE_DEG, BACKLASH_DEG = 204, 0.0286, 150.0
SLOPE = ORDER * np.deg2rad(AMPLITUDE_DEG)
"""0.10: the twin's ripple of 5e-4 rad, 204 times a turn."""


def output_of(wire_deg):
    """T-^-1: the angle whose theta + a sin(m theta) is the wire's, by bisection."""
    low, high = wire_deg - 1.0, wire_deg + 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = middle + AMPLITUDE_DEG * np.sin(np.deg2rad(ORDER * middle)) > wire_deg
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return middle


def rippled(points):
    """One gear with a constant backlash and one ripple, seen without noise."""
    wire = np.linspace(0.0, 360.0, points)
    sides = np.stack([output_of(wire), output_of(wire - BACKLASH_DEG / GEAR)])
    shape = (1, 2, 2, points)
    return TransmissionMaps(
        np.array([1]), np.broadcast_to(wire, shape).copy(), np.broadcast_to(sides, shape).copy()
    )


@pytest.mark.parametrize("points", [200, 400, 800])
def test_the_gap_is_the_backlash_over_the_slope(points):
    """However many points there are: up to 1/(1 - 0.10) times too large, 284 where 250 was put in."""
    over = gap_motor_deg(rippled(points)) / BACKLASH_DEG
    assert over.max() == pytest.approx(1.0 / (1.0 - SLOPE), rel=0.015)
    assert over.min() == pytest.approx(1.0 / (1.0 + SLOPE), rel=0.015)
    assert over.std() == pytest.approx(SLOPE / np.sqrt(2.0), rel=0.1)
    assert over.mean() == pytest.approx(1.0, abs=0.01)


def test_equation_7_takes_the_slope_out_where_the_knots_see_it():
    found = backlash_at_knots_deg(rippled(800)) / BACKLASH_DEG
    assert np.isnan(found[..., 0]).all()  # below the first knot of the other contact
    assert np.nanmax(np.abs(found - 1.0)) < 0.06  # at the ends the spline is looser
    assert np.nanstd(found[..., 10:-10]) < 0.01
    assert np.nanmax(np.abs(found[..., 10:-10] - 1.0)) < 0.02


def test_200_points_cannot_tell_a_slope_from_a_backlash():
    """204 cycles a turn on 200 points: nothing helps, and nobody may claim that it does."""
    assert np.nanstd(backlash_at_knots_deg(rippled(200))) > 0.04 * BACKLASH_DEG
