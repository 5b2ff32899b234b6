"""Cobras that their calibration says not to count on: a bad one is named, a good one is not."""

import numpy as np
import pytest

from fiberloom.drive.pfs.calibration import CobraCalibration, MapFit, doubtful, least_moves
from fiberloom.drive.pfs.calibration.maps import ODD_STEPS
from fiberloom.drive.piezo import MotorMaps

MAPS = MotorMaps(np.full((8, 2, 112), 0.07), 400.0 / 112, np.full((8, 2), 40.0))
NOTHING = np.full((4, 2), np.nan)


def calibration(scatter, reason):
    return CobraCalibration(
        NOTHING, NOTHING, NOTHING, NOTHING, MapFit(MAPS, np.array(scatter), reason), [""] * 4
    )


def named(moves):
    scatter = [0.1, 0.1, 0.3, 0.9, 0.1, 0.2, np.nan, 0.4]
    reason = ["", "", "", "", ODD_STEPS, "", "fewer than 3 moves forward count", ""]
    return doubtful(calibration(scatter, reason), np.full(4, 4.75), 5.0, moves)


def test_a_wild_motor_and_a_failed_one_are_named_and_good_ones_are_not():
    why = named(12)
    assert sorted(why) == [1, 2]
    assert why[1] == "phi: moves miss by 0.90 of their way: 18 moves are needed, 12 are made"
    assert why[2] == f"theta: {ODD_STEPS}"


def test_more_moves_bring_wild_ones_there():
    assert sorted(named(18)) == [2]
    assert sorted(named(6)) == [1, 2, 3]


@pytest.mark.parametrize("share", [0.2, 0.7, 1.2])
def test_the_moves_are_those_of_motors_that_miss_so(share):
    """Mean squares of 400 000 motors that aim at 1 / (1 + s^2) of what is left, three moves."""
    rng, left = np.random.default_rng(0), np.ones(400_000)
    for _ in range(3):
        way = left / (1.0 + share**2)
        left = left - way * (1.0 + share * rng.standard_normal(len(left)))
    rms_um = 1000.0 * np.sqrt(np.mean(left**2))
    assert least_moves(np.array([share]), np.ones(1), rms_um) == pytest.approx([3.0], rel=0.02)
