"""The integrated rotor against its closed forms: lag at rest, whole turns lost, energy."""

import numpy as np
import pytest

from fiberloom.twin.actuators.field_open import (
    FieldMotor,
    integrate,
    keeps_up,
    lag_rad,
    locked_rad,
    rest_rad,
)

TICK_S = 1.0 / 18000.0
SUB = 4
"""Steps of integration in a tick: 14 us, against 11 ms of the rotor's period in the field."""
CREEP_RAD_S = np.deg2rad(0.1 / 2.0) / TICK_S
STEPPER = FieldMotor(
    pole_pairs=5, hold_Nm=3e-4, friction_Nm=6e-5, damping_Nms=2e-7, inertia_kg_m2=8e-9, detent_Nm=3e-5,
    detent_rad=0.7,
)  # fmt: skip


def crept(turns, motor, rest_s=0.05, speed_rad_s=CREEP_RAD_S, **other):
    """A slow field over some electrical turns, then at rest."""
    time = np.arange(0.0, abs(turns) * 2 * np.pi / speed_rad_s, TICK_S / SUB)
    field = np.sign(turns) * np.append(time * speed_rad_s, np.full(int(rest_s / TICK_S) * SUB, 0.0))
    field[len(time) :] = turns * 2 * np.pi
    start = rest_rad(motor, np.zeros(1), np.sign(turns))
    return field, integrate(motor, field[:, None], TICK_S / SUB, angle_rad=start, **other)


@pytest.mark.parametrize("turns", [1.3, -2.2])
def test_after_a_creep_the_rotor_lags_as_friction_says(turns):
    motor = FieldMotor()
    field, path = crept(turns, motor)
    want = rest_rad(motor, field[-1:], np.sign(turns))
    lag = field[-1] - path.angle_rad[-1, 0]
    assert abs(lag) <= np.arcsin(0.5) + 1e-6
    # damping and swinging at 1570 deg/s may leave it nearer to the field, never farther
    assert np.rad2deg(abs(path.angle_rad[-1, 0] - want[0])) < 2.0
    assert np.sign(lag) == np.sign(turns)
    assert path.speed_rad_s[0] == 0.0


def test_the_slower_the_field_the_nearer_the_closed_form():
    motor = FieldMotor()
    off = []
    for speed in (CREEP_RAD_S, CREEP_RAD_S / 4):
        field, path = crept(0.5, motor, speed_rad_s=speed)
        off.append(abs(path.angle_rad[-1, 0] - rest_rad(motor, field[-1:], 1.0)[0]))
    assert off[1] < 0.5 * off[0]
    assert np.rad2deg(off[1]) < 0.5


def test_a_microstepped_motor_rests_where_detent_and_friction_say():
    motor = FieldMotor(**{**STEPPER.__dict__, "detent_rad": np.array([0.0, 1.1, 2.9])})
    step_s, end = 1e-4, 0.9 * 2 * np.pi
    field = np.minimum(4.0 * np.arange(0.0, 1.6, step_s), end)[:, None].repeat(3, axis=1)
    path = integrate(motor, field, step_s, angle_rad=rest_rad(motor, np.zeros(3), 1.0))
    want = rest_rad(motor, field[-1], 1.0)
    np.testing.assert_allclose(path.angle_rad[-1], want, atol=0.02 / 5)
    full_step = np.pi / 2 / 5
    # a fifth of the torque is friction, a tenth detent
    most = (np.arcsin(0.2) + np.arcsin(0.1) + 0.05) / (np.pi / 2) * full_step
    assert np.all(np.abs(want - end / 5) < most)


def test_too_large_a_load_has_no_rest():
    motor = FieldMotor()
    assert np.isnan(lag_rad(motor, np.zeros(1), 1.0, 30e-6)).all()
    assert not keeps_up(motor, 1.0, 0.0, 30e-6)
    assert keeps_up(motor, 1.0, 0.0, 19e-6)


def spin(motor, cruise_ticks=100):
    """The published ramps with a cruise between; and a rest."""
    up = np.repeat(np.arange(1, 34), 12)
    tenths = np.concatenate([up, np.full(cruise_ticks, 33), up[::-1], np.zeros(600)])
    each = np.repeat(tenths / SUB, SUB)
    field = np.deg2rad(0.1 * np.cumsum(each))
    start = rest_rad(motor, np.zeros(1), 1.0)
    return field, integrate(motor, field[:, None], TICK_S / SUB, angle_rad=start)


def test_a_cruise_keeps_every_turn_and_a_weak_motor_loses_whole_ones():
    good = FieldMotor()
    rise = np.deg2rad(3.3) / TICK_S / (396 * TICK_S)
    assert keeps_up(good, np.deg2rad(3.3) / TICK_S, rise)
    field, path = spin(good)
    assert abs(field[-1] - path.angle_rad[-1, 0]) <= np.arcsin(0.5) + 1e-6
    weak = FieldMotor(hold_Nm=22e-6)
    assert not keeps_up(weak, np.deg2rad(3.3) / TICK_S, rise)
    field, path = spin(weak)
    behind = (field[-1] - path.angle_rad[-1, 0]) / (2 * np.pi)
    assert behind > 0.9
    assert abs(behind - np.rint(behind)) * 2 * np.pi <= np.arcsin(20 / 22) + 1e-6


@pytest.mark.parametrize("turns", [0.3, 0.7, 2.2, 5.8, -3.3])
def test_a_rotor_that_was_held_locks_to_the_nearest_turn(turns):
    motor = FieldMotor()
    start = rest_rad(motor, np.zeros(1), np.sign(turns))
    held = FieldMotor(friction_Nm=1e-3)
    field = np.linspace(0.0, turns * 2 * np.pi, 2000)[:, None]
    stuck = integrate(held, field, TICK_S / SUB, angle_rad=start)
    np.testing.assert_allclose(stuck.angle_rad[-1], start, atol=1e-9)
    # released: it swings into the field's nearest turn
    after = integrate(motor, np.full((8000, 1), field[-1]), TICK_S / SUB, angle_rad=start)
    want = locked_rad(motor, field[-1], start)
    assert abs(after.angle_rad[-1, 0] - want[0]) <= np.arcsin(0.5) + 1e-6
    lost = (field[-1, 0] - want[0]) / (2 * np.pi)
    assert lost == pytest.approx(np.rint(lost))


def test_energy_is_neither_made_nor_lost():
    def imbalance(sub):
        time = np.arange(0.0, 0.03, TICK_S / sub)
        field = np.where(time < 0.02, 400.0 * time, 8.0)[:, None]
        path = integrate(STEPPER, field, TICK_S / sub, angle_rad=np.zeros(1), load_Nm=2e-5)
        return abs(path.field_J - path.stored_J - path.lost_J)[0] / path.field_J[0]

    assert imbalance(80) < 5e-3
    # of first order in the step: where it starts and stops
    assert imbalance(80) < 0.7 * imbalance(20)
