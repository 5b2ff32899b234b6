"""The identifier and the command table."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.bus import Command, Response, Status
from fiberloom.bus.identifier import decode, encode
from fiberloom.bus.protocol import COMMANDS, CommandFlag, counts_of_deg, goto_duration_s
from fiberloom.errors import InputError
from fiberloom.units import COUNTS_PER_DEG, COUNTS_PER_TURN


@given(st.integers(0, 2047), st.integers(0, 255), st.integers(0, 63), st.integers(0, 15))
def test_an_identifier_returns_what_was_packed(positioner, command, uid, code):
    packed = encode(positioner, command, uid, code)
    assert packed < 1 << 29
    assert decode(packed) == (positioner, command, uid, code)


@given(st.integers(0, (1 << 29) - 1))
def test_every_identifier_is_the_packing_of_its_fields(identifier):
    assert encode(*decode(identifier)) == identifier


def test_the_golden_identifier_of_get_status():
    # as recorded from the SDSS-V client: positioner 1, GET_STATUS, uid 1
    assert encode(1, Command.GET_STATUS, 1) == 0x00040C10
    assert encode(0, Command.GET_ID) == 0x00000400
    assert encode(1234, Command.COLLISION_DETECTED, 0, 0) == 0x13484800


@pytest.mark.parametrize(
    "fields", [(2048, 0, 0, 0), (0, 256, 0, 0), (0, 0, 64, 0), (0, 0, 0, 16), (-1, 0, 0, 0)]
)
def test_a_field_that_does_not_fit_is_named(fields):
    with pytest.raises(ValueError, match="does not fit in the identifier"):
        encode(*fields)


def test_every_command_has_exactly_one_row():
    assert set(COMMANDS) == set(Command)


def test_broadcast_and_safe_flags_are_those_of_the_protocol():
    broadcast = {c.value for c, s in COMMANDS.items() if s.flags & CommandFlag.BROADCAST}
    assert broadcast == {1, 2, 3, 14, 15}
    moves = {c.value for c, s in COMMANDS.items() if s.flags & CommandFlag.MOVE}
    assert {10, 11, 12, 14, 20, 30, 31, 33, 41} <= moves
    assert moves.isdisjoint({13, 15, 3, 32, 40})
    again = {c.value for c, s in COMMANDS.items() if s.flags & CommandFlag.REPEATABLE}
    assert again.isdisjoint({10, 11, 12, 14, 20, 23, 26, 30, 31, 47, 200, 201})


def test_golden_payloads():
    assert COMMANDS[Command.GO_TO_ABSOLUTE_POSITION].pack(1, -1).hex() == "01000000ffffffff"
    assert COMMANDS[Command.SET_SPEED].pack(2000, 2000).hex() == "d0070000d0070000"
    status = bytes.fromhex("0101000c00000000")
    (word,) = COMMANDS[Command.GET_STATUS].unpack(status)
    assert Status(word) == (
        Status.SYSTEM_INITIALIZED | Status.DISPLACEMENT_COMPLETED | Status.DATUMS_INITIALIZED
    )


def test_a_reply_that_is_too_short_is_none():
    assert COMMANDS[Command.GET_STATUS].unpack(b"\x01\x00\x00\x00") is None


def test_a_value_that_does_not_fit_its_payload_names_the_command():
    with pytest.raises(InputError, match="SET_SPEED"):
        COMMANDS[Command.SET_SPEED].pack(-1, 0)


@given(st.floats(-719.9, 719.9))
def test_counts_are_the_nearest(angle_deg):
    counts = counts_of_deg(angle_deg)
    assert abs(counts - angle_deg * COUNTS_PER_DEG) <= 0.5


@pytest.mark.parametrize("angle_deg", [720.0, -721.0, 1e12, float("nan"), float("inf")])
def test_angles_beyond_the_wire_are_refused(angle_deg):
    with pytest.raises(InputError, match="does not fit on the wire"):
        counts_of_deg(angle_deg)


def test_one_turn_is_two_to_the_thirty():
    assert counts_of_deg(360.0) == COUNTS_PER_TURN == 1_073_741_824


def test_status_bits_have_the_places_of_firmware_4_1():
    assert Status.DISPLACEMENT_COMPLETED == 0x100
    assert Status.COLLISION == 0x1800
    assert Status.DATUMS_INITIALIZED == 0xC000000
    assert Status.COGGING_BETA_CALIBRATED == 0x1_0000_0000
    assert Status.UNKNOWN == 0x100_0000_0000
    assert [r.value for r in Response] == list(range(16))


def test_the_duration_of_a_goto_is_that_of_the_gear():
    # 2000 rpm at the motor are 11.72 deg/s at the arm
    assert goto_duration_s(117.1875, 2000.0) == pytest.approx(10.25)
