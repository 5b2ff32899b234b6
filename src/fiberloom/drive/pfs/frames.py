"""The FPGA's protocol (ics_cobraCharmer `cmds`, ics_mps_fpga `pfs_eth`): commands and replies, big-endian.

A command is a header and, for RUN, CAL and SETFREQ, one record for each cobra. The last two bytes of the
header are a checksum: all bytes with it zero, summed, negated. A reply has 6 bytes; HOUSEKEEPING, DIAG and
ADMIN send their data as well.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from typing import NamedTuple

import numpy as np

from fiberloom.drive.pfs.numbering import BOARDS, COBRAS, COBRAS_PER_BOARD, SECTORS
from fiberloom.errors import InputError
from fiberloom.typing import Flags, Ints, Records

TCP_PORT = 4001
REPLY_BYTES = 6
HOUSEKEEPING_BYTES = 12 + 8 * COBRAS_PER_BOARD
DIAG_BYTES = ADMIN_BYTES = 12
PERIODS_PER_MS = 16_000
"""Periods of motors count in 1/16 us: a motor of 63 kHz has 254."""
LONGEST_PULSE_US = 1000
"""[A] A longer pulse is refused as no run time."""
ALL_SECTORS = (1 << SECTORS) - 1


class Opcode(IntEnum):
    """First byte of a command and of its replies."""

    RUN = 1
    CAL = 2
    SETFREQ = 3
    HOUSEKEEPING = 4
    POWER = 5
    DIAG = 6
    ADMIN = 7


class Code(IntEnum):
    """What a reply says."""

    OK = 0
    TIMEOUT = 1
    EXECUTION = 2
    CHECKSUM = 3
    COBRA = 4
    BOARD = 5
    FREQUENCY = 6
    RUN_TIME = 7
    INTERLEAVE = 8
    TOO_MANY = 9
    EMPTY = 10


class Arm(IntFlag):
    """Low bits of a record's flags; board << 4 and cobra << 11 stand above. For SETFREQ: 1 theta, 2 phi."""

    THETA_CCW = 1
    PHI_CCW = 2
    THETA_ON = 4
    PHI_ON = 8


def _words(names: str) -> np.dtype[np.void]:
    return np.dtype([(name, ">u2") for name in names.split()])


RUN_ARM = _words("flags theta_us theta_steps theta_sleeps phi_us phi_steps phi_sleeps")
CAL_ARM = _words("flags theta_first theta_last phi_first phi_last")
"""Periods between which the resonance is looked for, in 1/16 us."""
SETFREQ_ARM = _words("flags theta_period phi_period")


def arm_flags(board: Ints, cobra: Ints, low: Ints) -> Ints:
    """Flags of records: board and plug above the `low` bits (Arm)."""
    return np.asarray(low) | np.asarray(board) << 4 | np.asarray(cobra) << 11


def boards_of(arms: Records) -> Ints:
    """(n,) boards, from 1, of records."""
    return arms["flags"].astype(np.int64) >> 4 & 0x7F


def plugs_on_board(arms: Records) -> Ints:
    """(n,) cobras on their board, from 1, of records."""
    return arms["flags"].astype(np.int64) >> 11


def has(arms: Records, bit: Arm) -> Flags:
    """(n,) records that have a bit of Arm set."""
    set_: Flags = (arms["flags"] & int(bit)) != 0
    return set_


def _none(kind: np.dtype[np.void]) -> Records:
    return np.zeros(0, dtype=kind)


@dataclass(frozen=True, eq=False)
class RunCommand:
    """Motors make their steps; all boards at once."""

    arms: Records = field(default_factory=lambda: _none(RUN_ARM))
    timeout_ms: int = 100
    interleave_us: int = 156
    count: int = 0
    """Comes back in the replies."""


@dataclass(frozen=True, eq=False)
class Calibrate:
    """Motors look for their resonance between two periods."""

    arms: Records = field(default_factory=lambda: _none(CAL_ARM))
    timeout_ms: int = 100
    count: int = 0


@dataclass(frozen=True, eq=False)
class SetFrequency:
    """Motors get their periods."""

    arms: Records = field(default_factory=lambda: _none(SETFREQ_ARM))
    timeout_ms: int = 100
    count: int = 0


@dataclass(frozen=True)
class Housekeeping:
    """A board tells its temperatures, voltage, periods and currents."""

    board: int
    timeout_ms: int = 2000
    count: int = 0


@dataclass(frozen=True)
class Power:
    """Sectors with power, and sectors to reset: bits 0 to 5."""

    on: int = ALL_SECTORS
    reset: int = 0
    count: int = 0


@dataclass(frozen=True)
class Diagnose:
    """How many boards answer in each sector."""

    count: int = 0


@dataclass(frozen=True)
class Admin:
    """Version and clock; sets how much the FPGA logs."""

    debug_level: int = 0
    count: int = 0


Command = RunCommand | Calibrate | SetFrequency | Housekeeping | Power | Diagnose | Admin


class RefusedCommand(NamedTuple):
    """A command that could not be read: the reply that it gets."""

    opcode: int
    number: int
    """That the command had."""
    code: Code


def checksum(data: bytes) -> int:
    """What makes the sum of all bytes zero, modulo 65536."""
    return -sum(data) & 0xFFFF


def encode(command: Command) -> bytes:
    """The bytes of a command."""
    try:
        head, records = _parts(command)
    except struct.error as error:
        name = type(command).__name__
        raise InputError(f"FPGA command {name}: {error}; fields have 8 or 16 bits") from None
    return head + checksum(head + records).to_bytes(2, "big") + records


def _parts(command: Command) -> tuple[bytes, bytes]:
    """Header without its checksum, and records."""
    match command:
        case RunCommand():
            n = len(command.arms)
            head = struct.pack(">BBHHH", 1, command.count, n, command.timeout_ms, command.interleave_us)
            return head, command.arms.astype(RUN_ARM).tobytes()
        case Calibrate():
            head = struct.pack(">BBHH", 2, command.count, len(command.arms), command.timeout_ms)
            return head, command.arms.astype(CAL_ARM).tobytes()
        case SetFrequency():
            head = struct.pack(">BBHH", 3, command.count, len(command.arms), command.timeout_ms)
            return head, command.arms.astype(SETFREQ_ARM).tobytes()
        case Housekeeping():
            return struct.pack(">BBHH", 4, command.count, command.board, command.timeout_ms), b""
        case Power():
            return struct.pack(">BBBBH", 5, command.count, command.on, command.reset, 100), b""
        case Diagnose():
            return struct.pack(">BBH", 6, command.count, 100), b""
        case Admin():
            return struct.pack(">BBBBH", 7, command.count, command.debug_level, 0, 100), b""


_HEADER_BYTES = {1: 10, 2: 8, 3: 8, 4: 8, 5: 8, 6: 6, 7: 8}
_RECORDS = {1: RUN_ARM, 2: CAL_ARM, 3: SETFREQ_ARM}


class CommandReader:
    """Cuts a stream of bytes into commands, as the FPGA does: what is no command is answered by a code.

    A byte that no command begins with is thrown away.
    """

    def __init__(self) -> None:
        self._rest = bytearray()

    def feed(self, data: bytes) -> Iterator[Command | RefusedCommand]:
        """Commands that are complete with these bytes."""
        self._rest += data
        while (whole := self._cut()) is not None:
            yield decode(whole)

    def expire(self) -> RefusedCommand | None:
        """Nothing more came for too long: what is there is thrown away, and answered if it is something."""
        rest, self._rest = bytes(self._rest), bytearray()
        return RefusedCommand(rest[0], rest[1] if len(rest) > 1 else 0, Code.EMPTY) if rest else None

    def _cut(self) -> bytes | None:
        """The next command's bytes; None: wait for more."""
        while self._rest and self._rest[0] not in _HEADER_BYTES:
            del self._rest[0]
        if not self._rest:
            return None
        opcode = self._rest[0]
        size = _HEADER_BYTES[opcode]
        if len(self._rest) < size:
            return None
        if opcode in _RECORDS:
            size += int.from_bytes(self._rest[2:4], "big") * _RECORDS[opcode].itemsize
        if len(self._rest) < size:
            return None
        whole = bytes(self._rest[:size])
        del self._rest[:size]
        return whole


def decode(data: bytes) -> Command | RefusedCommand:
    """The command of all its bytes, or why the FPGA refuses it. Records are looked at before the checksum."""
    opcode, count = data[0], data[1]
    size = _HEADER_BYTES[opcode]
    words = [int.from_bytes(data[k : k + 2], "big") for k in range(2, size, 2)]
    sum_ok = sum(data) - sum(data[size - 2 : size]) + words[-1] & 0xFFFF == 0
    if opcode in _RECORDS:
        arms = np.frombuffer(data, dtype=_RECORDS[opcode], offset=size)
        if (code := _wrong(opcode, arms, words)) is not Code.OK:
            return RefusedCommand(opcode, count, code)
    if not sum_ok:
        return RefusedCommand(opcode, count, Code.CHECKSUM)
    match opcode:
        case Opcode.RUN:
            return RunCommand(arms, words[1], words[2], count)
        case Opcode.CAL:
            return Calibrate(arms, words[1], count)
        case Opcode.SETFREQ:
            return SetFrequency(arms, words[1], count)
        case Opcode.HOUSEKEEPING:
            return _housekeeping(words, count)
        case Opcode.POWER:
            return Power(data[2], data[3], count)
        case Opcode.DIAG:
            return Diagnose(count)
    return Admin(data[2], count)


def _housekeeping(words: list[int], count: int) -> Housekeeping | RefusedCommand:
    if not 1 <= words[0] <= BOARDS:
        return RefusedCommand(Opcode.HOUSEKEEPING, count, Code.BOARD)
    return Housekeeping(words[0], words[1], count)


def _wrong(opcode: int, arms: Records, words: list[int]) -> Code:
    """What is wrong with records, and with the header of a RUN."""
    if len(arms) > COBRAS:
        return Code.TOO_MANY
    cobra, board = plugs_on_board(arms), boards_of(arms)
    if np.any((cobra < 1) | (cobra > COBRAS_PER_BOARD)):
        return Code.COBRA
    if np.any((board < 1) | (board > BOARDS)):
        return Code.BOARD
    if opcode == Opcode.RUN:
        return _wrong_run(arms, words[2])
    names = [name for name in arms.dtype.names or () if name != "flags"]
    return Code.FREQUENCY if any(np.any(arms[name] == 0) for name in names) else Code.OK


def _wrong_run(arms: Records, interleave_us: int) -> Code:
    if len(arms) == 0:
        return Code.EMPTY
    for motor, on in (("theta", Arm.THETA_ON), ("phi", Arm.PHI_ON)):
        pulse_us = arms[f"{motor}_us"]
        steps = has(arms, on) & (arms[f"{motor}_steps"] > 0)
        if np.any(steps & ((pulse_us == 0) | (pulse_us > LONGEST_PULSE_US))):
            return Code.RUN_TIME
    return Code.INTERLEAVE if interleave_us == 0 else Code.OK


class BoardReply(NamedTuple):
    """Six bytes."""

    opcode: int
    number: int
    """That the command had."""
    code: int
    detail: int = 0

    def to_bytes(self) -> bytes:
        """As they go over the wire."""
        return struct.pack(">BBHH", *self)

    @classmethod
    def of(cls, data: bytes) -> BoardReply:
        """From the first 6 bytes."""
        return cls(*struct.unpack(">BBHH", data[:REPLY_BYTES]))


class BoardState(NamedTuple):
    """What HOUSEKEEPING tells of a board, in counts of its converters."""

    board: int
    temperature: tuple[int, int]
    voltage: int
    periods: Ints
    """(29, 2) of theta and phi in 1/16 us."""
    currents: Ints
    """(29, 2)."""

    def to_bytes(self, count: int, code: int = Code.OK) -> bytes:
        """The reply of 244 bytes, dimensionless counts; `count` of the command."""
        head = struct.pack(">BBHHHHH", 4, count, code, self.board, *self.temperature, self.voltage)
        pairs = np.stack([self.periods, self.currents], axis=2)
        return head + pairs.astype(">u2").tobytes()

    @classmethod
    def of(cls, data: bytes) -> BoardState:
        """From the bytes of that reply."""
        _, _, _, board, *rest = struct.unpack(">BBHHHHH", data[:12])
        pairs = np.frombuffer(data, dtype=">u2", offset=12).reshape(COBRAS_PER_BOARD, 2, 2).astype(np.int64)
        return cls(board, (rest[0], rest[1]), rest[2], pairs[:, :, 0], pairs[:, :, 1])


def diag_reply(count: int, boards: list[int]) -> bytes:
    """Boards of the 6 sectors, in 12 bytes."""
    return bytes([6, count, *boards, 0, Code.OK, 0, 0])


def admin_reply(count: int, version: tuple[int, int], time_ms: int) -> bytes:
    """Version and clock, in 12 bytes."""
    return struct.pack(">BBBBIHH", 7, count, *version, time_ms & 0xFFFFFFFF, Code.OK, 0)
