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
from fiberloom.drive.piezo.stages import PHI, THETA
from fiberloom.errors import InputError
from fiberloom.field import Field
from fiberloom.instruments import generate, load_instrument
from fiberloom.targets.generate import random_targets
from fiberloom.twin.cobras.source import CobraSource

REACH_MM, WITHIN_UM = 4.75, 5.0
PLANE = generate(load_instrument("pfs"), 0, n_positioners=5)
MAPS = MotorMaps(np.full((10, 2, 112), 0.07), 400.0 / 112, np.full((10, 2), 40.0))
NOTHING = np.full((5, 2), np.nan)
SCATTER = [0.1, 0.1, 0.3, 0.9, 0.1, 0.2, np.nan, 0.4, 0.1, 0.1]
REASON = ["", "", "", "", ODD_STEPS, "", "fewer than 3 moves forward count", "", "", STANDS]


def named(moves=None, scatter=SCATTER):
    motors = MapFit(MAPS, np.array(scatter), REASON)
    return doubtful(CobraCalibration(NOTHING, NOTHING, NOTHING, NOTHING, motors, [""] * 5), PLANE, moves)


def test_wild_motors_and_failed_ones_are_named_and_good_ones_are_not():
    why, ids = named(), PLANE.positioner_id.tolist()
    assert sorted(why) == [ids[1], ids[2], ids[4]]
    assert why[ids[1]].startswith("phi: moves miss by 0.90 of their way, 0.4")
    assert why[ids[1]].endswith("at most can arrive in 12 moves")
    assert why[ids[2]] == f"theta: {ODD_STEPS}"
    assert why[ids[4]] == f"phi: {STANDS}"


def test_cobras_are_judged_by_the_moves_of_the_field_but_not_by_fewer_than_the_instruments():
    """In fewer than twelve moves it is these that do not suffice, and not the motor."""
    one, most = PLANE.positioner_id[0], [most_scatter(REACH_MM, WITHIN_UM, moves) for moves in (12, 16)]
    between = [np.mean(most), *SCATTER[1:]]
    assert one not in named(16, between)
    assert named(12, between)[one].endswith("at most can arrive in 12 moves")
    assert named(2, between) == named(8, between) == named(12, between) == named(None, between)


def test_an_observation_of_eight_moves_asks_for_these(tmp_path, monkeypatch):
    asked = []

    async def doubtful_of(self, moves=None):
        asked.append(moves)
        raise InputError("asked")

    monkeypatch.setattr(CobraSource, "doubtful", doubtful_of)
    field = Field(PLANE, CobraSource(PLANE, 0, "noise", calibrated=False), 0)
    targets = random_targets(PLANE, 5, seed=0)
    for corrections in (7, None):
        with pytest.raises(InputError, match="asked"):
            field.run.observe(targets, corrections, out=tmp_path)
    assert asked == [8, None]


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


@pytest.mark.parametrize("axis", [THETA, PHI])
@pytest.mark.parametrize("scatter", [0.3, 0.45, 0.6, 0.8])
def test_the_share_that_arrives_is_that_of_motors_that_miss_so(scatter, axis):
    """Of 400 000 whose maps are off by 0.1 and that stay once within a half; phi keeps to its room."""
    rng, left_um = np.random.default_rng(0), np.full(400_000, 1000.0 * REACH_MM)
    map_off, aim = 1.0 + 0.1 * rng.standard_normal(len(left_um)), 1.0 / (1.0 + scatter**2)
    for _ in range(10):
        left_deg = np.rad2deg(2.0 * np.arcsin(np.minimum(left_um / (1000.0 * REACH_MM), 1.0)))
        farthest_deg = left_deg + max(6.0, 60.0 * scatter)
        told_deg = aim * left_deg
        if axis == PHI:
            told_deg = np.minimum(told_deg, farthest_deg / (1.0 + 3.5 * scatter))
        went = told_deg / left_deg * map_off * (1.0 + scatter * rng.standard_normal(len(left_um)))
        left_um = np.where(left_um < 0.5 * WITHIN_UM, left_um, np.abs(left_um * (1.0 - went)))
    share = np.mean(left_um < WITHIN_UM)
    assert arriving(scatter, REACH_MM, WITHIN_UM, 12, axis) == pytest.approx(share, abs=0.003)


def test_the_most_scatter_is_where_99_of_100_arrive():
    most = most_scatter(REACH_MM, WITHIN_UM, 12)
    assert 0.40 < most < 0.46 < most_scatter(REACH_MM, WITHIN_UM, 12, THETA) < 0.53
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
    assert np.all(array.stuck[rows] | (wild[rows] > 0.3))


def test_without_a_calibration_none_is_named():
    assert finish(CobraSource(PLANE, 0, "noise", calibrated=False).doubtful()) == {}
