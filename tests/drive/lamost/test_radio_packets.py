"""LAMOST's packets: there and back, any bytes, and what contradicts itself."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.blocking import finish
from fiberloom.drive.lamost import RadioPacket, TcpRadio, decoded, encoded
from fiberloom.errors import InputError


@given(st.integers(0, 255), st.integers(0, 2**16 - 1), st.binary(min_size=1, max_size=8))
def test_there_and_back(coordinator, identifier, message):
    packet = RadioPacket(coordinator, identifier, message)
    assert decoded(encoded(packet)) == packet


@given(st.binary(max_size=20))
def test_any_bytes_are_read_or_refused(data):
    with contextlib.suppress(InputError):
        decoded(data)


@given(st.binary(min_size=1, max_size=8), st.integers(0, 100), st.integers(1, 255))
def test_a_wrong_byte_is_found(message, where, by):
    data = bytearray(encoded(RadioPacket(1, 5, message)))
    data[where % len(data)] = (data[where % len(data)] + by) % 256
    with pytest.raises(InputError):
        decoded(bytes(data))


@pytest.mark.parametrize(
    "packet", [RadioPacket(256, 1, b"1"), RadioPacket(1, 2**16, b"1"), RadioPacket(1, 1, b"")]
)
def test_what_does_not_fit_is_refused(packet):
    with pytest.raises(InputError, match="lamost: coordinator"):
        encoded(packet)


@pytest.mark.parametrize("host", ["a..b", 70 * "x"])
def test_a_name_that_can_be_no_host_is_refused_in_words(host):
    with pytest.raises(InputError, match="no connection"):
        finish(TcpRadio(host).open())
