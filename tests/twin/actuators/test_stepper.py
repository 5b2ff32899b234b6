"""Steppers: closed forms against the integrated rotor, electrical turns lost, and the datum that tells."""

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.twin.actuators.field_open import integrate, locked_rad, rest_rad
from fiberloom.twin.actuators.planetary import played
from fiberloom.twin.actuators.stepper import PM_STEPPER, DatumSwitches, GearedStepper, lost_turns

STEP_S = 2e-5
GEAR = 2050.175633
"""Of an alpha axis of MOONS."""


def driven(drive, rates_Hz, ramp_Hz2, full_steps):
    """Field at the end, and rotors: they speed up to M rates, slow down, and rest for 0.1 s."""
    rates = np.asarray(rates_Hz, dtype=float)
    up, top_s = rates / ramp_Hz2, full_steps / rates
    time = np.arange(0.0, (top_s + 2 * up).max() + STEP_S, STEP_S)[:, None]
    speed = np.clip(np.minimum(time, top_s + 2 * up - time) * ramp_Hz2, 0.0, rates)
    field = 0.5 * np.pi * np.cumsum(speed, axis=0) * STEP_S
    start = rest_rad(drive.motor, np.zeros(len(rates)), 1.0)
    run = integrate(drive.at_rate(rates), field, STEP_S, angle_rad=start)
    still = np.repeat(field[-1:], int(0.1 / STEP_S), axis=0)
    # at rest there is no back-EMF
    end = integrate(drive.motor, still, STEP_S, angle_rad=run.angle_rad[-1], speed_rad_s=run.speed_rad_s)
    return field[-1], end.angle_rad[-1]


def test_full_steps_land_where_lag_and_detent_say():
    drive = GearedStepper(gear=GEAR)
    count = np.arange(1, 9)
    out = drive.output_deg(count, 1.0)
    step = 360.0 / (20.0 * GEAR)
    lag = count * step - out
    # friction of 0.2 T_h: behind by asin(0.2 .. 0.3) of an electrical turn of four steps
    assert step == pytest.approx(0.00878, abs=1e-5)
    assert (np.arcsin(0.1) / (np.pi / 2) * step < lag).all()
    assert (lag < np.arcsin(0.3) / (np.pi / 2) * step).all()
    np.testing.assert_allclose(drive.output_deg(-count, -1.0), -out, atol=1e-12)


def test_a_load_beyond_the_field_has_no_rest():
    drive = GearedStepper(gear=GEAR)
    assert np.isnan(drive.output_deg(np.array([3]), 1.0, load_Nm=0.3e-3 * GEAR)[0])


def test_a_rotor_that_is_not_pulled_out_counts_right_and_one_that_is_loses_whole_turns():
    drive = GearedStepper(gear=GEAR)
    rates = np.array([600.0, 1500.0, 6000.0, 9000.0])
    assert drive.pulled_out(rates, 20000.0).tolist() == [False, False, True, True]
    field, rotor = driven(drive, rates, 20000.0, 400)
    turns = (field - drive.motor.pole_pairs * rotor) / (2 * np.pi)
    lost = np.rint(turns)
    # those that kept up lost nothing; the others are turns behind, and rest where friction holds them
    assert lost[:2].tolist() == [0.0, 0.0]
    assert (lost[2:] > 10).all()
    assert np.abs(np.sin(2 * np.pi * turns)).max() < 0.3
    # at 9000 steps/s friction happens to hold it where the field would turn it over
    assert np.abs(turns - lost)[:3].max() < np.arcsin(0.3) / (2 * np.pi)
    locked = locked_rad(drive.motor, field, rotor)
    np.testing.assert_allclose(locked, (field - 2 * np.pi * lost) / drive.motor.pole_pairs)


def test_back_emf_takes_torque():
    drive = GearedStepper(corner_Hz=1000.0)
    assert drive.at_rate(0.0).hold_Nm == PM_STEPPER.hold_Nm
    assert drive.at_rate(1000.0).hold_Nm == pytest.approx(PM_STEPPER.hold_Nm / np.sqrt(2.0))
    # a load that is held at rest pulls out at speed
    load = 0.15e-3 * 1000.0
    assert drive.pulled_out(np.array([1.0, 2000.0]), load_Nm=load).tolist() == [False, True]


def test_what_a_pull_out_loses_is_what_moons_would_see():
    turn = GearedStepper(gear=np.array([GEAR, 1517.662482])).turn_deg
    np.testing.assert_allclose(turn, [4 * 0.00878, 4 * 0.01186], rtol=1e-3)


@pytest.mark.parametrize("turns", [0, 1, -3])
def test_the_datum_finds_lost_turns_through_its_scatter(turns):
    drive = GearedStepper(gear=np.full(500, GEAR))
    switch = DatumSwitches(np.zeros(500), repeat_deg=0.003, hysteresis_deg=0.01)
    closed = switch.closes_deg(np.random.default_rng(3))
    assert closed.std() == pytest.approx(0.003, rel=0.1)
    # counted at the edge, by a rotor that is so many electrical turns behind
    slip = closed + turns * drive.turn_deg
    assert (lost_turns(drive, slip) == turns).all()
    np.testing.assert_allclose(switch.opens_deg(closed, -1.0) - closed, 0.01)


def test_play_leaves_the_arm_behind_after_a_turn_of_direction():
    drive = GearedStepper(gear=GEAR)
    counts = np.array([0, 1000, 900])
    rotor = np.stack([drive.output_deg(counts, np.array([1.0, 1.0, -1.0]))] * 2, axis=1)[None]
    arm = played(np.zeros((1, 2)), rotor, np.full((1, 2), 0.5))[0, :, 0]
    assert arm[1] == pytest.approx(rotor[0, 1, 0] - 0.25)
    # 100 steps back are 0.88 deg, of which 0.5 close the play
    assert arm[1] - arm[2] == pytest.approx(rotor[0, 1, 0] - rotor[0, 2, 0] - 0.5)


@pytest.mark.parametrize("wrong", [{"microsteps": 0}, {"gear": 0.0}, {"corner_Hz": -1.0}])
def test_motors_that_cannot_be_are_refused(wrong):
    with pytest.raises(InputError, match="stepper"):
        GearedStepper(**wrong)
