"""Identifications on data that a formula made: exact without noise, refused where they must be."""

import dataclasses

import numpy as np
import pytest

from fiberloom.bus.trace import Trace
from fiberloom.calibration import (
    ArmsData,
    FrictionData,
    InertiaData,
    RepeatabilityData,
    StiffnessData,
    TorqueScale,
    TorqueScaleData,
    break_away,
    identify_arms,
    identify_friction,
    identify_inertia,
    identify_repeatability,
    identify_stiffness,
    identify_torque_scale,
)
from fiberloom.calibration.bench.torque import Windows, mean_wave, windows_of
from fiberloom.errors import InputError

FULL_UNM = 500.0
EXACT = TorqueScale(FULL_UNM, 0.0)
C, SPRING, RATE, COG, PHASE, DRAG = 19.0, -8.0, 0.016, 9.0, 0.7, 0.8  # uNm, deg, rad
N = 3


def windows(begin_deg, end_deg, rpm, rng=None, sd=0.0, load_uNm=0.0, zero_deg=40.0):
    """What N perfect motors show on a way at constant speed; 3.6 motor deg a window."""
    side = np.sign(end_deg - begin_deg)
    edges = np.arange(begin_deg, end_deg, side * 3.6)
    start, end = edges[:-1], edges[1:]
    rotor = np.stack([start, end], axis=-1) - zero_deg
    speed = np.full(len(start), side * rpm * np.pi / 30)
    s, c = mean_wave(rotor, 2)
    middle = 0.5 * (start + end)
    torque = C * side + DRAG * speed + SPRING + RATE * middle / 1024 - load_uNm
    torque = torque + COG * (np.cos(PHASE) * s + np.sin(PHASE) * c)
    noise = 0.0 if rng is None else rng.normal(0.0, sd, (N, len(start)))
    rows = [np.broadcast_to(a, (N, *a.shape)) for a in (torque / FULL_UNM, middle, rotor, speed)]
    return Windows(rows[0] + noise / FULL_UNM, *rows[1:])


def friction_data(rng=None, sd=0.0, **changes):
    parts, creep, wire = [], [], []
    for place in (60.0, 200.0, 320.0):
        a, b = place * 1024 - 200.0, place * 1024 + 200.0
        parts += [windows(a, b, 30, rng, sd), windows(b, a, 30, rng, sd)]
        creep, wire = [*creep, True, True], [*wire, place, place]
    for rpm in (500, 2000):
        parts += [windows(1e5, 1.02e5, rpm, rng, sd), windows(1.02e5, 1e5, rpm, rng, sd)]
        creep, wire = [*creep, False, False], [*wire, 100.0, 100.0]
    data = FrictionData(0, tuple(parts), tuple(creep), tuple(wire), [""] * N)
    return dataclasses.replace(data, **changes)


def only(data, which):
    keep = [k for k in range(len(data.segments)) if which(k)]
    return dataclasses.replace(
        data,
        segments=tuple(data.segments[k] for k in keep),
        creep=tuple(data.creep[k] for k in keep),
        wire_deg=tuple(data.wire_deg[k] for k in keep),
    )


def test_friction_is_exact_without_noise():
    found = identify_friction(friction_data(), EXACT)
    for e, true in zip(found.estimates, (C, SPRING, RATE, COG, PHASE, DRAG), strict=True):
        # the phase carries what hall sensors may be off by
        np.testing.assert_allclose(e.value, true, rtol=1e-9)
    assert found.coulomb.standard_error.max() < 1e-9
    assert found.cogging_phase.standard_error.min() >= 0.002


def test_equation_11_at_each_place_by_itself():
    data = friction_data()
    curves = break_away(data, identify_friction(data, EXACT), EXACT, row=1)
    assert [c.wire_deg for c in curves] == [60.0, 200.0, 320.0]
    for c in curves:
        # Coulomb as half the distance, spring as the middle; it pulls less further on
        assert c.coulomb_uNm == pytest.approx(C, abs=1e-4)
        assert c.spring_uNm == pytest.approx(SPRING + RATE * c.wire_deg, abs=1e-3)
        # more torque is needed in the negative direction, against the spring: Fig. 11
        assert c.torque_uNm[1].mean() < -c.torque_uNm[0].mean()
        assert np.ptp(c.torque_uNm[0]) == pytest.approx(2 * COG, rel=0.01)


def test_the_scale_s_error_is_in_every_torque_and_in_no_angle():
    data = friction_data()
    found = identify_friction(data, TorqueScale(FULL_UNM, 0.03))
    np.testing.assert_allclose(found.coulomb.standard_error, 0.03 * C, rtol=1e-6)
    np.testing.assert_allclose(found.drag.standard_error, 0.03 * DRAG, rtol=1e-6)
    np.testing.assert_allclose(found.cogging_phase.standard_error, 0.002, rtol=1e-3)


def test_friction_in_noise_is_where_its_error_says():
    found = identify_friction(friction_data(np.random.default_rng(5), 0.5), EXACT)
    for e, true in zip(found.estimates, (C, SPRING, RATE, COG, PHASE, DRAG), strict=True):
        assert (np.abs(e.value - true) < 4.0 * e.standard_error).all(), e.name


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (lambda d: only(d, lambda k: k % 2 == 0), "0 downward, 30 of each needed"),
        (lambda d: only(d, lambda k: d.creep[k]), "too much alike"),
        (lambda d: dataclasses.replace(d, trouble=["timed out"] * N), "timed out"),
    ],
)
def test_friction_is_refused_with_the_reason(broken, words):
    with pytest.raises(InputError, match=words):
        identify_friction(broken(friction_data()), EXACT)


def test_one_that_did_not_move_does_not_hold_up_the_others():
    data = friction_data()
    for w in data.segments:
        w.voltage[1] = np.nan
    found = identify_friction(data, EXACT)
    assert found.coulomb.reason == ("", "alpha did not move while its torque was recorded", "")
    np.testing.assert_allclose(found.coulomb.value[[0, 2]], C, rtol=1e-9)


def test_windows_leave_out_the_backlash_and_the_ramps():
    motor = np.concatenate([np.arange(0, 100, 1.0), np.arange(100, 1000, 10.0)])[None]
    trace = Trace(np.array([7]), motor, np.full_like(motor, 0.1), 0.01, np.zeros(1))
    w = windows_of(trace, skip_deg=300.0, slowest_rpm=100.0)
    good = np.isfinite(w.voltage[0])
    assert w.motor_deg[0, good].min() > 300.0
    slow = windows_of(trace, skip_deg=0.0, slowest_rpm=100.0)
    assert slow.motor_deg[0, np.isfinite(slow.voltage[0])].min() >= 100.0


def test_the_torque_scale_is_what_the_weight_changes():
    parts, torques = [], []
    for mNm in (-5.9, 5.9):
        load = mNm * 1e3 / 1024
        parts += [windows(2e5, 2.04e5, 500, load_uNm=load), windows(2.04e5, 2e5, 500, load_uNm=load)]
        torques += [mNm, mNm]
    data = TorqueScaleData(0, tuple(parts), tuple(torques), 0.003, [""] * N)
    found = identify_torque_scale(data)
    # cogging over part of a turn is all that is left
    np.testing.assert_allclose(found.value, FULL_UNM, rtol=2e-3)
    assert found.standard_error.min() >= 0.003 * FULL_UNM * 0.99
    with pytest.raises(InputError, match="the weight made no difference"):
        identify_torque_scale(dataclasses.replace(data, torque_mNm=tuple(1e3 * t for t in torques[::-1])))


J, DT = 3.5e-9, 5e-4


def pushes(sides=(1, -1, 1, -1), levels=(70.0, 490.0), sd_deg=0.0, rng=None):
    """A rotor by fine steps: 100 ms at the first torque, 30 ms at the second."""
    torque = np.r_[np.full(200, levels[0]), np.full(60, levels[1])] / FULL_UNM
    motor = []
    for side in sides:
        theta, omega, way = 0.3, 0.0, []
        for volt in torque:
            way.append(theta)
            for _ in range(50):
                # the field stands still for a tick: what x has turned off the middle of it
                load = DRAG * omega + C * np.sign(side) + SPRING + COG * np.sin(2 * theta + PHASE)
                step = side * volt * FULL_UNM * np.sinc(omega * DT / 2 / np.pi) - load
                omega += step * 1e-6 / J * DT / 50
                theta += omega * DT / 50
        motor.append(np.rad2deg(way))
    motor = np.broadcast_to(np.array(motor), (N, len(sides), len(torque))).copy()
    if rng is not None:
        motor += rng.normal(0.0, sd_deg, motor.shape)
    voltage = np.broadcast_to(np.array(sides)[:, None] * torque, motor.shape)
    return InertiaData(0, voltage, motor, np.zeros((N, len(sides))), [""] * N)


def test_inertia_is_equation_12():
    found = identify_inertia(pushes(), EXACT)
    # the formula's own steps of 10 us are the limit
    np.testing.assert_allclose(found.inertia.value, J, rtol=3e-3)
    np.testing.assert_allclose(found.drag.value, DRAG, rtol=3e-3)
    # Fig. 14: 600 to 5600 rpm in about 15 ms
    assert 500 < found.speeds_rpm[0, 0] < 700
    assert 5300 < found.speeds_rpm[0, 1] < 5900
    assert 0.008 < found.rise_s[0] < 0.016


def test_inertia_with_a_noisy_sensor_is_where_its_error_says():
    found = identify_inertia(pushes(sd_deg=0.12, rng=np.random.default_rng(1)), TorqueScale(FULL_UNM, 0.003))
    assert (np.abs(found.inertia.value - J) < 4 * found.inertia.standard_error).all()
    assert (found.inertia.standard_error < 0.005 * J).all()


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"sides": (1, 1)}, "one direction only"),
        ({"levels": (490.0, 490.0)}, "raised its speed from .* rpm only"),
    ],
)
def test_pushes_that_tell_nothing_are_refused(how, words):
    with pytest.raises(InputError, match=words):
        identify_inertia(pushes(**how), EXACT)


def test_a_rotor_that_stays_is_refused():
    data = pushes()
    data.motor_deg[:] = data.motor_deg[..., :1]
    with pytest.raises(InputError, match="did not move when it was pushed"):
        identify_inertia(data, EXACT)


def stiffness_data(rng, k=337.0, torque=11.8, sigma_mm=5e-4, repeats=8):
    lever = np.full(N, 22.0)
    pivot = np.array([[1.0, 2.0]] * N)
    direction = np.array([np.cos(0.5), np.sin(0.5)])
    across = np.array([-direction[1], direction[0]])
    turn = np.deg2rad(torque / k) * np.array([-1.0, 1.0])
    xy = pivot[:, None, None] + 22.0 * direction + 22.0 * turn[:, None] * across
    xy = np.broadcast_to(xy, (N, repeats, 2, 2)) + rng.normal(0, sigma_mm, (N, repeats, 2, 2))
    return StiffnessData(0, xy, pivot, lever, torque, 0.003, [""] * N)


def test_stiffness_is_torque_over_turn():
    found = identify_stiffness(stiffness_data(np.random.default_rng(0), sigma_mm=1e-9))
    np.testing.assert_allclose(found.value, 337.0, rtol=1e-6)
    np.testing.assert_allclose(found.standard_error, 337.0 * 0.003, rtol=0.01)
    noisy = identify_stiffness(stiffness_data(np.random.default_rng(0)))
    assert (np.abs(noisy.value - 337.0) < 4 * noisy.standard_error).all()


def test_a_weight_that_does_not_hang_is_noticed():
    data = stiffness_data(np.random.default_rng(0), k=1e6)
    with pytest.raises(InputError, match="does the weight hang"):
        identify_stiffness(data)
    data.xy_mm[:] = np.nan
    with pytest.raises(InputError, match="seen in 0 pairs"):
        identify_stiffness(data)


def arms_data(rng, sigma_mm=5e-4, arc_deg=360.0):
    centre, l_alpha, l_beta, m = np.array([3.0, -4.0]), 7.4, 14.3, 24
    t = np.deg2rad(np.linspace(0, arc_deg, m, endpoint=False))
    bend = np.deg2rad(75.0)
    reach = l_alpha + l_beta * np.exp(1j * bend)
    alpha = reach * np.exp(1j * t)
    beta = -l_alpha + l_beta * np.exp(1j * (np.pi + t / 2))
    z = np.stack([alpha, beta])[:, None] + centre[0] + 1j * centre[1]
    xy = np.stack([z.real, z.imag], axis=-1)
    return ArmsData(np.broadcast_to(xy, (2, N, m, 2)) + rng.normal(0, sigma_mm, (2, N, m, 2)), [""] * N)


def test_arms_from_circles():
    arms = identify_arms(arms_data(np.random.default_rng(0)))
    for e, true in zip(arms.estimates, (3.0, -4.0, 7.4, 14.3), strict=True):
        assert (np.abs(e.value - true) < 4 * e.standard_error).all(), e.name
        assert e.standard_error.max() < 5e-4


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (arms_data(np.random.default_rng(0), arc_deg=40.0), "too short an arc"),
        (ArmsData(np.zeros((2, N, 24, 2)), [""] * N), "did not move"),
        (ArmsData(np.full((2, N, 24, 2), np.nan), [""] * N), "is the fibre lit"),
    ],
)
def test_arms_are_refused_with_the_reason(data, words):
    with pytest.raises(InputError, match=words):
        identify_arms(data)


def visits(rng, n, v, own_um, camera_um=0.101, lever=7.6):
    along = np.array([0.0, 1.0])
    targets = np.arange(3.0)[:, None, None] * 1e-3 * along
    gear = rng.normal(0, own_um * 1e-3, (n, 3, v, 1)) * along
    camera = rng.normal(0, camera_um * 1e-3 / np.sqrt(2), (n, 3, v, 2))
    xy = np.array([lever, 0.0]) + targets + gear + camera
    return RepeatabilityData(0, xy, np.zeros((n, 2)), np.full(n, lever), [""] * n)


def test_repeatability_takes_the_camera_off():
    data = visits(np.random.default_rng(0), 300, 20, 0.124)
    found = identify_repeatability(data, 0.101, camera_relative_error=0.0)
    for e, true in ((found.measured, np.hypot(0.124, 0.101)), (found.own, 0.124),
                    (found.angle, np.rad2deg(0.124e-3 / 7.6) * 1e3)):  # fmt: skip
        low, high = e.interval()
        held = ((low < true) & (true < high)).mean()
        assert 0.91 < held < 0.99, e.name  # 300 draws: 1.3 percent
        assert abs(e.value.mean() - true) < 0.02 * true, e.name
    np.testing.assert_allclose(found.apart_um.mean(axis=0), 1.0, atol=0.01)


def test_a_positioner_better_than_the_camera_has_no_negative_scatter():
    data = visits(np.random.default_rng(0), 200, 10, 0.0)
    found = identify_repeatability(data, 0.101)
    assert (found.own.value >= 0.0).all()
    assert (found.own.value < 3.0 * found.own.standard_error).mean() > 0.95


def test_a_dark_fibre_has_no_repeatability():
    data = visits(np.random.default_rng(0), 2, 10, 0.1)
    data.xy_mm[1, 2, 3:] = np.nan
    found = identify_repeatability(data, 0.101)
    assert found.own.reason[0] == ""
    assert "a target was seen 3 times, 5 needed" in found.own.reason[1]
