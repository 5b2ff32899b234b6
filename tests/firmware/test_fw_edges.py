"""Two things at once, no room for an answer, hardware that gives nothing: what seldom happens, but does."""

import struct

import numpy as np
import pytest

import rig
from fiberloom._core import firmware as fw
from rig import ACCEPTED, NAMES, Rig, pair


def with_stop(unit):
    for axis in (0, 1):
        unit.unit.set_plant(axis, "stop_rad", np.deg2rad(-4.0) * 1024)
    return unit


# -- the bootloader --------------------------------------------------------------------------------------


@pytest.mark.parametrize("moving", [False, True])
def test_the_bootloader_switches_off_and_loses_count_only_in_motion(moving):
    unit = Rig()
    if moving:
        unit.goto(60, 70)
        unit.unit.tick(1000)
        assert max(unit.unit.duty(0)) > 0
    unit.unit.enter_bootloader()
    assert unit.unit.duty(0) == unit.unit.duty(1) == (0, 0, 0)
    unit.unit.tick(10 * fw.TICK_HZ + 1)
    assert unit.unit.state == fw.STATES["IDLE"]
    assert unit.status("datum_alpha", "datum_beta") == (not moving, not moving)
    assert unit.goto(11, 21) == (rig.NOT_INITIALIZED if moving else ACCEPTED)


def test_the_bootloader_waits_ten_seconds_again_after_a_bad_image():
    unit = Rig()
    unit.unit.enter_bootloader()
    assert unit.code(200, struct.pack("<II", 3, 1)) == ACCEPTED
    unit.unit.tick(15 * fw.TICK_HZ)
    assert unit.code(201, b"abc") == rig.OUT_OF_RANGE
    unit.unit.tick(10 * fw.TICK_HZ - 1)
    assert unit.unit.state == fw.STATES["BOOTLOADER"]
    unit.unit.tick(1)
    assert unit.unit.state == fw.STATES["IDLE"]


def test_the_largest_image_is_a_megabyte():
    unit = Rig()
    unit.unit.enter_bootloader()
    assert unit.code(200, struct.pack("<II", 2**20 + 1, 0)) == rig.OUT_OF_RANGE
    assert unit.code(200, struct.pack("<II", 2**20, 0)) == ACCEPTED


# -- collisions ------------------------------------------------------------------------------------------


def block(unit, *axes):
    for axis in axes:
        unit.unit.set_plant(axis, "blocked", 1)


def test_two_collisions_at_once_are_told_once():
    unit = Rig()
    unit.goto(60, 70)
    unit.unit.tick(1200)
    block(unit, 0, 1)
    unit.wait(1)
    assert unit.unsolicited == [(18, b"")]


def fill_queue(unit):
    """A bus that takes nothing, and the 16 answers for which there is room."""
    unit.frames()
    unit.unit.mailbox_open = False
    for uid in range(20):
        unit.unit.receive(fw.encode_identifier(unit.number, 32, uid + 1))


def sent_when_open(unit):
    """Commands and uids of what leaves once the bus takes frames again."""
    unit.unit.mailbox_open = True
    unit.unit.tick()
    return [fw.decode_identifier(identifier)[1:3] for identifier, _ in unit.unit.take_frames()]


POLLS = [(32, uid + 1) for uid in range(16)]


def test_a_collision_at_a_full_queue_is_told_once_there_is_room():
    unit = Rig()
    unit.goto(60, 70)
    unit.unit.tick(1200)
    fill_queue(unit)
    block(unit, 0)
    unit.unit.tick(100)
    assert sent_when_open(unit) == [*POLLS, (18, 0)]
    unit.unit.tick(100)
    assert unit.unit.take_frames() == []
    assert unit.status("collision_alpha", "collision_beta") == (True, False)
    assert unit.unit.at_rest()


@pytest.mark.parametrize(("command", "to"), [(13, 5), (15, 5), (15, 0)])
def test_a_stop_at_a_full_queue_is_carried_out_and_answered_later(command, to):
    unit = Rig()
    unit.follow([(2.0, 30.0)], [(2.0, 40.0)])
    unit.unit.tick(1200)
    fill_queue(unit)
    before = unit.unit.position_cnt
    unit.unit.receive(fw.encode_identifier(to, command, 60))
    assert unit.unit.duty(0) == unit.unit.duty(1) == (0, 0, 0)
    unit.unit.tick(200)
    # half a turn of the motor at most
    assert max(abs(a - b) for a, b in zip(unit.unit.position_cnt, before, strict=True)) < 2**19
    assert not unit.unit.at_rest()  # the answer waits
    assert sent_when_open(unit) == [*POLLS, (command, 60)]
    assert unit.status("completed")
    assert unit.unit.at_rest()


def test_the_last_of_several_stops_at_a_full_queue_is_answered():
    unit = Rig()
    fill_queue(unit)
    for uid in (40, 41, 42):
        unit.unit.receive(fw.encode_identifier(unit.number, 13, uid))
    assert sent_when_open(unit) == [*POLLS, (13, 42)]


def test_a_collision_and_a_stop_both_outlive_a_full_queue():
    unit = Rig()
    unit.goto(60, 70)
    unit.unit.tick(1200)
    fill_queue(unit)
    block(unit, 1)
    unit.unit.tick(100)
    unit.unit.receive(fw.encode_identifier(unit.number, 15, 50))
    assert sent_when_open(unit) == [*POLLS, (18, 0), (15, 50)]
    assert unit.status("collision_beta") is False


def test_a_stop_of_wrong_length_at_a_full_queue_is_refused():
    unit = Rig()
    unit.goto(60, 70)
    unit.unit.tick(1200)
    fill_queue(unit)
    unit.unit.receive(fw.encode_identifier(unit.number, 13, 50), b"1")
    assert unit.unit.duty(0) != (0, 0, 0)
    assert sent_when_open(unit) == [*POLLS, (13, 50)]


def test_a_collision_waits_for_the_mailbox():
    unit = Rig()
    unit.goto(60, 70)
    unit.unit.tick(1200)
    unit.unit.mailbox_open = False
    block(unit, 1)
    unit.unit.tick(100)
    assert not unit.unsolicited
    unit.unit.mailbox_open = True
    unit.unit.tick()
    assert unit.unsolicited == [(18, b"")]


@pytest.mark.parametrize("closed", [True, False])
def test_in_open_loop_without_detection_a_magnet_may_lose_the_field(closed):
    unit = Rig()
    assert unit.code(119 if closed else 121) == ACCEPTED
    unit.goto(12, 20)
    unit.unit.tick(200)
    block(unit, 0)
    unit.wait()
    assert not unit.unsolicited
    assert unit.status("collision_alpha") is False


# -- legs that do not follow the settings of the axis ------------------------------------------------------


@pytest.mark.parametrize("mode", [118, 119, 120, 121])
def test_the_datum_search_stops_at_the_stop_in_every_mode(mode):
    unit = with_stop(Rig(position_deg=(-1.0, 20.0)))
    assert unit.code(mode) == ACCEPTED
    assert unit.code(21) == ACCEPTED
    unit.wait()
    assert not unit.unsolicited
    assert unit.status("datum_alpha")
    assert unit.true_deg()[0] == pytest.approx(0, abs=0.1)  # open loop: to the pole, a third of a turn


@pytest.mark.parametrize("mode", [118, 121])
def test_cogging_is_measured_in_closed_loop_in_every_mode(mode):
    unit = Rig()
    assert unit.code(mode) == ACCEPTED
    assert unit.code(48) == ACCEPTED
    unit.wait()
    assert unit.status("cogging_alpha")
    found = unit.unit.params(0)[NAMES.index("coulomb")]
    assert found == pytest.approx(2e-5, rel=0.05)


@pytest.mark.parametrize("mode", [118, 121])
def test_a_held_rotor_ends_no_hall_calibration(mode):
    """The field turns whatever the sensors say; then there is no ellipse, and nothing is changed."""
    unit = Rig(noise_cnt=0.0)
    before = unit.unit.params(0)
    assert unit.code(mode) == ACCEPTED
    block(unit, 0)
    assert unit.code(27) == ACCEPTED
    unit.wait()
    assert not unit.unsolicited
    assert (unit.unit.params(0) == before).all()
    assert not unit.status("config_changed")


# -- hardware that gives nothing ---------------------------------------------------------------------------


def test_storage_that_is_too_small_is_as_none():
    unit = Rig()
    unit.unit.storage = bytes(100)
    assert unit.code(53) == rig.INVALID
    unit.unit.power_up()
    assert unit.status("restored", "estimated", "saved", "datum_alpha") == (False,) * 4


def test_the_second_copy_is_read_where_the_first_was_never_written():
    unit = Rig()
    assert unit.code(140, struct.pack("<I", 3)) == unit.code(53) == ACCEPTED
    assert unit.code(140, struct.pack("<I", 4)) == unit.code(53) == ACCEPTED
    storage = bytearray(unit.unit.storage)
    for copy, kept in ((0, 4), (1, 3)):
        broken = bytearray(storage)
        broken[copy * 768 + 8] ^= 1
        unit.unit.storage = bytes(broken)
        unit.unit.power_up()
        assert struct.unpack("<I", unit.ask(139)[1])[0] == kept


# -- the bus ---------------------------------------------------------------------------------------------


def test_what_is_no_request_is_not_answered():
    unit = Rig()
    own = fw.encode_identifier(unit.number, 1, 1)
    for identifier in (own | 1 << 29, own | 1, fw.encode_identifier(unit.number + 1, 1, 1)):
        unit.unit.receive(identifier)
        assert unit.frames() == []
    unit.unit.receive(own)
    assert len(unit.frames()) == 1


def test_a_position_outside_32_bits_is_out_of_range_and_does_not_wrap():
    unit = Rig()
    for way in (2**31 - 1, -(2**31)):
        assert unit.code(31, struct.pack("<ii", way, 0)) == rig.OUT_OF_RANGE
        assert unit.code(31, struct.pack("<ii", 0, way)) == rig.OUT_OF_RANGE
    assert unit.code(31, pair(1.0, 1.0)) == ACCEPTED


def test_a_sync_without_a_trajectory_or_with_a_bad_one_moves_nothing():
    unit = Rig()
    unit.unit.sync()
    assert unit.unit.state == fw.STATES["IDLE"]
    unit.load([(0.1, 10)], [(0.1, 20)])
    # a stop in between: what was loaded is forgotten
    unit.code(13)
    unit.unit.sync()
    unit.unit.tick(10)
    assert unit.unit.state == fw.STATES["IDLE"]
    # far away by the time of the start: refused
    assert unit.load([(0.001, 10)], [(0.001, 20)]) == ACCEPTED
    unit.place((80.0, 20.0))
    unit.unit.declare_position()
    unit.unit.sync()
    assert unit.unit.state == fw.STATES["LOADED"]
    assert unit.frames() == []


# -- parameters ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"speed_default": 3000, "speed_max": 2999}, "speed_default"),
        ({"position_min": 10, "position_max": 10}, "position_max"),
        ({"collision_torque": 1.5e-5, "integral_limit": 1.5e-5}, "collision_torque"),
        ({"k_p": np.nan}, "k_p"),
        ({"inertia": 0}, "inertia"),
    ],
)
def test_parameters_that_contradict_each_other_are_named(changes, fault):
    assert NAMES[fw.params_fault(rig.alpha_params(**changes))] == fault


@pytest.mark.parametrize("axis", [0, 1])
def test_an_axis_with_bad_parameters_keeps_both_from_moving(axis):
    unit = Rig()
    good = unit.unit.params(axis)
    bad = good.copy()
    bad[NAMES.index("speed_default")] = 9000
    assert unit.unit.set_params(axis, bad)
    assert unit.goto(11, 21) == rig.INVALID
    assert unit.unit.set_params(axis, good)
    assert unit.goto(11, 21) == ACCEPTED
    unit.unit.tick(10)
    assert not unit.unit.set_params(axis, bad)
