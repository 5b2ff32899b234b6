"""Radio packets of LAMOST: messages to a unit, behind one of its coordinators.

[A] All of it is our own: the units hear 802.15.4 (ZigBee), and no more is public. The messages are those of
`fiberloom.drive.megara.frames`.

    length of what follows, coordinator, identifier u16 (unit x 4 + motor), message, checksum

Big-endian; the checksum makes the sum of all bytes 0, mod 256.
"""

from __future__ import annotations

from typing import NamedTuple

from fiberloom.errors import InputError

LEAST_BYTES, MOST_BYTES = 6, 13
UNITS_PER_COORDINATOR = 200
"""[A] Units by their number."""


class RadioPacket(NamedTuple):
    """One packet."""

    coordinator: int
    identifier: int
    message: bytes


def coordinator_of(unit: int) -> int:
    """Of a unit by its number, from 1; 0: all."""
    return 0 if unit == 0 else 1 + (unit - 1) // UNITS_PER_COORDINATOR


def encoded(packet: RadioPacket) -> bytes:
    """The bytes of a packet; InputError for one that does not fit."""
    fits = 0 <= packet.coordinator < 2**8 and 0 <= packet.identifier < 2**16 and 1 <= len(packet.message) <= 8
    if not fits:
        raise InputError(
            f"lamost: coordinator {packet.coordinator}, identifier {packet.identifier}, "
            f"{len(packet.message)} bytes: 8 and 16 bits, 1 to 8 bytes fit"
        )
    body = bytes([packet.coordinator]) + packet.identifier.to_bytes(2, "big") + packet.message
    whole = bytes([len(body) + 1]) + body
    return whole + bytes([-sum(whole) & 0xFF])


def decoded(data: bytes) -> RadioPacket:
    """The packet of its bytes; InputError where length or checksum are wrong."""
    if not LEAST_BYTES <= len(data) <= MOST_BYTES or data[0] != len(data) - 1:
        raise InputError(
            f"lamost: {data.hex()}: {LEAST_BYTES} to {MOST_BYTES} bytes, the first their number less 1"
        )
    if sum(data) & 0xFF:
        raise InputError(f"lamost: {data.hex()}: its checksum is wrong")
    return RadioPacket(data[1], int.from_bytes(data[2:4], "big"), data[4:-1])


class RadioReader:
    """Cuts a stream of bytes into packets; what is no packet is passed over, byte by byte."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Packets that are whole by now."""
        rest, found = self._rest + data, []
        while rest:
            size = rest[0] + 1
            if not LEAST_BYTES <= size <= MOST_BYTES:
                rest = rest[1:]
            elif len(rest) < size:
                break
            elif sum(rest[:size]) & 0xFF:
                rest = rest[1:]
            else:
                found.append(rest[:size])
                rest = rest[size:]
        self._rest = rest
        return found
