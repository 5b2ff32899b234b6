"""Stops tell where a unit is of which nothing is known, to a turn of its motor."""

import asyncio

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.drive.desi.drive import DesiDrive
from fiberloom.drive.desi.homing import BACK_DEG, HOMED_SIGMA_DEG, homed_deg, homing_tables
from fiberloom.twin.desi import DesiTwin
from fiberloom.twin.desi.transport import DesiTransport

N = 7
PLANE = fl.FocalPlane.of("desi", seed=0, n=N)
GEAR_DEG = 1.2
"""Waves of a gear add up to less: 1.21 deg at nominal amplitudes, where all are at their highest."""


def homed(start_deg, ids):
    twin = DesiTwin(PLANE, seed=1, start_deg=start_deg, contacts=False)
    drive = DesiDrive(PLANE, DesiTransport(twin))

    async def scenario():
        await drive.connect()
        return await drive.home(ids)

    return asyncio.run(scenario()), drive, twin


@pytest.mark.parametrize("start", [[-150.0, 20.0], [170.0, 120.0], [0.0, 180.0]])
def test_an_arm_from_anywhere_ends_three_degrees_beside_its_stops(start):
    ids = PLANE.positioner_id[:3].tolist()
    results, drive, twin = homed(np.tile(start, (N, 1)), ids)
    assert all(results[k].ok for k in ids)
    off = twin.truth() - drive.maps.output_deg(drive.maps.believed_deg)
    # half a turn of the motor, the gear's waves, half of the play: the twin's stops hold motors, not arms
    most = 0.5 * 360.0 / (46 / 14 + 1) ** 4 + GEAR_DEG + 0.5 * twin.units.gears.play_deg[:3]
    assert np.all(np.abs(off[:3]) < most)
    assert np.all(np.abs(twin.truth()[:3] - [-193.1, 182.0]) < most)
    # the others have not moved
    np.testing.assert_allclose(twin.truth()[3:], np.tile(start, (N - 3, 1)), atol=1e-6)


def test_play_is_closed_at_the_end():
    """The gear stands as after a move: on the side from which its motor comes last."""
    ids = PLANE.positioner_id[:3].tolist()
    _, _, twin = homed(np.tile([10.0, 90.0], (N, 1)), ids)
    gap = twin._state.rotor_deg - twin._state.gear_deg
    np.testing.assert_allclose(gap[:3], 0.5 * twin.units.gears.play_deg[:3] * [-1.0, 1.0], atol=1e-9)


def test_it_knows_less_than_before():
    ids = PLANE.positioner_id[:1].tolist()
    _, drive, _ = homed(np.tile([10.0, 90.0], (N, 1)), ids)
    fresh = drive.maps.basis.offset_deg**2
    assert drive.maps.covariance[0, 0, 0] == pytest.approx(fresh + HOMED_SIGMA_DEG**2)
    assert drive.maps.covariance[1, 0, 0] == pytest.approx(fresh)


def test_a_search_is_longer_than_the_range():
    tables = homing_tables(PLANE, np.array([2]))
    way_deg = tables.steps[2].sum(axis=0) / (10.0 * (46 / 14 + 1) ** 4)
    ranges = np.ptp(PLANE.stops_of(), axis=2)[2]
    np.testing.assert_allclose(
        way_deg, [-1.3 * ranges[0] + BACK_DEG / 2, 1.3 * ranges[1] - BACK_DEG / 2], atol=1e-3
    )
    assert not tables.steps[[0, 1, 3]].any()
    np.testing.assert_allclose(homed_deg(PLANE, np.array([2])), [[-193.1, 182.0]])
