"""Gears whose error does not repeat in a turn, and their play."""

import numpy as np

from fiberloom.drive.desi.maps.orders import ORDERS, RATIO
from fiberloom.twin.actuators.planetary import draw_gears, played


def test_the_orders_by_hand():
    r = 60 / 14
    assert round(RATIO - r, 12) == 0.0
    want = [1.0, 46 / 16, r - 1.0, r, r * 46 / 16, r * (r - 1.0), 46.0]
    np.testing.assert_allclose(ORDERS, want)


def test_the_error_is_what_makes_54_um_of_a_blind_move():
    """Two places differ by root two times the error: 0.59 deg, which is 54 um at 5.27 mm for both axes."""
    gears = draw_gears(400, np.random.default_rng(0), 0.09)
    error = gears.error_deg(np.random.default_rng(1).uniform(-190, 190, (400, 50, 2)))
    assert 0.41 < error.std() < 0.44
    assert 52.0 < 5.27e3 * np.deg2rad(np.sqrt(2) * error.std()) < 57.0


def test_a_turn_later_the_error_is_another():
    gears = draw_gears(50, np.random.default_rng(0), 0.09)
    here = np.full((50, 1, 2), -170.0)
    assert np.abs(gears.error_deg(here + 360.0) - gears.error_deg(here)).max() > 0.3


def test_gear_and_output_are_inverse():
    gears = draw_gears(30, np.random.default_rng(2), 0.09)
    at = np.random.default_rng(3).uniform(-196, 196, (30, 20, 2))
    np.testing.assert_allclose(gears.output_deg(gears.gear_deg(at)), at, atol=1e-8)


def test_play_is_taken_up_before_the_gear_moves():
    rotor = np.zeros((1, 4, 2))
    rotor[0, :, 0] = [0.4, 2.0, 1.5, -1.0]
    gear = played(np.zeros((1, 2)), rotor, np.array([[1.0, 1.0]]))
    assert gear[0, :, 0].tolist() == [0.0, 1.5, 1.5, -0.5]
    assert not gear[0, :, 1].any()


def test_the_same_approach_gives_the_same_gear_angle():
    rotor = np.zeros((1, 6, 2))
    rotor[0, :, 0] = [50.0, 53.0, 50.0, -80.0, 53.0, 50.0]
    gear = played(np.zeros((1, 2)), rotor, np.array([[1.7, 1.7]]))
    assert gear[0, 2, 0] == gear[0, 5, 0]
