"""Commands for a bench: the trace and torque steps, against the rig's own physics."""

import struct

import numpy as np
import pytest

import rig
from rig import ACCEPTED, MOTOR_DEG, Rig, pair, point

FULL = 32767
SAMPLES = 1024


def start(unit, ticks):
    return unit.code(240, struct.pack("<H", ticks))


def state(unit, axis):
    code, data = unit.ask(241 + axis)
    assert code == ACCEPTED
    return struct.unpack("<HHi", data)


def read(unit, axis):
    """(K, 2): motor deg and share of the full voltage."""
    count = state(unit, axis)[0]
    rows = [unit.ask(243 + axis, struct.pack("<H", k)) for k in range(count)]
    assert all(code == ACCEPTED for code, _ in rows)
    cells = np.array([struct.unpack("<ih", data) for _, data in rows], dtype=float).reshape(-1, 2)
    return cells / [MOTOR_DEG, FULL]


OPEN = -32768 / FULL
"""As a voltage: the bridge is open."""


def push(unit, axis, v0, v1, n0, n1):
    return unit.code(245 + axis, struct.pack("<hhHH", round(v0 * FULL), round(v1 * FULL), n0, n1))


@pytest.mark.parametrize("ticks", [1, 7, 40])
def test_a_trace_is_the_way_of_the_rotor(ticks):
    unit = Rig(noise_cnt=0.0)
    assert start(unit, ticks) == ACCEPTED
    # nothing is recorded at rest
    unit.unit.tick(100)
    assert state(unit, 0)[:2] == (0, ticks)
    assert unit.goto(10.2, 20.0) == ACCEPTED
    truth = []
    while not unit.unit.status >> rig.BIT["completed"] & 1:
        truth.append(np.rad2deg(unit.unit.plant(0, "theta_rad")))
        unit.unit.tick(1)
    count = state(unit, 0)[0]
    assert len(truth) // ticks - 2 <= count <= len(truth) // ticks
    trace = read(unit, 0)
    # 12 bits of hall sensor: 0.04 motor degrees each
    np.testing.assert_allclose(trace[:, 0], truth[: count * ticks : ticks], atol=0.15)
    # what stays records nothing
    assert state(unit, 1)[0] <= 1


def test_the_voltage_is_the_torque_that_the_motion_needed():
    unit = Rig(noise_cnt=0.0)
    start(unit, 8)
    unit.code(40, struct.pack("<II", 100, 100))
    unit.goto(10.0 + 3.0 * 360 / 1024, 20.0)
    unit.wait()
    trace = read(unit, 0)
    turn = (trace[:, 0] - trace[0, 0] > 660) & (trace[:, 0] - trace[0, 0] < 1020)  # before landing
    torque = trace[turn, 1].mean() * 4.2e-5 * 12
    spring = 8e-6 - 9e-10 * np.deg2rad(10 * 1024)
    speed = 100 * np.pi / 30
    # a turn at constant speed: cogging cancels but for the ends of the window
    assert torque == pytest.approx(2e-5 + 8e-7 * speed - spring, abs=2e-7)


def test_a_full_trace_stops_and_keeps_what_it_has():
    unit = Rig()
    start(unit, 1)
    unit.goto(14, 20)
    unit.wait()
    assert state(unit, 0)[0] == SAMPLES
    first = read(unit, 0)
    unit.goto(10, 20)
    unit.wait()
    assert (read(unit, 0) == first).all()
    assert unit.code(243, struct.pack("<H", SAMPLES)) == rig.OUT_OF_RANGE
    assert start(unit, 0) == ACCEPTED
    assert state(unit, 0)[0] == 0


def test_a_trajectory_takes_the_memory_back():
    unit = Rig()
    start(unit, 1)
    unit.goto(10.1, 20)
    unit.wait()
    assert unit.load([(1.0, 10.1), (2.0, 11.0)], [(1.0, 20.0), (2.0, 21.0)]) == ACCEPTED
    assert state(unit, 0)[:2] == (0, 0)
    # and while one is loaded, no trace may have it
    assert start(unit, 1) == rig.INVALID
    assert unit.code(14) == ACCEPTED
    unit.wait()
    assert unit.position_deg == pytest.approx((11.0, 21.0), abs=1e-3)
    assert unit.code(11, point(1.0, 1.0)) == rig.INVALID_TRAJECTORY


@pytest.mark.parametrize("axis", [0, 1])
def test_a_torque_step_is_figure_14(axis):
    """70 uNm, then 490: 600 to 5600 rpm in about 15 ms, and the closed form of the rig's physics."""
    unit = Rig(position_deg=(100.0, 100.0), noise_cnt=0.0)
    assert start(unit, 1) == ACCEPTED
    full = 4.2e-5 * 12
    assert push(unit, axis, 7e-5 / full, 4.9e-4 / full, 300, 40) == ACCEPTED
    assert unit.status("completed") is False
    unit.wait()
    trace = read(unit, axis)
    speed = np.gradient(trace[:, 0]) * 2000 / 6  # rpm
    spring = 8e-6 - 9e-10 * np.deg2rad(100 * 1024)
    low, high = ((t - 2e-5 + spring) / 8e-7 * 30 / np.pi for t in (7e-5, 4.9e-4))
    # nearly a turn, so that cogging cancels but for the rotor's lingering where it is slow
    assert speed[120:298].mean() == pytest.approx(low, rel=0.04)
    # 16 ms are 3.7 time constants J/c_tot: 2.6 percent are left
    assert speed[332] == pytest.approx(high - 0.026 * (high - low), rel=0.02)
    assert set(np.round(trace[:, 1], 3)) == {0.139, 0.972, 0.0}
    # the other axis did not move
    assert unit.true_deg()[1 - axis] == 100.0


def test_a_torque_step_ends_at_the_limit_of_the_range():
    unit = Rig(position_deg=(363.0, 20.0))
    assert push(unit, 0, 0.5, 1.0, 10, 390) == ACCEPTED
    unit.wait()
    # a tick at 5600 rpm is 17 motor degrees; then the coils brake within two turns
    assert 364.0 < unit.true_deg()[0] < 364.0 + 2 * 360 / 1024


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({}, ACCEPTED),
        ({"n1": 391}, rig.OUT_OF_RANGE),
        ({"v1": OPEN}, ACCEPTED),
        ({"v0": OPEN, "n1": 391}, rig.OUT_OF_RANGE),
    ],
)
def test_what_a_torque_step_may_ask(change, code):
    unit = Rig()
    asked = {"v0": 0.1, "v1": 1.0, "n0": 10, "n1": 20} | change
    assert push(unit, 0, **asked) == code


def coasting(unit, axis, last):
    """Speeds (rad/s) in the ticks after a push of 40 ms, in which the voltage is `last`."""
    assert start(unit, 1) == ACCEPTED
    assert push(unit, axis, 0.97, last, 80, 40) == ACCEPTED
    log = unit.unit.run(118, axis)
    assert unit.unit.is_open(axis) == (last == OPEN)
    unit.wait()
    assert not unit.unit.is_open(axis)
    trace = read(unit, axis)
    assert (trace[80:, 1] == 0.0).all()
    return log[80:118, 7]


@pytest.mark.parametrize("axis", [0, 1])
def test_an_open_bridge_leaves_friction_and_a_shorted_one_the_back_emf_too(axis):
    """w' = -(c + spring)/J - (d/J) w with d = 0.3 and 0.8 uNm s of alpha, in closed form."""
    share = (1.0, 0.1)[axis]
    for last, drag in ((OPEN, 3e-7), (0.0, 8e-7)):
        unit = Rig(position_deg=(100.0, 100.0), noise_cnt=0.0)
        unit.unit.set_plant(axis, "back_emf", 5e-7 * share)
        unit.unit.set_plant(axis, "cogging_torque", 0.0)
        speed = coasting(unit, axis, last)
        spring = share * (8e-6 - 9e-10 * np.deg2rad(100 * 1024))
        rest, decay = (share * 2e-5 - spring) / (share * drag), drag / 3.5e-9
        assert speed[0] > 500.0
        expected = (speed[0] + rest) * np.exp(-decay * np.arange(len(speed)) * 5e-4) - rest
        before_rest = expected > 20.0
        # steps of 50 us; the spring turns by a degree of the arm
        np.testing.assert_allclose(speed[before_rest], expected[before_rest], rtol=3e-3)


def test_a_board_that_cannot_open_its_bridges_says_so():
    unit = Rig()
    unit.unit.opens = False
    unit.unit.power_up()
    unit.unit.declare_position()
    assert push(unit, 0, 0.5, OPEN, 20, 20) == rig.UNKNOWN
    assert push(unit, 1, OPEN, 0.5, 0, 20) == rig.UNKNOWN
    assert push(unit, 0, 0.5, 0.0, 20, 20) == ACCEPTED


def test_an_open_bridge_brakes_as_soon_as_it_is_stopped():
    unit = Rig(position_deg=(100.0, 100.0))
    push(unit, 0, 0.97, OPEN, 80, 100)
    unit.unit.tick(85)
    assert unit.unit.is_open(0)
    assert unit.code(15) == ACCEPTED
    assert not unit.unit.is_open(0)
    assert unit.unit.duty(0) == (0.0, 0.0, 0.0)


def test_a_torque_step_can_be_stopped_and_needs_a_datum():
    unit = Rig()
    push(unit, 0, 0.2, 0.2, 200, 200)
    unit.unit.tick(60)
    assert push(unit, 1, 0.2, 0.2, 2, 2) == rig.IN_MOTION
    assert unit.code(15) == ACCEPTED
    assert unit.wait() < 0.1
    assert push(Rig(known=False), 0, 0.2, 0.2, 2, 2) == rig.NOT_INITIALIZED
    assert unit.goto(11, 20) == ACCEPTED
    unit.wait()
    assert unit.true_deg() == pytest.approx((11, 20), abs=1e-3)


def test_pair_of_traces_has_the_zero_of_the_rotor():
    unit = Rig(position_deg=(10.0, 20.0), noise_cnt=0.0)
    for axis in (0, 1):
        zero_deg = state(unit, axis)[2] / MOTOR_DEG
        # declared where it stood: position zero is rotor angle zero of the rig
        assert np.mod(zero_deg + 180.0, 360.0) - 180.0 == pytest.approx(0.0, abs=0.1)
    assert unit.code(33, pair(10.0 + 90.0 / 1024, 20.0)) == ACCEPTED
    assert np.mod(state(unit, 0)[2] / MOTOR_DEG + 180.0, 360.0) - 180.0 == pytest.approx(90.0, abs=0.1)
