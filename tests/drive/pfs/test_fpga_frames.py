"""The FPGA's protocol: bytes counted by hand, round trips, and a decoder that nothing upsets."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom.drive.pfs.frames import (
    CAL_ARM,
    RUN_ARM,
    SETFREQ_ARM,
    Admin,
    Arm,
    BoardReply,
    BoardState,
    Calibrate,
    Code,
    CommandReader,
    Diagnose,
    Housekeeping,
    Power,
    RefusedCommand,
    RunCommand,
    SetFrequency,
    arm_flags,
    checksum,
    decode,
    diag_reply,
    encode,
)
from fiberloom.drive.pfs.numbering import COBRAS, cobras_at, plugs_of, sector_of
from fiberloom.errors import InputError


def run_arms(*rows):
    return np.array(list(rows), dtype=RUN_ARM)


def test_a_run_by_hand():
    """Cobra 1: board 1, plug 1. Sum of all bytes 673, so the checksum is 0x10000 - 673 = 0xfd5f."""
    flags = int(arm_flags(1, 1, Arm.THETA_CCW | Arm.THETA_ON | Arm.PHI_ON))
    arms = run_arms((flags, 44, 100, 0, 22, 50, 100))
    data = encode(RunCommand(arms, timeout_ms=5000, interleave_us=156, count=7))
    assert data.hex(" ") == "01 07 00 01 13 88 00 9c fd 5f 08 1d 00 2c 00 64 00 00 00 16 00 32 00 64"


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (Power(on=0x3F, reset=0x01, count=2), "05 02 3f 01 00 64 ff 55"),
        (Housekeeping(board=84, timeout_ms=2000, count=1), "04 01 00 54 07 d0 fe d0"),
        (Diagnose(count=3), "06 03 00 64 ff 93"),
        (Admin(debug_level=2, count=255), "07 ff 02 00 00 64 fe 94"),
    ],
)
def test_short_commands_by_hand(command, expected):
    data = encode(command)
    assert data.hex(" ") == expected
    assert decode(data) == command


def test_records_of_setfreq_and_cal_by_hand():
    """A theta motor of 62.5 kHz: 16000 / 62.5 = 256 = 0x0100; a phi motor of 100 kHz: 160 = 0x00a0."""
    flags = int(arm_flags(2, 3, 3))  # 3 << 11 | 2 << 4 | 3 = 0x1823
    data = encode(SetFrequency(np.array([(flags, 256, 160)], dtype=SETFREQ_ARM), 100, 0))
    assert data[8:].hex(" ") == "18 23 01 00 00 a0"
    data = encode(Calibrate(np.array([(flags, 230, 280, 140, 190)], dtype=CAL_ARM), 100, 0))
    assert data[8:].hex(" ") == "18 23 00 e6 01 18 00 8c 00 be"


words = st.integers(1, 0xFFFF)


@given(
    count=st.integers(0, 255), timeout_ms=st.integers(0, 0xFFFF), interleave_us=words,
    ids=st.lists(st.integers(1, COBRAS), min_size=1, max_size=20),
    low=st.integers(0, 15), seed=st.integers(0, 999),
)  # fmt: skip
def test_runs_come_back_as_they_were(count, timeout_ms, interleave_us, ids, low, seed):
    rng, arms = np.random.default_rng(seed), np.zeros(len(ids), dtype=RUN_ARM)
    arms["flags"] = arm_flags(*plugs_of(ids), low)
    for name in RUN_ARM.names[1:]:
        arms[name] = rng.integers(1, 1000, len(ids))
    data = encode(RunCommand(arms, timeout_ms, interleave_us, count))
    assert sum(data) - sum(data[8:10]) + int.from_bytes(data[8:10], "big") & 0xFFFF == 0
    found = decode(data)
    assert (found.timeout_ms, found.interleave_us, found.count) == (timeout_ms, interleave_us, count)
    np.testing.assert_array_equal(found.arms, arms)


@given(words=st.tuples(*[st.integers(0, 0xFFFF)] * 2), count=st.integers(0, 255), opcode=st.integers(0, 255))
def test_replies_come_back_as_they_were(words, count, opcode):
    reply = BoardReply(opcode, count, *words)
    assert len(reply.to_bytes()) == 6
    assert BoardReply.of(reply.to_bytes()) == reply


def test_the_state_of_a_board_comes_back():
    rng = np.random.default_rng(0)
    state = BoardState(84, (1000, 1001), 3000, *rng.integers(0, 1 << 16, (2, 29, 2)))
    data = state.to_bytes(9)
    assert len(data) == 12 + 8 * 29
    found = BoardState.of(data)
    assert found[:3] == state[:3]
    np.testing.assert_array_equal(found.periods, state.periods)
    np.testing.assert_array_equal(found.currents, state.currents)
    assert diag_reply(1, [14] * 6).hex(" ") == "06 01 0e 0e 0e 0e 0e 0e 00 00 00 00"


@given(pieces=st.lists(st.binary(max_size=60), max_size=8))
@settings(max_examples=300)
def test_any_bytes_are_a_command_a_code_or_a_wait(pieces):
    reader = CommandReader()
    for piece in pieces:
        for found in reader.feed(piece):
            if isinstance(found, RefusedCommand):
                assert found.code in Code
                assert found.code is not Code.OK
            else:
                assert decode(encode(found)) is not None
    left = reader.expire()
    assert left is None or left.code is Code.EMPTY
    assert reader.expire() is None


@given(data=st.binary(min_size=14, max_size=56), n=st.integers(0, 5), head=st.binary(min_size=4, max_size=4))
@settings(max_examples=300)
def test_runs_of_any_content_get_the_code_of_what_is_wrong(data, n, head):
    whole = bytes([1, 0, 0, n]) + head
    whole += checksum(whole + data[: 14 * n]).to_bytes(2, "big") + data
    for found in CommandReader().feed(whole):
        if isinstance(found, RunCommand):
            board, plug = found.arms["flags"] >> 4 & 0x7F, found.arms["flags"] >> 11
            assert np.all((plug >= 1) & (plug <= 29))
            # an even board has 28 cobras
            assert np.all((cobras_at(board, plug) > 0) | ((plug == 29) & (board % 2 == 0)))


def code_of(data):
    (found,) = CommandReader().feed(data)
    return found.code if isinstance(found, RefusedCommand) else Code.OK


def one_arm(board=1, cobra=1, theta_us=44, interleave_us=156):
    flags = int(arm_flags(board, cobra, Arm.THETA_ON | Arm.PHI_ON))
    return encode(RunCommand(run_arms((flags, theta_us, 10, 0, 22, 10, 0)), 100, interleave_us))


def test_each_fault_has_its_code():
    good = one_arm()
    assert code_of(good) is Code.OK
    assert code_of(good[:-1] + bytes([good[-1] ^ 1])) is Code.CHECKSUM
    assert code_of(one_arm(cobra=30)) is Code.COBRA
    assert code_of(one_arm(cobra=0)) is Code.COBRA
    assert code_of(one_arm(board=85)) is Code.BOARD
    assert code_of(one_arm(board=0)) is Code.BOARD
    assert code_of(one_arm(theta_us=0)) is Code.RUN_TIME
    assert code_of(one_arm(theta_us=1001)) is Code.RUN_TIME
    assert code_of(one_arm(interleave_us=0)) is Code.INTERLEAVE
    assert code_of(encode(RunCommand())) is Code.EMPTY
    many = np.repeat(run_arms((int(arm_flags(1, 1, 12)), 44, 1, 0, 22, 1, 0)), COBRAS + 1)
    assert code_of(encode(RunCommand(many))) is Code.TOO_MANY
    still = np.array([(int(arm_flags(1, 1, 3)), 0, 160)], dtype=SETFREQ_ARM)
    assert code_of(encode(SetFrequency(still))) is Code.FREQUENCY
    assert code_of(encode(Housekeeping(85))) is Code.BOARD


def test_commands_in_pieces_and_in_a_row():
    data = encode(Diagnose(1)) + one_arm() + encode(Diagnose(2))
    reader, found = CommandReader(), []
    for k in range(0, len(data), 3):
        found += list(reader.feed(data[k : k + 3]))
    assert [type(f) for f in found] == [Diagnose, RunCommand, Diagnose]


def test_a_field_that_does_not_fit_is_an_input_error():
    with pytest.raises(InputError, match="8 or 16 bits"):
        encode(RunCommand(timeout_ms=70_000))


def test_plugs_of_cobras():
    assert plugs_of([1, 2, 3, 57, 58, 59, 2394]) == (
        pytest.approx([1, 2, 1, 1, 3, 4, 83]),
        pytest.approx([1, 1, 2, 29, 1, 1, 29]),
    )
    ids = np.arange(1, COBRAS + 1)
    plugs = plugs_of(ids)
    np.testing.assert_array_equal(cobras_at(*plugs), ids)
    assert len(set(zip(*plugs, strict=True))) == COBRAS
    assert cobras_at(2, 29) == 0
    assert np.bincount(sector_of(plugs.board)).tolist() == [399] * 6
    with pytest.raises(InputError, match="cobra 2395"):
        plugs_of([5, 2395])
