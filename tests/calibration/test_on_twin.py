"""The calibration on the physics twin: bus, firmware, gear and camera, nothing faked."""

import asyncio

import numpy as np

from fiberloom._core import twin as core
from fiberloom.bus import Client, Outcome, WireTrajectory
from fiberloom.calibration import SweepSettings, calibrate_transmission
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import NoiseCamera, Twin, TwinTransport, draw_units
from fiberloom.twin.units import GEAR, plain


def bench(n, seed=0):
    plane = generate(load_instrument("sdssv"), seed=seed, n_positioners=n)
    units = draw_units(plane, seed)
    twin = Twin(plane, units, seed=seed, threads=1, neighbours=False)
    return plane, units, twin, Client(TwinTransport(twin))


def test_the_calibration_finds_the_true_gear():
    plane, units, twin, client = bench(3)
    camera = NoiseCamera(twin, rms_um=0.1)

    async def run():
        await client.discover()
        return await calibrate_transmission(client, camera, plane, SweepSettings(40))

    found = asyncio.run(run())
    assert found.report.ok.all(), found.report.reason
    # the measured geometry is the true unit's, not the layout's: 0.1 um noise, 160 points
    np.testing.assert_allclose(found.report.l_alpha_mm, units.arms[:, 2], atol=4e-4)
    np.testing.assert_allclose(found.report.centre_mm, units.arms[:, :2], atol=4e-4)
    for axis in range(2):
        for row in range(3):
            gear = plain(units.gear[row, axis]).ravel()
            theta = found.maps.output_deg[row, axis]  # (2, K)
            true = core.transmission(gear, GEAR, np.deg2rad(theta[0]))[0]
            off = found.maps.wire_deg[row, axis, 0] - np.rad2deg(true) / GEAR
            # true arms differ from the layout's by 1 um and 50 urad: that constant is the map's
            assert np.abs(off.mean()) < 0.02
            # the rest is the camera (0.5 mdeg), the arrival (1.5 mdeg) and the hall sensors
            assert off.std() < 0.004
    at = np.linspace(20, 160, 50)
    measured = found.maps.backlash_motor_deg(at).mean(axis=2)
    true = [
        [np.rad2deg(core.transmission(plain(gear).ravel(), GEAR, np.deg2rad(at))[1]).mean() for gear in unit]
        for unit in units.gear
    ]
    # 40 points cannot follow the ripple: what is left of it after averaging, in motor deg
    np.testing.assert_allclose(measured, true, atol=15.0)


def test_trajectories_run_on_the_twin():
    plane, _, twin, client = bench(5)
    start = np.array([10.0, 170.0])

    async def run():
        ids = await client.discover()
        time_s = np.linspace(0.5, 6.0, 30)
        rise = 0.5 * (1 - np.cos(np.pi * (time_s - 0.5) / 5.5))
        plan = {
            i: WireTrajectory.from_deg(time_s, start[0] + 30.0 * rise, start[1] - 30.0 * rise)
            for i in ids[:4]
        }
        return ids, await client.run_trajectories(plan), await client.positions_deg()

    ids, results, (where_deg, ok) = asyncio.run(run())
    assert ids == plane.positioner_id.tolist()
    assert [r.outcome for r in results.values()] == [Outcome.DONE] * 4
    assert ok.all()
    np.testing.assert_allclose(where_deg[:4], np.tile(start + np.array([30.0, -30.0]), (4, 1)), atol=0.01)
    # at rest, as powered up: the motor of a gear whose non-linearity is accepted up to 0.6 deg
    np.testing.assert_allclose(where_deg[4], start, atol=0.6)
    assert 6.0 < twin.time_s < 8.0
