"""Frames by hand, there and back, and any bytes into the decoder."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.drive.desi import (
    DesiCommand,
    DesiFrame,
    TableRow,
    checksum,
    decode_row,
    encode_row,
    move_tables,
)
from fiberloom.drive.desi.frames import Motor, decode, rows_of, table_frames, tables_from
from fiberloom.errors import InputError

counts = st.integers(-(2**20) + 1, 2**20 - 1)
motors = st.builds(lambda n, c: Motor(n, c and n != 0), counts, st.booleans())
rows = st.builds(TableRow, motors, motors, st.integers(0, 65535), st.booleans())


def test_a_row_by_hand():
    # phi +10121 by creep, counter-clockwise; theta -70000 by cruise, clockwise; 300 ms; not the last
    data = encode_row(TableRow(Motor(-70000, cruise=True), Motor(10121), 300))
    # 0100 0000 | phi 101 -> 0010 1000 | theta 110; 70000 = 0x11170, 10121 = 0x2789, 300 = 0x12c
    assert data == bytes([0x40 | 0x28 | 0x06, 0x10, 0x27, 0x89, 0x11, 0x70, 0x01, 0x2C])


def test_the_last_row_by_hand():
    data = encode_row(TableRow(Motor(1), Motor(-(2**20) + 1, cruise=True), 65535, last=True))
    assert data == bytes([0x80 | 0x30 | 0x05, 0x0F, 0xFF, 0xFF, 0x00, 0x01, 0xFF, 0xFF])


def test_the_checksum_by_hand():
    first, last = bytes([0x6E, 0x10, 0x27, 0x89, 0x11, 0x70, 0x01, 0x2C]), bytes([0xA8, 0, 0, 5, 0, 0, 0, 0])
    want = (0x6E + 65536 * 0x10 + 0x2789 + 0x1170 + 0x012C + 26) + (0xA8 + 5 + 26)
    assert checksum([first, last]) == want == 1063796


def test_an_identifier_by_hand():
    assert DesiFrame.of(4321, DesiCommand.RUN, b"\x01").identifier == 4321 * 256 + 27
    assert decode(20001 * 256 + 27, b"\x01") == (20001, DesiCommand.RUN, b"\x01")


@given(rows)
def test_rows_come_back(row):
    assert decode_row(encode_row(row)) == row


@given(st.binary(max_size=12))
def test_any_bytes_are_a_row_or_refused(data):
    with contextlib.suppress(InputError):
        assert encode_row(decode_row(data)) == data


@given(st.integers(-5, 2**30), st.binary(max_size=8))
def test_any_frame_is_a_command_or_refused(identifier, data):
    with contextlib.suppress(InputError):
        can_id, command, same = decode(identifier, data)
        assert DesiFrame.of(can_id, command, same) == (identifier, data)


def test_tables_come_back_through_their_rows():
    table = move_tables([[100.0, -0.5], [0.0, 0.0], [-7.0, 90.0]], pause_ms=3)
    back = tables_from([rows_of(table, unit) for unit in range(3)])
    assert (back.steps == table.steps).all()
    assert (back.cruise == table.cruise).all()
    assert (back.pause_ms == table.pause_ms).all()


def test_a_table_is_cleared_loaded_and_asked_for():
    frames = table_frames(12, rows_of(move_tables([[1.0, 1.0]]), 0))
    assert [f.command for f in frames] == [70, 26, 26, 26, 28]
    assert [f.data[0] >> 6 for f in frames[1:4]] == [1, 1, 2]
    assert all(f.can_id == 12 for f in frames)


@pytest.mark.parametrize(
    "bad", ["c000000000000000", "0000000000000000", "6000000000000000", "4000000100000000"]
)
def test_contradicting_rows_are_refused(bad):
    with pytest.raises(InputError, match="row"):
        decode_row(bytes.fromhex(bad))


def test_what_does_not_fit_is_refused():
    with pytest.raises(InputError, match="at most"):
        encode_row(TableRow(Motor(2**20), Motor(0)))
    with pytest.raises(InputError, match="pause"):
        encode_row(TableRow(Motor(0), Motor(0), 70000))
    with pytest.raises(InputError, match="CAN id"):
        DesiFrame.of(2**21, DesiCommand.RUN)
    with pytest.raises(InputError, match="8 fit"):
        DesiFrame.of(1, DesiCommand.RUN, bytes(9))
