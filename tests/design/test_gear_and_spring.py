"""Windows of the reduction ratio and of the spring against backlash."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fiberloom.design.gear import gear_window, least_ratio, move_s, output_deg, speed_for
from fiberloom.design.spring import spring_window
from fiberloom.errors import InputError
from fiberloom.instruments import load_instrument

SDSSV = load_instrument("sdssv")


@pytest.mark.parametrize(
    ("requirement_um", "reach_mm", "angle_deg", "least"),
    [
        (40.0, 16.5, 0.139, 36),
        (102.0, 11.606, 0.504, 10),
        (5.0, 6.0, 0.0477, 105),
        (5.0, 22.4, 0.0128, 391),
        (20.0, 25.0, 0.0458, 110),
        (5.0, 4.75, 0.0603, 83),
    ],
)
def test_ratios_of_the_six_instruments(requirement_um, reach_mm, angle_deg, least):
    assert output_deg(requirement_um, reach_mm) == pytest.approx(angle_deg, abs=5e-4)  # as printed
    assert least_ratio(requirement_um, reach_mm) == least


def test_what_a_ratio_does_not_divide():
    """0.244 deg of play are 95 um at 22.4 mm; a micrometre at 15 mm is 3.9 motor degrees."""
    alpha, beta = (gear_window(SDSSV, axis) for axis in (0, 1))
    assert alpha.play_um == pytest.approx(95.3, abs=0.2)
    assert beta.motor_deg_um == pytest.approx(3.9, abs=0.05)
    assert alpha.fits
    assert beta.fits


def test_a_move_of_the_speed_for_its_time_takes_that_time():
    for way_deg, within_s in ((360.0, 30.0), (180.0, 12.0), (10.0, 2.0)):
        speed_deg_s = speed_for(way_deg, within_s, 47.0)
        assert move_s(way_deg, speed_deg_s, 47.0) == pytest.approx(within_s, rel=1e-12)
    assert speed_for(360.0, 5.0, 47.0) is None


def test_the_time_bounds_the_ratio_from_above():
    window = gear_window(SDSSV, 0, motor_rpm=2000.0, within_s=20.0)
    slower = 6.0 * 2000.0 / window.most
    assert move_s(360.0, slower, SDSSV.alpha.acceleration_deg_s2) == pytest.approx(20.0, rel=1e-12)
    assert not window.fits  # 1024 is too slow
    with pytest.raises(InputError, match=r"least time is 5\.54 s; 57\.6 deg/s2 would do"):
        gear_window(SDSSV, 0, within_s=5.0)


@pytest.fixture(scope="module")
def found():
    """Alpha's, of 500 units: drawing them takes seconds, loads and factors are changed afterwards."""
    return spring_window(SDSSV, 0)


def test_springs_of_the_twin_are_those_of_the_paper(found):
    """Alpha: 8.2 mNm at 0, 2.3 at 360 deg, friction 20.5; window of the load below 2.3 and 12.3 mNm."""
    ends_mNm = np.median(found.ends_mNm, axis=0)
    span_deg = found.range_deg[1] - found.range_deg[0]
    at_360 = ends_mNm[0] + (ends_mNm[1] - ends_mNm[0]) * 360.0 / span_deg
    assert ends_mNm[0] == pytest.approx(8.2, abs=0.05)
    assert at_360 == pytest.approx(2.3, abs=0.1)
    friction_mNm = float(np.median(found.friction_mNm))
    assert friction_mNm == pytest.approx(20.5, abs=0.2)  # 500 units that scatter by 6 %
    assert friction_mNm - ends_mNm[0] == pytest.approx(12.3, abs=0.2)


def test_margins_hold_at_their_limits(found):
    """A load of just the weakest torque leaves a margin of 1; twice as much, half."""
    weakest_mNm = float(np.median(found.weakest_mNm))
    limit = replace(found, load_mNm=weakest_mNm, factor=1.0)
    assert np.median(limit.closes) == pytest.approx(1.0, abs=1e-9)
    assert np.median(replace(found, load_mNm=2 * weakest_mNm).closes) == pytest.approx(0.5, abs=1e-9)
    assert 0.0 < limit.good_share < 1.0  # half the units are weaker


def test_advice_helps(found):
    """The spring is wound so much more that its weakest end is what was needed."""
    assert "weakest 2.24 mNm, 2.90 are needed: wind it 40 deg more" in found.advice()
    per_deg = float(np.median(found.strongest_mNm - found.weakest_mNm)) / np.ptp(found.range_deg)
    assert 2.243 + 40.0 * per_deg == pytest.approx(2.90, abs=0.01)
    assert spring_window(SDSSV, 1).advice() == "fits"


def test_no_window_is_said_with_numbers_and_a_load_that_opens_it(found):
    heavy, opened = replace(found, load_mNm=5.0), replace(found, load_mNm=3.4)
    assert "no window: the spring must exceed 10.00 and stay below 5.24 mNm" in heavy.advice()
    assert "a load below 3.41 mNm" in heavy.advice()
    assert opened.low_mNm < opened.high_mNm


def test_motors_without_a_spring_are_refused():
    with pytest.raises(InputError, match="moons: alpha is a stepper"):
        spring_window(load_instrument("moons"), 0)
    with pytest.raises(InputError, match="load -1 mNm must be above 0"):
        spring_window(SDSSV, 0, load_mNm=-1.0)
    with pytest.raises(InputError, match="motor error 0"):
        gear_window(SDSSV, 0, motor_error_deg=0.0)
    assert math.isinf(gear_window(SDSSV, 0).most)


@pytest.mark.parametrize("factor", [1.0, 1.5, 2.0])
def test_at_the_ends_of_the_window_the_margins_are_the_factor(factor):
    """A spring as weak, and as strong, as the window allows."""
    found = spring_window(load_instrument("sdssv"), 1, factor=factor)
    friction = np.full(1, np.median(found.friction_mNm))
    ends = np.array([[found.high_mNm, found.low_mNm]])
    edge = replace(found, ends_mNm=ends, friction_mNm=friction, motor_mNm=100.0 * friction)
    assert edge.closes[0] == pytest.approx(factor)
    assert edge.holds[0] == pytest.approx(factor)
    assert edge.advice() == "fits"
