"""Frames of MOONS' gateways: packets on TCP, CAN frames of 8 bytes in them (ukatc/fpu_driver, protocol 2).

    packet   DLE STX  bus, identifier low, high, 8 data bytes  DLE ETX;  a DLE inside is doubled
    command  sequence, command (5 bits), data of 6 bytes
    answer   sequence, command | status << 5, status >> 3, state | error << 4, alpha i16, beta i16

The identifier has 11 bits: priority << 7 | address of the unit. Numbers are little-endian. Counters begin at
-10000 for alpha and wrap.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum, IntFlag
from typing import NamedTuple

from fiberloom.errors import InputError

DLE, STX, ETX = 0x10, 0x02, 0x03
BODY_BYTES, DATA_BYTES = 11, 8
GATEWAYS, BUSES, UNITS_PER_BUS = 3, 5, 76
ALPHA_START = -10_000
"""What alpha's counter shows at the datum."""
BROADCAST = 0
"""Address of all units of a bus."""
PAUSE, CLOCKWISE, STEPS_HIGH = 0x40, 0x80, 0x3F


class MoonsCommand(IntEnum):
    """Commands, and what units say unasked."""

    CONFIG_MOTION = 1
    EXECUTE = 2
    ABORT = 3
    PING = 7
    RESET = 8
    FIND_DATUM = 9
    REPEAT = 11
    REVERSE = 12
    PROTECT_BETA = 13
    FREE_BETA = 14
    COUNTER_DEVIATION = 16
    FREE_ALPHA = 18
    PROTECT_ALPHA = 19
    ENABLE_MOVE = 22
    SERIAL_NUMBER = 23
    MOTION_FINISHED = 25
    DATUM_FINISHED = 26
    BETA_COLLISION = 27
    ALPHA_LIMIT = 28
    DATUM_TIMEOUT = 29
    OVERFLOW = 30


PRIORITIES = {
    MoonsCommand.ABORT: 2,
    MoonsCommand.EXECUTE: 2,
    MoonsCommand.FIND_DATUM: 2,
    MoonsCommand.PING: 5,
}
USUAL_PRIORITY, ANSWER_PRIORITY = 3, 1


class MoonsState(IntEnum):
    """Of a unit."""

    UNINITIALISED = 1
    DATUM_SEARCH = 3
    AT_DATUM = 4
    LOADING = 5
    READY_FORWARD = 6
    READY_REVERSE = 7
    MOVING = 8
    RESTING = 9
    ABORTED = 10
    OBSTACLE = 11


class MoonsError(IntEnum):
    """[A] Why a unit has refused; the numbers are our own."""

    NONE = 0
    INVALID = 1
    NOT_READY = 2
    WAVEFORM = 3
    NO_DATUM = 4
    COLLISION = 5
    LIMIT = 6


class Segment(IntFlag):
    """Flags of CONFIG_MOTION."""

    FIRST = 1
    LAST = 2
    REPLY = 4


class MoonsFrame(NamedTuple):
    """One CAN frame behind a gateway."""

    bus: int
    identifier: int
    data: bytes

    @property
    def address(self) -> int:
        """Of the unit on its bus, from 1; 0: all."""
        return self.identifier & 0x7F

    @property
    def command(self) -> MoonsCommand:
        """InputError for one that is not known."""
        number = self.data[1] & 0x1F
        if number not in MoonsCommand.__members__.values():
            raise InputError(f"moons: bus {self.bus}, unit {self.address}: command {number} is not known")
        return MoonsCommand(number)


class UnitPlace(NamedTuple):
    """Where a unit hangs."""

    gateway: int
    bus: int
    address: int
    """From 1."""

    @classmethod
    def of(cls, number: int) -> UnitPlace:
        """Of a unit by its number from 1; InputError beyond what the gateways have."""
        if not 1 <= number <= GATEWAYS * BUSES * UNITS_PER_BUS:
            raise InputError(f"moons: unit {number}; 1 to {GATEWAYS * BUSES * UNITS_PER_BUS} fit")
        line, unit = divmod(number - 1, UNITS_PER_BUS)
        return cls(*divmod(line, BUSES), unit + 1)

    @property
    def number(self) -> int:
        """Of the unit."""
        return (self.gateway * BUSES + self.bus) * UNITS_PER_BUS + self.address


class MoonsAnswer(NamedTuple):
    """What a unit says."""

    sequence: int
    command: MoonsCommand
    status: int
    """11 bits."""
    state: MoonsState
    error: MoonsError
    counters: tuple[int, int]
    """Of alpha and beta, i16."""

    def data(self) -> bytes:
        """The 8 bytes."""
        first = bytes([self.sequence & 0xFF, self.command | (self.status & 7) << 5, self.status >> 3 & 0xFF])
        last = b"".join(wrapped(one).to_bytes(2, "little", signed=True) for one in self.counters)
        return first + bytes([self.state | self.error << 4]) + last


def command_frame(place: UnitPlace, sequence: int, command: MoonsCommand, data: bytes = b"") -> MoonsFrame:
    """A `command` to the unit at a `place`, with a `sequence` number and at most 6 bytes of `data`."""
    if len(data) > DATA_BYTES - 2:
        raise InputError(f"moons: {command.name}: {len(data)} bytes; at most {DATA_BYTES - 2} fit")
    body = bytes([sequence & 0xFF, command]) + data
    priority = PRIORITIES.get(command, USUAL_PRIORITY)
    return MoonsFrame(place.bus, priority << 7 | place.address, body.ljust(DATA_BYTES, b"\0"))


def segment_data(steps: tuple[int, int], flags: Segment) -> bytes:
    """Data of CONFIG_MOTION: signed `steps` of alpha and beta in a segment, and its `flags`."""
    out = [int(flags)]
    for one in steps:
        size = abs(one)
        if size >= 1 << 14:
            raise InputError(f"moons: {one} steps in a segment; 14 bits fit")
        high = size >> 8 | (CLOCKWISE if one < 0 else 0) | (PAUSE if size == 0 else 0)
        out += [size & 0xFF, high]
    return bytes(out)


def decode_segment(data: bytes) -> tuple[tuple[int, int], Segment]:
    """Signed steps and flags of the data (8 bytes) of a CONFIG_MOTION."""
    steps = []
    for low, high in ((data[3], data[4]), (data[5], data[6])):
        size = 0 if high & PAUSE else low | (high & STEPS_HIGH) << 8
        steps.append(-size if high & CLOCKWISE else size)
    return (steps[0], steps[1]), Segment(data[2] & 7)


def decode_answer(frame: MoonsFrame) -> MoonsAnswer:
    """What a unit has said; InputError where that is no answer."""
    data, command = frame.data, frame.command
    state, error = data[3] & 0xF, data[3] >> 4
    known = state in MoonsState.__members__.values() and error in MoonsError.__members__.values()
    if not known:
        raise InputError(
            f"moons: bus {frame.bus}, unit {frame.address}: state {state}, error {error} not known"
        )
    alpha, beta = (int.from_bytes(data[k : k + 2], "little", signed=True) for k in (4, 6))
    status = data[1] >> 5 | data[2] << 3
    return MoonsAnswer(data[0], command, status, MoonsState(state), MoonsError(error), (alpha, beta))


def wrapped(count: int) -> int:
    """A count as a counter of 16 bits shows it."""
    return (count + 2**15) % 2**16 - 2**15


def unwrapped(shown: int, near: int) -> int:
    """The count that a counter shows, nearest to one that is expected."""
    return near + wrapped(shown - near)


def packed(frame: MoonsFrame) -> bytes:
    """The packet of a frame."""
    body = bytes([frame.bus, frame.identifier & 0xFF, frame.identifier >> 8 & 0x7]) + frame.data
    return bytes([DLE, STX]) + body.replace(b"\x10", b"\x10\x10") + bytes([DLE, ETX])


class PacketReader:
    """Packets out of a stream, in pieces as they come. What is no packet is passed over."""

    def __init__(self) -> None:
        self._body: bytearray | None = None
        self._escaped = False

    def feed(self, data: bytes) -> list[MoonsFrame]:
        """The frames that are whole now."""
        return [frame for byte in data for frame in self._take(byte)]

    def _take(self, byte: int) -> Iterator[MoonsFrame]:
        if not self._escaped and byte == DLE:
            self._escaped = True
            return
        escaped, self._escaped = self._escaped, False
        if escaped and byte == STX:
            self._body = bytearray()
        elif escaped and byte == ETX:
            body, self._body = self._body, None
            if body is not None and len(body) == BODY_BYTES:
                yield MoonsFrame(body[0], body[1] | body[2] << 8, bytes(body[3:]))
        elif escaped and byte != DLE:
            self._body = None
        elif self._body is not None and len(self._body) < BODY_BYTES:
            self._body.append(byte)
        else:
            self._body = None
