"""The calibration finds the maps that were put in, and says who has none."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest
from bench import Bench

from fiberloom.bus import Outcome
from fiberloom.calibration import SweepSettings, calibrate_transmission
from fiberloom.calibration.transmission.maps import NEGATIVE, POSITIVE
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument


def small_plane(n=12):
    return generate(load_instrument("sdssv"), seed=2, n_positioners=n)


def calibrate(bench, plane=None, n_points=200, images=1, **kwargs):
    settings = SweepSettings(n_points, images)
    return asyncio.run(calibrate_transmission(bench, bench, plane or bench.plane, settings, **kwargs))


def truth(bench, theta, side):
    grid = np.broadcast_to(theta[:, None, None], (len(theta), bench.plane.n, 2))
    wire = np.stack([bench.wire_of(g, side) for g in grid])
    return wire.transpose(1, 2, 0) - theta


def test_without_noise_the_knots_are_the_truth():
    bench = Bench(small_plane())
    found = calibrate(bench)
    assert found.report.ok.all(), found.report.reason
    for direction, side in ((0, 0.0), (1, 1.0)):
        theta = found.maps.output_deg[:, :, direction].transpose(2, 0, 1)
        wire = np.stack([bench.wire_of(t, side) for t in theta]).transpose(1, 2, 0)
        # no noise: what is left is rounding, seen through levers of some mm
        np.testing.assert_allclose(found.maps.wire_deg[:, :, direction], wire, atol=1e-9)
    assert found.report.layout_rms_um.max() < 1e-5
    assert not bench.precise


def test_with_the_cameras_noise_delta_and_backlash_come_out_within_it():
    bench = Bench(small_plane(), noise_rms_um=0.669, seed=1)
    found = calibrate(bench)
    theta = np.linspace(5, 175, 400)
    # knot noise 0.47 um over the lever: 22 mm stretched (alpha), 14.3 mm (beta); the straight line
    # between knots of the worst ripple, 0.01 deg at 72 cycles: 0.7 of it on alpha, 0.25 on beta
    lever_mm = np.array([17.8, 14.3])
    noise_deg = np.rad2deg(0.669e-3 / np.sqrt(2) / lever_mm)
    for direction, side in ((NEGATIVE, 0.0), (POSITIVE, 1.0)):
        error = found.maps.delta_deg(theta, direction) - truth(bench, theta, side)
        rms = np.sqrt((error**2).mean(axis=(0, 2)))
        assert (rms > 0.5 * noise_deg).all()
        assert (rms < np.hypot(1.2 * noise_deg, [0.0045, 0.0015])).all(), rms
    backlash = found.maps.backlash_motor_deg(theta)
    expected = 1024 * (truth(bench, theta, 1.0) - truth(bench, theta, 0.0))
    # per point: two knots' noise; the mean over 400 angles knows the backlash ten times better
    np.testing.assert_allclose(backlash.mean(axis=2), expected.mean(axis=2), atol=1.5)
    report = found.report
    np.testing.assert_allclose(report.circle_rms_um, 0.669 / np.sqrt(2), rtol=0.15)
    # across the radius the knots follow the noise; along it, the layout cannot
    np.testing.assert_allclose(report.layout_rms_um, 0.669 / np.sqrt(2), rtol=0.15)


def test_arm_lengths_come_with_honest_standard_errors():
    plane = small_plane(40)
    bench = Bench(plane, noise_rms_um=0.669, seed=3)
    report = calibrate(bench).report
    length = np.hypot(*plane.points["metrology"].T)
    pull_beta = (report.l_beta_mm - length) / report.l_beta_se_mm
    pull_alpha = (report.l_alpha_mm - plane.arms[:, 2]) / report.l_alpha_se_mm
    for pull in (pull_alpha, pull_beta):
        # 40 pulls: their rms is 1 within 11 % (one sigma)
        assert 0.6 < np.sqrt((pull**2).mean()) < 1.4
    assert report.l_beta_se_mm.max() < 2e-4


def test_maps_put_fibres_where_the_layout_says():
    bench = Bench(small_plane(), noise_rms_um=0.0)
    maps = calibrate(bench).maps
    theta = np.random.default_rng(5).uniform([10, 10], [350, 170], (bench.plane.n, 2))
    output = bench.solve(maps.to_wire(theta), 0.0)
    miss = bench.plane.forward(*output.T) - bench.plane.forward(*theta.T)
    blind_um = 1e3 * np.sqrt((miss**2).sum(axis=1).mean())
    output = bench.solve(maps.linear().to_wire(theta), 0.0)
    miss = bench.plane.forward(*output.T) - bench.plane.forward(*theta.T)
    linear_um = 1e3 * np.sqrt((miss**2).sum(axis=1).mean())
    assert blind_um < 3.0
    assert linear_um > 5 * blind_um


def test_a_zero_of_the_wire_that_is_far_off_is_found():
    # the positioner's own zero turned by tens of degrees: the layout's angles are still the map's
    plane = small_plane(3)
    bench = Bench(plane)
    arms = plane.arms.copy()
    arms[:, 3] -= np.deg2rad(25.0)
    arms[:, 4] += np.deg2rad(10.0)
    maps = calibrate(bench, replace(plane, arms=arms)).maps
    np.testing.assert_allclose(
        maps.output_deg.mean(axis=(2, 3)) - maps.wire_deg.mean(axis=(2, 3)),
        np.broadcast_to([25.0, -10.0], (3, 2)),
        atol=0.3,
    )


def test_those_who_do_not_play_along_are_flagged_and_the_rest_goes_on():
    plane = small_plane(8)
    plane = plane.with_offline(plane.positioner_id[7:], [10.0, 170.0])
    bench = Bench(plane, noise_rms_um=0.669)
    bench.dark[0] = True
    bench.stuck[1, 0] = True
    bench.results[int(plane.positioner_id[2])] = Outcome.COLLIDED
    found = calibrate(bench, n_points=60)
    reason = found.report.reason
    assert "0 % of the points" in reason[0]
    assert reason[1] == "alpha did not move"
    assert reason[2] == "collided"
    assert reason[7] == "offline"
    assert found.report.ok.tolist() == [False] * 3 + [True] * 4 + [False]
    np.testing.assert_array_equal(found.maps.wire_deg[:3], found.maps.output_deg[:3])
    assert np.isfinite(found.report.layout_rms_um[3:7]).all()


def test_an_axis_that_gets_stuck_halfway_is_found():
    bench = Bench(small_plane(2), noise_rms_um=0.669)
    stop_at = 2 + 30 + 30  # moves to the start, then points of the upward pass

    async def goto(ids, alpha, beta, free=bench.goto):
        bench.stuck[0, 0] = bench.moves > stop_at
        return await free(ids, alpha, beta)

    bench.goto = goto
    found = calibrate(bench, n_points=60)
    assert "alpha does not follow its motor at" in found.report.reason[0]
    assert found.report.ok.tolist() == [False, True]


def test_points_that_are_not_seen_now_and_then_are_bridged():
    bench = Bench(small_plane(3))
    free = bench.measure

    def measure():
        bench.dark[:] = [bench.moves % 9 == 0, False, bench.moves % 2 == 0]
        return free()

    bench.measure = measure
    found = calibrate(bench)
    assert found.report.ok.tolist() == [True, True, False]
    assert "50 % of the points" in found.report.reason[2]
    theta = np.linspace(5, 175, 100)
    error = found.maps.delta_deg(theta) - truth(bench, theta, 0.0)
    # one knot in nine is missing: the ripple of 36 and 72 cycles is cut there
    assert np.abs(error[0]).max() < 0.05


def test_progress_is_told_and_images_are_averaged():
    bench = Bench(small_plane(4), noise_rms_um=2.0)
    steps = []
    found = calibrate(
        bench,
        n_points=50,
        images=16,
        progress=lambda done, total: steps.append((done, total)),
    )
    assert steps[0] == (1, 200)
    assert steps[-1] == (200, 200)
    np.testing.assert_allclose(found.report.circle_rms_um, 0.5 / np.sqrt(2), rtol=0.3)


@pytest.mark.parametrize(("key", "value"), [("n_points", 5), ("images", 0)])
def test_settings_that_make_no_sense_are_refused(key, value):
    with pytest.raises(InputError, match=key):
        SweepSettings(**{key: value})
