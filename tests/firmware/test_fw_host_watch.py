"""The host watch: a trajectory slows down along its way host_timeout_ms after the last frame."""

import struct
import zlib

import numpy as np
import pytest

import rig
from fiberloom._core import firmware as fw
from fiberloom.bus.parameters import table_crc
from rig import ACCEPTED, COUNTS_PER_DEG, NAMES, TICKS_PER_S, Rig

SLOWING_S = 0.256
SMOOTHING_S = 0.016
# alpha 10 deg/s, beta 5 deg/s: beta is where alpha is by one line
WAY = ([(4.0, 50.0)], [(4.0, 40.0)])


def watched(timeout_ms, **kwargs):
    """On a trajectory of 4 s."""
    unit = Rig(host_timeout_ms=timeout_ms, noise_cnt=0.0, **kwargs)
    unit.follow(*WAY)
    return unit


def ticks(seconds):
    return round(seconds * TICKS_PER_S)


def run_commands(unit, seconds):
    """Commanded positions of both axes by tick, output degrees."""
    out = []
    for _ in range(ticks(seconds)):
        unit.unit.tick()
        out.append(unit.position_deg)
    return np.array(out)


def test_without_it_a_trajectory_runs_to_its_end():
    unit = Rig()
    unit.follow(*WAY)
    assert unit.wait() > 4.0
    assert np.allclose(unit.position_deg, (50.0, 40.0), atol=0.001)
    assert not unit.status("host_timeout")


def test_it_stops_on_the_way_both_axes_together():
    unit = watched(1000.0)
    way = run_commands(unit, 2.0)
    assert np.abs(np.diff(way[-200:], axis=0)).max() * COUNTS_PER_DEG < 50
    # (x - start) / whole way of both axes: the two stay on the one line that they were given
    share = (way - (10.0, 20.0)) / (40.0, 20.0)
    moving = slice(ticks(0.1), ticks(1.2))
    assert np.abs(share[moving, 0] - share[moving, 1]).max() < 5e-4
    # 10 deg/s for the time-out, then half of it for the time of slowing
    told_s = 1.0 + 0.5 * SLOWING_S
    assert way[-1, 0] == pytest.approx(10.0 + 10.0 * told_s, abs=0.02)
    assert way[-1, 1] == pytest.approx(20.0 + 5.0 * told_s, abs=0.02)


def test_the_command_slows_down_evenly():
    """From full speed to none at the rate of a go-to's ramp, not by leaving out ticks of the way."""
    unit = watched(1000.0)
    unit.unit.tick(ticks(0.9))
    speed = unit.unit.run(ticks(0.5), 0)[:, 2]  # 178 rad/s at the motor: 10 deg/s
    change = np.diff(speed)
    assert speed[0] == pytest.approx(np.deg2rad(10.0) * 1024, rel=0.01)
    assert abs(speed[-1]) < 0.1
    # 1 / 512 of the speed a tick, to the rounding of counts
    assert change.min() > -1.3 * speed[0] / 512
    assert change.max() < 0.1 * speed[0] / 512


def test_the_end_is_an_ordinary_rest():
    unit = watched(500.0)
    took_s = unit.wait()
    assert 0.5 + SLOWING_S < took_s < 0.5 + SLOWING_S + SMOOTHING_S + 0.15
    assert unit.status("host_timeout", "completed", "datum_alpha", "datum_beta") == (True,) * 4
    assert unit.status("collision_alpha", "collision_beta", "estimated") == (False,) * 3
    assert not unit.unsolicited
    assert np.abs(np.subtract(unit.true_deg(), unit.position_deg)).max() < 1e-4
    # nothing is loaded: a START is for others
    assert unit.code(14) == ACCEPTED
    unit.unit.tick(20)
    assert unit.status("completed")


@pytest.mark.parametrize(
    ("command", "to", "data"), [(3, 0, b""), (3, 5, b""), (32, 5, b""), (99, 5, b""), (14, 0, b"")]
)
def test_any_request_is_a_sign_of_life(command, to, data):
    unit = watched(300.0)
    for _ in range(20):
        unit.unit.tick(ticks(0.2))
        unit.unit.receive(fw.encode_identifier(to, command, 9 if to else 0), data)
    unit.wait()
    assert np.allclose(unit.position_deg, (50.0, 40.0), atol=0.001)
    assert not unit.status("host_timeout")


def test_frames_of_others_are_none():
    unit = watched(300.0)
    for _ in range(20):
        unit.unit.tick(ticks(0.1))
        unit.unit.receive(fw.encode_identifier(6, 3, 9))
        unit.unit.receive(fw.encode_identifier(5, 3, 9, 1))  # a reply
    assert unit.status("host_timeout", "completed") == (True, True)


def test_a_request_that_finds_no_room_is_a_sign_of_life():
    unit = watched(300.0)
    unit.unit.mailbox_open = False
    for _ in range(25):
        unit.unit.tick(ticks(0.2))
        unit.unit.receive(fw.encode_identifier(5, 3, 9))
    unit.unit.mailbox_open = True
    unit.unit.tick()
    assert not unit.status("host_timeout")
    assert np.allclose(unit.position_deg, (50.0, 40.0), atol=0.001)


def test_the_sync_line_is_a_sign_of_life():
    unit = Rig(host_timeout_ms=300.0)
    assert unit.load(*WAY) == ACCEPTED
    unit.unit.tick(ticks(5.0))
    unit.unit.sync()
    unit.unit.tick(ticks(0.25))
    assert unit.status("host_timeout") is False


@pytest.mark.parametrize("move", [(30, rig.pair(40.0, 45.0)), (47, b"")], ids=["go-to", "cogging"])
def test_only_trajectories_are_watched(move):
    unit = Rig(host_timeout_ms=50.0)
    unit.follow([(0.2, 10.1)], [(0.2, 20.1)])
    unit.wait()
    assert unit.code(*move) == ACCEPTED
    unit.wait()
    assert not unit.status("host_timeout")


def test_a_torque_step_drops_a_trajectory_and_is_not_watched():
    unit = Rig(host_timeout_ms=10.0)
    assert unit.load(*WAY) == ACCEPTED
    assert unit.code(245, struct.pack("<hhHH", 4000, 0, 200, 100)) == ACCEPTED
    unit.wait()
    assert not unit.status("host_timeout")


def test_the_shorter_of_both_axes_counts_and_0_is_none():
    unit = Rig(noise_cnt=0.0)
    rows = rig.params()
    for axis, ms in enumerate((0.0, 700.0)):
        rows[axis, NAMES.index("host_timeout_ms")] = ms
        assert unit.unit.set_params(axis, rows[axis])
    unit.follow(*WAY)
    unit.unit.tick(ticks(0.69))
    assert not unit.unit.status >> rig.BIT["host_timeout"] & 1
    unit.unit.tick(ticks(0.02))
    assert unit.unit.status >> rig.BIT["host_timeout"] & 1


def test_it_is_set_over_the_bus_and_kept():
    unit = Rig(noise_cnt=0.0)
    rows = rig.params(host_timeout_ms=400.0)
    assert unit.code(231, struct.pack("<I", table_crc())) == ACCEPTED
    for axis in (0, 1):
        assert unit.code(232 + axis, struct.pack("<Bf", NAMES.index("host_timeout_ms"), 400.0)) == ACCEPTED
    assert unit.code(234, struct.pack("<I", zlib.crc32(rows.tobytes()))) == ACCEPTED
    assert unit.code(53) == ACCEPTED
    unit.unit.power_up()
    unit.follow(*WAY)
    assert unit.wait() < 1.0
    assert unit.status("host_timeout")


def test_the_mark_goes_with_15_or_the_next_motion_and_stays_with_13():
    unit = watched(300.0)
    unit.wait()
    assert unit.code(13) == ACCEPTED
    assert unit.status("host_timeout")
    assert unit.code(15) == ACCEPTED
    assert not unit.status("host_timeout")
    unit = watched(300.0)
    unit.wait()
    assert unit.goto(30.0, 30.0) == ACCEPTED
    assert not unit.status("host_timeout")


def test_stop_and_collision_go_before_it():
    for event in ("stop", "collision"):
        unit = watched(500.0)
        unit.unit.tick(ticks(0.6))
        if event == "stop":
            assert unit.code(15) == ACCEPTED
            assert unit.unit.duty(0) == unit.unit.duty(1) == (0, 0, 0)
        else:
            unit.unit.set_plant(0, "blocked", 1)
        unit.wait(2.0)
        assert unit.status("collision_alpha") is (event == "collision")


def test_in_its_landing_a_trajectory_ends_as_it_would():
    """The way is over before the time is: nothing is left to be slowed down."""
    unit = Rig(host_timeout_ms=520.0, noise_cnt=0.0)
    unit.follow([(0.5, 12.0)], [(0.5, 22.0)])
    unit.wait()
    assert unit.status("host_timeout")
    assert np.allclose(unit.position_deg, (12.0, 22.0), atol=0.001)


@pytest.mark.parametrize("timeout_ms", [1.0, 300.0, 480.0, 700.0, 900.0, 1000.0])
def test_a_precise_trajectory_stops_in_each_of_its_parts(timeout_ms):
    """Follow, overshoot, come back: it comes to rest from all of them, and knows where it is."""
    unit = Rig(host_timeout_ms=timeout_ms, noise_cnt=0.0)
    assert unit.code(128) == unit.code(130) == ACCEPTED
    unit.follow([(0.5, 12.0)], [(0.5, 22.0)])
    assert unit.wait() < timeout_ms / 1000 + 1.0
    assert unit.status("host_timeout", "completed") == (True, True)
    assert np.abs(np.subtract(unit.true_deg(), unit.position_deg)).max() < 1e-4


@pytest.mark.parametrize("mode", [(118, 122), (120, 124)], ids=["closed loop", "open loop"])
def test_at_full_speed_no_watch_takes_it_for_a_collision(mode):
    """2000 rpm, with the gains of the twin's watches."""
    unit = Rig(host_timeout_ms=2000.0, contact_torque=6.5e-5, touch_torque=2.4e-6)
    for command in mode:
        assert unit.code(command) == ACCEPTED
    unit.follow([(0.5, 10.0), (6.0, 74.0)], [(0.5, 20.0), (6.0, 20.0)])
    unit.wait(4.0)
    assert not unit.unsolicited
    assert unit.status("host_timeout")
