"""Cobras that their calibration says not to count on: a bad one is named and left out, a good one is not."""

import numpy as np
import pytest

from fiberloom.blocking import finish
from fiberloom.drive.pfs.calibration import (
    CobraCalibration,
    MapFit,
    arriving,
    doubtful,
    left_out,
    most_scatter,
    standing_deg,
)
from fiberloom.drive.pfs.calibration.maps import ODD_STEPS
from fiberloom.drive.pfs.calibration.measure import STANDS
from fiberloom.drive.piezo import MotorMaps
from fiberloom.drive.piezo.cobras import CobraArms, stops_deg
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin.cobras.source import CobraSource

REACH_MM, WITHIN_UM = 4.75, 5.0
PLANE = generate(load_instrument("pfs"), 0, n_positioners=5)
MAPS = MotorMaps(np.full((10, 2, 112), 0.07), 400.0 / 112, np.full((10, 2), 40.0))
NOTHING = np.full((5, 2), np.nan)
SCATTER = [0.1, 0.1, 0.3, 0.9, 0.1, 0.2, np.nan, 0.4, 0.1, 0.1]
REASON = ["", "", "", "", ODD_STEPS, "", "fewer than 3 moves forward count", "", "", STANDS]


def named():
    motors = MapFit(MAPS, np.array(SCATTER), REASON)
    return doubtful(CobraCalibration(NOTHING, NOTHING, NOTHING, NOTHING, motors, [""] * 5), PLANE)


def test_wild_motors_and_failed_ones_are_named_and_good_ones_are_not():
    why, ids = named(), PLANE.positioner_id.tolist()
    assert sorted(why) == [ids[1], ids[2], ids[4]]
    assert why[ids[1]].startswith("phi: moves miss by 0.90 of their way, 0.5")
    assert why[ids[1]].endswith("at most can arrive in 12 moves")
    assert why[ids[2]] == f"theta: {ODD_STEPS}"
    assert why[ids[4]] == f"phi: {STANDS}"


def test_those_are_offline_where_they_are_seen():
    """At their stops but for one whose phi has stayed 120 deg out; the fibre of another is not seen."""
    arms, low = CobraArms.of(PLANE), stops_deg(PLANE)[0]
    at = np.zeros((5, 2))
    at[1, 1] = 120.0
    xy_mm = arms.xy_mm(at)
    xy_mm[4] = np.nan
    plane = left_out(PLANE, named(), standing_deg(PLANE, xy_mm))
    assert plane.offline.tolist() == [False, True, True, False, True]
    assert (plane.offline_position_deg - low)[plane.offline] == pytest.approx(at[plane.offline], abs=0.01)


@pytest.mark.parametrize("scatter", [0.3, 0.55, 0.8])
def test_the_share_that_arrives_is_that_of_motors_that_miss_so(scatter):
    """Of 400 000 that aim at 1 / (1 + s^2) of what is left and stay once they are within a half."""
    rng, left_um = np.random.default_rng(0), np.full(400_000, 1000.0 * REACH_MM)
    aim = 1.0 / (1.0 + scatter**2)
    for _ in range(10):
        went = aim * (1.0 + scatter * rng.standard_normal(len(left_um)))
        left_um = np.where(left_um < 0.5 * WITHIN_UM, left_um, np.abs(left_um * (1.0 - went)))
    share = np.mean(left_um < WITHIN_UM)
    assert arriving(scatter, REACH_MM, WITHIN_UM, 12) == pytest.approx(share, abs=0.002)


def test_the_most_scatter_is_where_99_of_100_arrive():
    most = most_scatter(REACH_MM, WITHIN_UM, 12)
    assert 0.5 < most < 0.57
    assert (
        arriving(most - 0.01, REACH_MM, WITHIN_UM, 12) > 0.99 > arriving(most + 0.01, REACH_MM, WITHIN_UM, 12)
    )
    assert most_scatter(REACH_MM, WITHIN_UM, 8) < most < most_scatter(REACH_MM, WITHIN_UM, 20)


def test_of_two_modules_the_twin_names_what_is_bad_and_little_else():
    """114 cobras by a calibration on the twin: whoever stands is named, and none whose motors are good."""
    plane = generate(load_instrument("pfs"), 0, n_positioners=114)
    source = CobraSource(plane, 0, "noise")
    why, array = finish(source.doubtful()), source.array
    rows = plane.index_of(sorted(why))
    assert set(plane.positioner_id[array.stuck]) <= set(why)
    wild = array.motors.move_sigma.reshape(-1, 2).max(axis=1)
    assert np.all(array.stuck[rows] | (wild[rows] > 0.4))


def test_without_a_calibration_none_is_named():
    assert finish(CobraSource(PLANE, 0, "noise", calibrated=False).doubtful()) == {}
