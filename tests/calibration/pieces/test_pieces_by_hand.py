"""Pieces of the identification by themselves: integrals, rise times, covariances, ranges."""

from types import SimpleNamespace

import numpy as np
import pytest

from fiberloom.calibration.adaptive.calibration import AdaptiveCalibration, AdaptiveSettings
from fiberloom.calibration.adaptive.nearest_knot import CommandSigmas, command_covariance
from fiberloom.calibration.bench import acceptance
from fiberloom.calibration.bench.inertia import _held, _rise, summed
from fiberloom.calibration.bench.repeatability import RepeatabilityData, identify_repeatability
from fiberloom.calibration.bench.stiffness import StiffnessData, identify_stiffness
from fiberloom.calibration.bench.torque import mean_wave
from fiberloom.calibration.commissioning.checks import _bend
from fiberloom.calibration.commissioning.measured import BACKLASH, Measured, of_maps
from fiberloom.calibration.focal_plane.design import LEAST_BEND_DEG, candidates
from fiberloom.calibration.focal_plane.fit import FitSettings, FocalPlaneFit, _Fit
from fiberloom.calibration.transmission.evaluate import _not_moved
from fiberloom.calibration.transmission.maps import Provenance, TransmissionMaps, _numbers
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument

PLANE = generate(load_instrument("sdssv"), 0, n_positioners=7)


@pytest.mark.parametrize("cycles", [1, 2, 4])
def test_the_mean_of_a_wave_is_its_integral_over_the_way(cycles):
    ends_deg = np.array([[10.0, 55.0], [-30.0, 200.0], [90.0, 80.0], [5.0, 5.0 + 1e-6]])
    share = (np.arange(20_000) + 0.5) / 20_000
    angles = np.deg2rad(ends_deg[:, :1] + share * (ends_deg[:, 1:] - ends_deg[:, :1])) * cycles
    sine, cosine = mean_wave(ends_deg, cycles)
    np.testing.assert_allclose(sine, np.sin(angles).mean(axis=1), atol=1e-7)
    np.testing.assert_allclose(cosine, np.cos(angles).mean(axis=1), atol=1e-7)


def test_trapezes_integrate_straight_lines_and_steps_what_is_held():
    time_s = np.arange(200) * 0.0005
    lines = np.array([[2.0], [-1.0]]) + np.array([[3.0], [40.0]]) * time_s
    exact = np.array([[2.0], [-1.0]]) * time_s + np.array([[1.5], [20.0]]) * time_s**2
    np.testing.assert_allclose(summed(lines, 0.0005), exact, atol=1e-15)
    held = np.zeros_like(lines)
    for k in range(1, 200):
        held[:, k] = held[:, k - 1] + lines[:, k - 1] * 0.0005
    np.testing.assert_allclose(_held(lines, 0.0005), held, atol=1e-15)


@pytest.mark.parametrize("tau_s", [0.005, 0.010, 0.020])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_rotor_that_follows_with_one_time_constant_rises_in_ln_9_of_it(tau_s, side):
    """From 10 to 90 % of an exponential; then the voltage is switched off and the rotor slows down."""
    dt = 0.0005
    time_s = np.arange(-60, 460) * dt
    slow_rpm, fast_rpm, off_s = 300.0, 2000.0, 380 * dt
    speed_rpm = np.where(time_s < 0.0, slow_rpm, fast_rpm - (fast_rpm - slow_rpm) * np.exp(-time_s / tau_s))
    speed_rpm = np.where(
        time_s > off_s, fast_rpm * np.exp(-np.maximum(time_s - off_s, 0.0) / 0.004), speed_rpm
    )
    motor_deg = side * np.concatenate([[0.0], np.cumsum(6.0 * speed_rpm[:-1] * dt)])
    voltage = side * np.select([time_s < 0.0, time_s <= off_s], [2.0, 12.0], 0.0)
    (before, end), rise_s = _rise(motor_deg, voltage, dt)
    # speeds are means over 2 ms
    assert before == pytest.approx(slow_rpm, rel=1e-6)
    assert end == pytest.approx(fast_rpm, rel=0.01)
    assert rise_s == pytest.approx(tau_s * np.log(9.0), abs=2 * dt)


def test_a_command_is_trusted_as_its_lengths_and_angles_are():
    """Shifts of the fibre by each standard deviation, by differences, add in squares."""
    angles_deg = np.column_stack([np.linspace(0.0, 300.0, 7), np.linspace(20.0, 160.0, 7)])
    rows, sigmas = np.arange(7), CommandSigmas()
    found = command_covariance(PLANE, angles_deg, sigmas, rows)
    steps = np.array([[sigmas.alpha_deg, 0.0], [0.0, sigmas.beta_deg]])
    shifts = [PLANE.forward(*(angles_deg + s).T) - PLANE.forward(*angles_deg.T) for s in steps]
    elbow = PLANE.elbows_mm(angles_deg[:, 0])
    fibre = PLANE.forward(*angles_deg.T)
    for first, last, um in ((PLANE.centres_mm, elbow, sigmas.l_alpha_um), (elbow, fibre, sigmas.l_beta_um)):
        shifts.append(1e-3 * um * (last - first) / np.hypot(*(last - first).T)[:, None])
    wanted = sum(shift[:, :, None] * shift[:, None, :] for shift in shifts)
    # the second order of 0.002 deg
    np.testing.assert_allclose(found, wanted, rtol=1e-3, atol=1e-3 * wanted.max())
    # what a bench calibration leaves: a micrometre
    assert 0.2e-3 < np.sqrt(np.trace(found, axis1=1, axis2=2)).max() < 1.5e-3


def test_what_is_assumed_of_gears_is_below_a_tenth_of_a_degree():
    """Gears are linear to 0.6 deg; what maps of 200 knots leave of that is some 0.02 deg."""
    assert max(AdaptiveSettings().ripple_deg) < 0.1
    assert max(FitSettings().angles_deg) < 0.1


# -- commissioning -----------------------------------------------------------------------------------------


def measured(value):
    return {"alpha stiffness": Measured("alpha stiffness", "mNm/deg", value, None, "", "")}


def test_an_arm_bends_by_the_torque_at_the_output_over_its_stiffness():
    limits = {"contact_torque": 4.0e-6}
    # 4 uNm at the motor are 4.096 mNm behind a gear of 1024
    assert _bend("alpha", limits, measured(8.192)).value == pytest.approx(0.5)
    assert _bend("alpha", limits, {}).value is None
    assert _bend("alpha", limits, measured(None)).value is None


@pytest.mark.parametrize("at", [0, 30, 60])
def test_the_largest_backlash_counts_wherever_it_is(at):
    """Both contacts straight, but for one knot of the positive one."""
    output = np.tile(np.linspace(0.0, 360.0, 61), (1, 2, 2, 1))
    wire = output.copy()
    wire[:, :, 1] += 0.1
    wire[:, :, 1, at] += 0.1
    maps = TransmissionMaps(np.array([7]), wire, output, Provenance(gear=1024.0))
    found = of_maps(maps, 0, "")
    for name in ("alpha", "beta"):
        assert found[BACKLASH.format(name)].value == pytest.approx(0.2 * 1024.0, rel=0.02)


# -- what a bench measures ---------------------------------------------------------------------------------


def test_scatter_that_is_the_cameras_alone_is_none_of_the_angle():
    """And what is beyond it is, whichever the camera: both in one coordinate, across the arm."""
    rng = np.random.default_rng(3)
    camera_um, own_um, lever_mm = 1.0, 0.5, 20.0
    xy = np.tile([lever_mm, 0.0], (1, 4, 2000, 1))
    # 2-D rms of the camera, one coordinate of it across; the axis moves across only
    xy += 1e-3 * camera_um / np.sqrt(2.0) * rng.standard_normal(xy.shape)
    xy[..., 1] += 1e-3 * own_um * rng.standard_normal(xy.shape[:-1])
    data = RepeatabilityData(0, xy, np.zeros((1, 2)), np.array([lever_mm]), [""])
    found = identify_repeatability(data, camera_um, 0.0)
    own_mdeg = 1e3 * np.rad2deg(1e-3 * own_um / lever_mm)
    # the variance of 8000 visits is good to 1.6 %, three times as much without the camera's
    assert found.angle.value[0] == pytest.approx(own_mdeg, rel=0.06)


def test_the_error_of_a_stiffness_is_that_of_torque_and_lever():
    """A lever of 20 mm is known to 3 um, 0.015 %: far less than the weight of 1 %."""
    turn = np.deg2rad(0.25)
    places = 20.0 * np.array([[np.cos(-turn), np.sin(-turn)], [np.cos(turn), np.sin(turn)]])
    data = StiffnessData(
        0, np.tile(places, (1, 5, 1, 1)), np.zeros((1, 2)), np.array([20.0]), 1.0, 0.01, [""]
    )
    found = identify_stiffness(data)
    # -T to +T turn by half a degree: 2 mNm in 0.5 deg
    assert found.value[0] == pytest.approx(4.0, rel=1e-5)
    assert found.standard_error[0] / found.value[0] == pytest.approx(0.01, rel=0.01)


def test_after_a_slip_is_believed_doubt_begins_at_nothing():
    """All nodes of an axis may be off together, by this variance; of the others nothing changes."""
    nodes = SimpleNamespace(first=np.array([4, 7]), size=9)
    state = SimpleNamespace(covariance=np.tile(np.eye(9), (3, 1, 1)), doubt=np.array([3, 2, 5]))
    variance = np.array([[0.5, 0.25]] * 3)
    learner = SimpleNamespace(_spline=nodes)
    AdaptiveCalibration._slip(learner, state, variance, np.array([True, False, True]))
    assert state.doubt.tolist() == [0, 2, 0]
    wanted = np.eye(9)
    wanted[4:7, 4:7] += 0.5
    wanted[7:, 7:] += 0.25
    np.testing.assert_array_equal(state.covariance, [wanted, np.eye(9), wanted])


@pytest.mark.parametrize(("way_mm", "reason"), [(0.02, "alpha did not move"), (0.5, ""), (30.0, "")])
def test_half_a_millimetre_is_a_motion_and_the_noise_of_a_camera_is_none(way_mm, reason):
    xy = np.zeros((2, 2, 5, 1, 2))
    xy[0, ..., 0, 1] = np.linspace(0.0, way_mm, 5)
    xy[1, ..., 0, 0] = np.linspace(0.0, 40.0, 5)
    assert _not_moved(SimpleNamespace(xy_mm=xy)) == [reason]


@pytest.mark.parametrize(("seen", "refused"), [(0, True), (3, True), (4, False), (40, False)])
def test_arms_need_two_numbers_more_than_they_have_parameters(seen, refused):
    """Each image gives two; six parameters, so four images."""
    mask = np.arange(40)[None] < seen
    fit = SimpleNamespace(seen=mask, p=np.zeros((1, 6)))
    (reason,) = _Fit._reasons(fit, np.array([6]), np.array([seen]))
    assert bool(reason) == refused
    if refused:
        assert reason == f"seen in {seen} of 40 configurations, 4 needed"


def test_the_covariance_of_the_arms_is_that_of_the_same_parameters_both_ways():
    whole = np.arange(2 * 6 * 6, dtype=float).reshape(2, 6, 6)
    arms = FocalPlaneFit.arms_covariance_mm2.fget(SimpleNamespace(covariance=whole))
    # centre x, y, l_alpha, l_beta: the first four
    np.testing.assert_array_equal(arms, whole[:, :4, :4])


def test_an_acceptance_judges_the_blind_error_and_that_after_the_moves_allowed(monkeypatch):
    monkeypatch.setattr(acceptance, "stretched_repeatability", lambda data, row: (1.0, 0.1))
    for name in ("_of_axes", "_of_arms"):
        monkeypatch.setattr(acceptance, name, lambda *unit: [])
    operation = SimpleNamespace(requirement_um=6.0)
    nominal = SimpleNamespace(instrument=SimpleNamespace(operation=operation))
    asked = SimpleNamespace(moves=2, repeatability_um=2.0, blind_error_um=50.0, tilt_deg=0.1)
    # two targets, four moves to each: all are within 6 um after the third
    error_um = np.array([[[30.0, 8.0, 3.0, 2.0], [40.0, 5.0, 6.0, 7.0]]])
    checks = acceptance._checks(SimpleNamespace(error_um=error_um), nominal, asked, 0)
    values = {check.name: check.value for check in checks}
    assert values["blind error, largest"] == 40.0
    assert values["blind error, rms"] == pytest.approx(np.sqrt((30.0**2 + 40.0**2) / 2))
    assert values["error after 2 moves, largest"] == 8.0
    assert values["moves until all within 6 µm"] == 3.0
    verdicts = {check.name: check.verdict for check in checks}
    assert verdicts["moves until all within 6 µm"] == "fail"
    assert verdicts["blind error, largest"] == "pass"
    # more moves allowed than were made: the last one counts
    more = SimpleNamespace(**{**vars(asked), "moves": 9})
    checks = acceptance._checks(SimpleNamespace(error_um=error_um), nominal, more, 0)
    assert {c.name: c.value for c in checks}["error after 9 moves, largest"] == 7.0


@pytest.mark.parametrize(
    "ids", [np.array([1.0, 2.0]), np.array([[1, 2]]), np.array(["1", "2"]), np.array([3, 3])]
)
def test_positioners_of_maps_are_whole_numbers_each_once(ids):
    with pytest.raises(InputError, match="positioner_id"):
        _numbers(ids)


def test_the_ends_of_beta_are_drawn_evenly_over_two_degrees():
    plane = generate(load_instrument("sdssv"), 0, n_positioners=100)
    beta_deg = candidates(plane, np.random.default_rng(1))[..., 1]
    high_deg = plane.limits_deg[1, 1]
    for past_deg in (beta_deg.min(axis=1) - LEAST_BEND_DEG, high_deg - beta_deg.max(axis=1)):
        assert (past_deg >= 0.0).all()
        assert (past_deg <= 2.0).all()
        assert past_deg.mean() == pytest.approx(1.0, abs=4.0 * 2.0 / np.sqrt(12 * 100))
