import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom import units

finite = st.floats(-1e4, 1e4)


def test_one_turn_is_2_to_the_30_counts():
    assert units.deg_to_counts(360.0) == 2**30
    assert units.counts_to_deg(2**30) == 360.0
    # one motor turn of a gear of 1024
    assert units.deg_to_counts(360.0 / 1024) == 2**20


@given(finite)
def test_counts_round_to_the_nearest(angle_deg):
    back = units.counts_to_deg(units.deg_to_counts(angle_deg))
    # half a count, and the rounding of the product
    assert abs(back - angle_deg) <= 0.5 * 360 / 2**30 * (1 + 1e-6)


@given(st.integers(0, 2**31))
def test_ticks_are_exact(ticks):
    assert units.s_to_ticks(units.ticks_to_s(ticks)) == ticks


def test_speed_of_2000_rpm():
    # PROTOCOL: 2000 rpm at the motor is 11.7 deg/s at the output
    assert units.rpm_to_deg_s(2000.0, 1024.0) == pytest.approx(11.71875, abs=1e-12)
    assert units.deg_s_to_rpm(12.0, 1024.0) == pytest.approx(2048.0, abs=1e-9)
    assert units.motor_to_output_deg(840.0, 1024.0) == pytest.approx(0.8203125)


@given(finite)
def test_wrap_keeps_the_direction(angle_deg):
    wrapped = units.wrap_deg(angle_deg)
    assert -180.0 <= wrapped < 180.0 + 1e-9
    turns = (angle_deg - wrapped) / 360.0
    assert abs(turns - np.round(turns)) < 1e-9


def test_wrap_at_its_ends():
    assert units.wrap_deg(180.0) == -180.0
    assert units.wrap_deg(-180.0) == -180.0


@given(finite)
def test_lengths_and_angles_there_and_back(value):
    assert units.um_to_mm(units.mm_to_um(value)) == pytest.approx(value, rel=1e-15, abs=1e-300)
    assert units.rad_to_deg(units.deg_to_rad(value)) == pytest.approx(value, rel=1e-15, abs=1e-300)
