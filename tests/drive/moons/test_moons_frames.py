"""Frames and packets of MOONS' gateways: golden bytes, there and back, any bytes in any pieces."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.drive.moons.frames import (
    MoonsAnswer,
    MoonsCommand,
    MoonsError,
    MoonsFrame,
    MoonsState,
    PacketReader,
    Segment,
    UnitPlace,
    command_frame,
    decode_answer,
    decode_segment,
    packed,
    segment_data,
    unwrapped,
    wrapped,
)
from fiberloom.errors import InputError

i16 = st.integers(-(2**15), 2**15 - 1)
data_bytes = st.binary(min_size=8, max_size=8)


def test_golden_bytes():
    place = UnitPlace.of(5 * 76 + 76 + 16)  # gateway 1, bus 1, unit 16: a DLE in the identifier
    assert place == (1, 1, 16)
    data = segment_data((250, -300), Segment.FIRST | Segment.REPLY)
    frame = command_frame(place, 0x110, MoonsCommand.CONFIG_MOTION, data)
    assert frame.data.hex() == "100105fa002c8100"
    assert frame.identifier == 3 << 7 | 16
    assert packed(frame).hex() == "1002" + "01" + "90" + "01" + "1010" + "0105fa002c8100" + "1003"
    ping = command_frame(UnitPlace.of(1), 7, MoonsCommand.PING)
    assert packed(ping).hex() == "1002" + "00" + "8102" + "0707000000000000" + "1003"
    told = MoonsAnswer(7, MoonsCommand.PING, 0x2A5, MoonsState.RESTING, MoonsError.NONE, (-10000, 258))
    assert told.data().hex() == "07a75409f0d80201"
    rest = segment_data((0, 62), Segment.LAST)
    assert rest.hex() == "0200403e00"


@given(st.integers(1, 1140), st.integers(0, 255), st.integers(-16383, 16383), st.integers(-16383, 16383))
def test_commands_there_and_back(number, sequence, alpha, beta):
    place = UnitPlace.of(number)
    assert place.number == number
    frame = command_frame(
        place, sequence, MoonsCommand.CONFIG_MOTION, segment_data((alpha, beta), Segment.LAST)
    )
    (back,) = PacketReader().feed(packed(frame))
    assert back == frame
    assert (back.address, back.command) == (place.address, MoonsCommand.CONFIG_MOTION)
    assert decode_segment(back.data) == ((alpha, beta), Segment.LAST)


@given(st.sampled_from(MoonsState), st.sampled_from(MoonsError), st.integers(0, 2**11 - 1), i16, i16)
def test_answers_there_and_back(state, error, status, alpha, beta):
    told = MoonsAnswer(3, MoonsCommand.PING, status, state, error, (alpha, beta))
    assert decode_answer(MoonsFrame(0, 1 << 7 | 5, told.data())) == told


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 2047), data_bytes), max_size=5), st.randoms())
def test_packets_come_in_any_pieces(frames, random):
    sent = [MoonsFrame(*one) for one in frames]
    stream, got, reader = b"".join(map(packed, sent)), [], PacketReader()
    while stream:
        size = random.randint(1, 7)
        got += reader.feed(stream[:size])
        stream = stream[size:]
    assert got == sent


@given(st.binary(max_size=80))
def test_any_bytes_do_no_harm_to_what_follows(noise):
    good = command_frame(UnitPlace.of(3), 1, MoonsCommand.PING)
    reader = PacketReader()
    for frame in reader.feed(noise):
        with contextlib.suppress(InputError):
            decode_answer(frame)
    # the second is whole whatever came before: the first may end what the noise has begun
    assert good in reader.feed(packed(good) + packed(good))


@given(st.integers(-(10**6), 10**6), st.integers(-30000, 30000))
def test_counters_wrap(count, off):
    assert wrapped(count) == np.int64(count).astype(np.int16)
    assert unwrapped(wrapped(count), count + off) == count


@pytest.mark.parametrize("number", [0, 1141])
def test_units_that_no_gateway_has_are_refused(number):
    with pytest.raises(InputError, match="1 to 1140 fit"):
        UnitPlace.of(number)
