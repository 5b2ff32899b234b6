"""Calibration of cobras: drawn ones are recovered; maps by hand; pulses."""

import asyncio
import sys
from pathlib import Path

import numpy as np
import pytest

from fiberloom.drive.pfs import CobraDrive, FpgaClient
from fiberloom.drive.pfs.calibration import (
    FAST_STEP_DEG,
    SLOW_STEP_DEG,
    CobraSweepSettings,
    Moves,
    calibrate_cobras,
    fit_maps,
    maps_at,
    pulses_for,
)
from fiberloom.drive.pfs.calibration.measure import CobraSweep, _turned
from fiberloom.drive.piezo import MotorMaps
from fiberloom.twin.actuators import PiezoErrors, drawn_maps
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.cobras.array import CobraArray
from fiberloom.twin.cobras.streams import VirtualBoards

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from support.cobras import pfs_plane

N = 171
CURVE_US = np.array([88.0])


@pytest.fixture(scope="module")
def calibrated():
    plane, maps = pfs_plane(N), drawn_maps(N, 0)
    array = CobraArray(plane, maps, PiezoErrors(), seed=0)
    array.motors.stuck[100:102] = True
    drive = CobraDrive(plane, maps, FpgaClient(VirtualBoards(array).connector()), plane.dots_mm)
    found = asyncio.run(calibrate_cobras(drive, NoiseCamera(array, 1.4, 0), CobraSweepSettings()))
    return drive, array, maps, found


def test_most_are_calibrated_and_the_others_are_named(calibrated):
    _, array, _, found = calibrated
    assert found.ok.mean() > 0.8
    assert not found.ok[array.stuck].any()
    assert all(text.startswith(("theta", "phi")) for text in found.reason if text)


def test_geometry_is_recovered(calibrated):
    drive, _, _, found = calibrated
    arms, ok = drive.arms, found.ok
    # a circle through some 40 places of 1 um each: a third of that
    assert np.median(np.hypot(*(found.centre_mm - arms.centre_mm)[ok].T)) < 0.0007
    assert np.median(np.abs(found.link_mm - arms.link_mm)[ok], axis=0).max() < 0.0007
    zero = (found.zero_deg - arms.zero_deg + 180.0) % 360.0 - 180.0
    assert np.median(np.abs(zero[ok]), axis=0).max() < 0.1
    ranges = (found.range_deg - arms.range_deg)[ok]
    assert np.isfinite(ranges).mean() > 0.6  # slow motors do not reach the other stop
    assert np.nanmedian(np.abs(ranges)) < 0.2


def test_lasting_errors_of_motors_are_found(calibrated):
    _, array, maps, found = calibrated
    ok, true = np.repeat(found.ok, 2), array.motors.maps.step_deg
    before = (maps.step_deg / true)[ok][:, :, 5:45].mean(axis=2) - 1.0
    after = (found.motors.maps.step_deg / true)[ok][:, :, 5:45].mean(axis=2) - 1.0
    assert np.median(np.abs(before)) > 0.12
    assert np.median(np.abs(after)) < 0.04


def test_motors_that_scatter_are_known(calibrated):
    _, array, _, found = calibrated
    told = np.repeat(found.ok, 2) & np.isfinite(found.motors.scatter)
    one, two = np.log(found.motors.scatter[told]), np.log(array.motors.move_sigma[told])
    assert np.corrcoef(one, two)[0, 1] > 0.75
    assert np.exp(np.median(one - two)) == pytest.approx(1.1, abs=0.25)


def test_a_motor_that_was_not_swept_keeps_its_map(calibrated):
    """Its fibre stood, or was turned by the other motor: no figure of that is a step."""
    _, _, maps, found = calibrated
    rows = np.flatnonzero([text.startswith("phi: not swept") for text in found.reason])
    assert len(rows) > 2
    phi = 2 * rows + 1
    assert np.array_equal(found.motors.maps.step_deg[phi], maps.step_deg[phi])
    assert not np.isfinite(found.motors.scatter[phi]).any()


def test_a_stuck_motor_keeps_its_map(calibrated):
    _, array, maps, found = calibrated
    assert array.stuck.any()
    rows = np.flatnonzero(np.repeat(array.stuck, 2))
    assert np.array_equal(found.motors.maps.step_deg[rows], maps.step_deg[rows])


def test_one_move_of_a_motor_that_scatters_does_not_make_a_map():
    """Two passes of moves by 100 steps over the same bins; ways of 1 to 14 deg where 10 are told."""
    ways = np.array([1.0, 12.0, 7.0, 14.0])
    first, second = (20.0 + np.append(0.0, np.cumsum(w)) for w in (ways, ways[::-1]))
    back = np.array([43.0, 33.0])
    steps = np.tile([100, 100, 100, 100, -110, -100, -70], 2)[:, None]
    places = np.concatenate([first, back[:2], second, back[:2], [20.0]])[:, None]
    fits = [
        fit_maps(flat(), CURVE_US, Moves(steps, np.full((14, 1), 44.0), places, passes), np.array([100.0]))
        for passes in (1, 2)
    ]
    one, two = (fit.maps.step_deg[0, 0, 2:6] for fit in fits)
    # without passes nothing tells that it scatters: the published weighting, bin by bin
    assert fits[1].scatter[0] > 0.3
    assert np.ptp(one) > 3.0 * np.ptp(two)
    assert two == pytest.approx(0.1, rel=0.25)


def test_more_than_half_a_turn_between_two_images_is_one_in_the_direction_of_the_steps():
    steps = np.array([500, 500, -500, -500])
    turn = np.radians(np.array([0.0, 110.0, np.nan, 310.0, 60.0]))
    xy_mm = 2.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)[:, None]
    found = _turned(CobraSweep(steps, xy_mm), np.zeros((1, 2)))[:, 0]
    # from 110 with one image missing, back by 160; then by 250
    assert found[[0, 1, 3, 4]] == pytest.approx([0.0, 110.0, -50.0, -300.0])
    assert np.isnan(found[2])


def flat(step_deg=0.1, bins=10):
    return MotorMaps(np.full((1, 2, bins), step_deg), 10.0, np.full((1, 2), 44.0))


def test_bins_by_hand():
    """Ways of 15 deg by 100 steps from 20, and of 10 deg by 100 from 35: 0.15 and 0.10 deg per step.

    Bin 20-30: the first alone. Bin 30-40: f = 5^2/15 and 5^2/10: (0.15 f1 + 0.10 f2)/(f1 + f2) = 0.12.
    """
    places = np.array([20.0, 35.0, 45.0, 55.0])[:, None]
    moves = Moves(np.full((3, 1), 100), np.full((3, 1), 44.0), places)
    back = Moves(
        np.concatenate([moves.steps, -moves.steps]), np.full((6, 1), 44.0),
        np.concatenate([places, places[2::-1]]),
    )  # fmt: skip
    found = fit_maps(flat(), CURVE_US, back, np.array([100.0]))
    step = found.maps.step_deg[0, 0]
    assert found.reason == [""]
    assert step[2] == pytest.approx(0.15)
    assert step[3] == pytest.approx(0.12)
    assert step[5] == pytest.approx(0.10)
    assert step[:2] == pytest.approx([0.15, 0.15])  # the nearest that was touched
    assert step[6:] == pytest.approx([0.10] * 4)


def test_moves_beside_stops_do_not_count_and_too_few_are_named():
    places = np.array([0.0, 15.0, 25.0, 35.0, 45.0])[:, None]
    moves = Moves(np.full((4, 1), 100), np.full((4, 1), 44.0), places)
    found = fit_maps(flat(), CURVE_US, moves, np.array([100.0]))
    assert found.reason == ["fewer than 3 moves reverse count"]
    np.testing.assert_array_equal(found.maps.step_deg, flat().step_deg)


def test_a_place_that_was_not_seen_joins_two_moves():
    places = np.array([10.0, np.nan, 34.0, 46.0, 58.0, 46.0, 34.0, 22.0])[:, None]
    steps = np.array([100, 100, 100, 100, -100, -100, -100])[:, None]
    found = fit_maps(flat(), CURVE_US, Moves(steps, np.full((7, 1), 44.0), places), np.array([100.0]))
    assert found.maps.step_deg[0, 0, 1:6] == pytest.approx([0.12] * 5)


def test_pulses_for_wanted_steps():
    maps = drawn_maps(40, 3)
    curve = np.tile([88.0, 72.0], 40)
    for wanted in (SLOW_STEP_DEG, FAST_STEP_DEG):
        pulse = pulses_for(maps, curve, wanted)
        step = maps_at(maps, curve, pulse).step_deg.mean(axis=2)
        free = (pulse > 12.0) & (pulse < 140.0)
        assert free.mean() > 0.8
        # whole us: half of one of 13 us changes a step by 8 %
        np.testing.assert_allclose(step[free], wanted, rtol=0.08)
