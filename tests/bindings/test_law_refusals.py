"""Laws and plant of the compiled module: arrays of another shape are refused, edges are as documented."""

import numpy as np
import pytest
from units_of import gear_of, nominal, plain

from fiberloom._core import firmware, twin

PARAMS = np.array([row[4] for row in firmware.AXIS_PARAMS], dtype=np.float32)
I32 = np.int32


def zeros(*shape, dtype=np.float64):
    return np.zeros(shape, dtype=dtype)


def plant():
    return twin.Plant(plain(nominal()), plain(gear_of()), np.zeros(1))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: firmware.params_fault(PARAMS[:-1]), "one float32 for every line of AXIS_PARAMS"),
        (lambda: firmware.hall_angle(PARAMS, zeros(4, 3, dtype=np.uint16)), r"adc_cnt: \(n, 2\)"),
        (lambda: firmware.hall_fit(zeros(4, 3, dtype=np.uint16)), r"adc_cnt: \(n, 2\)"),
        (lambda: firmware.friction_fit(zeros(4, 2)), r"rows: \(n, 3\)"),
        (lambda: firmware.servo(PARAMS, zeros(4, 3)), r"rows: \(n, 4\)"),
        (
            lambda: firmware.commutate(zeros(2, dtype=np.float32), zeros(2, 3, dtype=np.float32)),
            r"rotor: \(n",
        ),
        (
            lambda: firmware.commutate(zeros(3, dtype=np.float32), zeros(2, 2, dtype=np.float32)),
            "same length",
        ),
        (lambda: firmware.profile(0, 100, 0.0, 1.0), "speed and acceleration must be positive"),
        (lambda: firmware.profile(0, 100, 1.0, -1.0), "speed and acceleration must be positive"),
        (lambda: firmware.profile(0, 100, np.nan, 1.0), "speed and acceleration must be positive"),
        (lambda: firmware.path(zeros(2, 3, dtype=I32), 0, 5), r"points: \(n, 2\)"),
        (lambda: firmware.path(np.array([[0, 10], [5, 10]], I32), 0, 5), "point 1 was not taken"),
        (lambda: firmware.supervisor(-1, 0, 0), "no such state or input"),
        (lambda: firmware.supervisor(len(firmware.STATES), 0, 0), "no such state or input"),
        (lambda: firmware.supervisor(0, -1, 0), "no such state or input"),
        (lambda: firmware.supervisor(0, len(firmware.INPUTS), 0), "no such state or input"),
        (lambda: plant().run(zeros(5, 2, 3)), r"duty: \(ticks, axes, 3\)"),
        (lambda: plant().run(zeros(5, 1, 2)), r"duty: \(ticks, axes, 3\)"),
        (lambda: plant().push(zeros(5, 2)), r"torque_fraction: \(ticks, axes\)"),
    ],
)
def test_arrays_of_another_shape_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_profile_ends_at_its_target_and_never_turns_back():
    for goal in (200_000, -200_000):
        path = firmware.profile(0, goal, 1000.0, 5e4).astype(np.int64)
        assert path[-1] == goal
        steps = np.diff(path, prepend=0) * np.sign(goal)
        assert (steps >= 0).all()
        # the same way forwards and backwards
        np.testing.assert_allclose(steps, steps[::-1], atol=2)
    assert len(firmware.profile(7, 7, 1000.0, 5e4)) == 0


def test_a_path_goes_through_its_points_and_stays_at_the_last():
    points = np.array([[0, 0], [1000, 10], [1000, 20], [400, 30]], I32)
    out, _, done = firmware.path(points, 0, 50)
    assert [out[10], out[20], out[30], out[49]] == [1000, 1000, 400, 400]
    assert done
    _, _, running = firmware.path(points, 0, 15)
    assert not running


def test_advancing_without_a_log_is_the_same_motion():
    logged, quiet = plant(), plant()
    duty = np.full((1, 1, 3), [0.9, 0.1, 0.5])
    logged.run(np.repeat(duty, 200, axis=0))
    quiet.run(duty)
    quiet.advance(199)
    np.testing.assert_array_equal(logged.state(0), quiet.state(0))


def test_a_push_turns_the_motor_its_own_way():
    for sign in (1.0, -1.0):
        log = plant().push(np.full((100, 1), 0.5 * sign))
        turned = log[-1, 0, 0] - log[0, 0, 0]
        assert sign * turned > 0.1


def test_motors_turn_with_their_outputs():
    from test_refusals import setup

    made = twin.Twin(setup())
    assert made.motors_rad().shape == made.outputs_rad().shape == (1, 2)
    ratio = made.motors_rad() / made.outputs_rad()
    np.testing.assert_allclose(ratio, 1024.0, rtol=0.01)
    assert made.bytes_per_positioner > 0
    assert made.ticks_run == made.ticks_skipped == 0
    made.run(20)
    assert made.ticks_run + made.ticks_skipped == 20
