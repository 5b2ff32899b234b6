"""Steps of the calibrations against numbers worked out by hand."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest
from wearing import Wearing

from fiberloom.calibration.adaptive.calibration import AdaptiveCalibration, AdaptiveSettings
from fiberloom.calibration.bench.arms import ArmsData, identify_arms
from fiberloom.calibration.bench.repeatability import RepeatabilityData, identify_repeatability
from fiberloom.calibration.bench.stiffness import StiffnessSettings, _pairs
from fiberloom.calibration.focal_plane.convergence import _by_name
from fiberloom.calibration.transmission.circle import _algebraic
from fiberloom.calibration.transmission.sweep import SweepSettings
from fiberloom.instruments import generate, load_instrument

PLANE = generate(load_instrument("sdssv"), seed=0, n_positioners=2)


def circle(centre, radius, n=40):
    at = np.linspace(0.0, 5.0, n)
    return np.asarray(centre) + radius * np.column_stack([np.cos(at), np.sin(at)])


def test_between_two_fine_knots_the_variances_of_both_count_by_their_squared_shares():
    a = (0.032, 0.020)
    settings = AdaptiveSettings(knot_deg=0.0, ripple_deg=a)
    learner = AdaptiveCalibration(PLANE, Wearing(PLANE).calibrated(), settings)
    # from the first fine knot after a calibrated one (half wave: sin 45 deg) a quarter to the next (sin 90)
    wire = 0.75 * learner.wire_deg[:, :, 1] + 0.25 * learner.wire_deg[:, :, 2]
    expected = np.sqrt(0.75**2 * 0.5 + 0.25**2) * np.array(a)
    np.testing.assert_allclose(learner.sigma_deg(wire), [expected] * 2, rtol=1e-9)


def test_arms_are_those_of_two_circles_and_nothing_is_left():
    xy = np.stack([circle((3.0, -2.0), 19.0), circle((10.4, -2.0), 15.0)])[:, None]
    arms = identify_arms(ArmsData(xy, [""]))
    found = [e.value[0] for e in arms.estimates]
    np.testing.assert_allclose(found, [3.0, -2.0, 7.4, 15.0], atol=1e-9)
    for estimate in arms.estimates:
        np.testing.assert_allclose(estimate.residuals, 0.0, atol=1e-6)


def test_the_angle_of_repeatability_is_the_scatter_over_the_lever_however_short():
    # six visits 1 um to either side, across the lever: variance 6 / 5 um^2
    xy = np.array([0.5, 0.0]) + np.array([[0.0, side * 1e-3] for side in (1, -1) * 3])
    data = RepeatabilityData(0, xy[None, None], np.zeros((1, 2)), np.array([0.5]), [""])
    found = identify_repeatability(data, camera_rms_um=0.0)
    # a root of a variance of five degrees of freedom is too small by 1/8 of 2/5
    scatter_um = np.sqrt(1.2) * 1.05
    assert found.own.value[0] == pytest.approx(scatter_um)
    assert found.angle.value[0] == pytest.approx(1e3 * np.rad2deg(scatter_um * 1e-3 / 0.5))


def test_an_arm_is_pulled_to_one_side_to_the_other_and_let_go():
    pulled = []

    async def sleep(seconds):
        pass

    operator = SimpleNamespace(
        plane=PLANE,
        ids=[7],
        client=SimpleNamespace(sleep=sleep),
        look=lambda images: np.zeros((PLANE.n, 2)),
        step=lambda: None,
    )
    bench = SimpleNamespace(apply_torque=lambda *given: pulled.append(given))
    asyncio.run(_pairs(operator, bench, 1, StiffnessSettings((11.8, 1.4), repeats=3)))
    assert pulled == [(7, 1, -1.4), (7, 1, 1.4)] * 3 + [(7, 1, 0.0)]


def test_convergence_is_told_as_rms_over_positioners():
    values = np.array([[3.0, 4.0, 1.0, 2.0, 9.0, 9.0], [3.0, 4.0, 7.0, 14.0, 9.0, 9.0]]) * 1e-3
    # sqrt((1 + 49) / 2) = 5; the centre's two coordinates together: 3, 4, 5
    told = _by_name(values)
    assert list(told) == ["centre", "l_alpha", "l_beta"]
    np.testing.assert_allclose(list(told.values()), [5.0, 5.0, 10.0])


def test_the_algebraic_circle_is_exact_without_noise():
    xy = circle((120.0, -80.0), 15.0)[None]
    found = _algebraic(xy, np.ones((1, 40), dtype=bool))
    np.testing.assert_allclose(found, [[120.0, -80.0, 15.0]], atol=1e-9)


def test_a_sweep_stops_every_1_8_degrees_of_alpha():
    assert 360.0 / SweepSettings().n_points == pytest.approx(1.8)
