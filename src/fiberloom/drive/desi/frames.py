"""Frames of DESI's positioner bus: CAN 2.0B, identifier = CAN id x 256 + command, data of at most 8 bytes.

Sources: copies of DESI's `fiposcontrol.py` 1.01, firmware 6.20 and later. Motor 0 is phi, motor 1 is theta; a
positive angle of the arm is counter-clockwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from fiberloom.drive.desi.clock import MOST_PAUSE_MS, MOST_STEPS
from fiberloom.drive.desi.tables import MoveTables
from fiberloom.errors import InputError

ALL, POSITIONERS, FIDUCIALS = 20000, 20001, 20002
"""Broadcast CAN ids."""
MOST_ID = 2**21 - 1
STILL_ALIVE_S = 60.0
"""A unit that hears nothing for so long goes to standby."""


class DesiCommand(IntEnum):
    """Commands that the twin's controllers know."""

    STAY_ALIVE = 1
    CURRENTS = 2
    """8 bytes of %: phi up, down, cruise, creep; theta the same."""
    PERIODS = 6
    """2 bytes: ticks of a creep step of phi and of theta."""
    TEMPERATURE = 9
    VERSION = 11
    MOVE_STATUS = 13
    """Answered by 0 when still."""
    READ_CURRENTS = 14
    ROW = 26
    RUN = 27
    """0: wait for the sync signal; 1: at once."""
    CHECKSUM = 28
    STOP = 40
    RESET = 42
    STANDBY = 52
    CLEAR = 70


class DesiFrame(NamedTuple):
    """One frame."""

    identifier: int
    data: bytes

    @classmethod
    def of(cls, can_id: int, command: DesiCommand, data: bytes = b"") -> DesiFrame:
        """A frame to or from a CAN id; InputError for one that does not fit."""
        if not 0 <= can_id <= MOST_ID:
            raise InputError(f"CAN id {can_id}: must be 0 to {MOST_ID}")
        if len(data) > 8:
            raise InputError(f"CAN id {can_id}, command {int(command)}: {len(data)} bytes; at most 8 fit")
        return cls(can_id << 8 | command, data)

    @property
    def can_id(self) -> int:
        """Whose it is."""
        return self.identifier >> 8

    @property
    def command(self) -> int:
        """Its number; not each is a `DesiCommand`."""
        return self.identifier & 0xFF


class Motor(NamedTuple):
    """What a row asks of one motor."""

    steps: int
    """Signed, positive towards positive angles."""
    cruise: bool = False


class TableRow(NamedTuple):
    """One row of a table."""

    theta: Motor
    phi: Motor
    pause_ms: int = 0
    last: bool = False


_LAST, _NOT_LAST = 0x80, 0x40
_MOVES, _CRUISES, _CCW = 4, 2, 1
_PHI_SHIFT = 3


def positioner_of(identifier: int) -> int:
    """Whose an identifier is, 0 for a broadcast."""
    number = identifier >> 8
    return 0 if number in (ALL, POSITIONERS, FIDUCIALS) else number


def encode_row(row: TableRow) -> bytes:
    """The 8 bytes of a row; InputError for steps of more than 20 bits or a pause of more than 16."""
    if not 0 <= row.pause_ms <= MOST_PAUSE_MS:
        raise InputError(f"row: pause of {row.pause_ms} ms; it must be 0 to {MOST_PAUSE_MS}")
    header = _LAST if row.last else _NOT_LAST
    header |= _flags(row.phi, "phi") << _PHI_SHIFT | _flags(row.theta, "theta")
    phi, theta = abs(row.phi.steps), abs(row.theta.steps)
    high = theta >> 16 << 4 | phi >> 16
    low = b"".join((n & 0xFFFF).to_bytes(2, "big") for n in (phi, theta, row.pause_ms))
    return bytes([header, high]) + low


def _flags(motor: Motor, name: str) -> int:
    if abs(motor.steps) > MOST_STEPS:
        raise InputError(f"row: {motor.steps} steps of {name}; at most {MOST_STEPS} fit")
    if not motor.steps:
        return 0
    return _MOVES | (_CRUISES if motor.cruise else 0) | (_CCW if motor.steps > 0 else 0)


def decode_row(data: bytes) -> TableRow:
    """The row of 8 bytes; InputError where they contradict themselves."""
    if len(data) != 8:
        raise InputError(f"row: {len(data)} bytes; it has 8")
    header, high = data[0], data[1]
    if bool(header & _LAST) == bool(header & _NOT_LAST):
        raise InputError(f"row {data.hex()}: must be the last one or not, by one bit")
    phi, theta, pause = (int.from_bytes(data[k : k + 2], "big") for k in (2, 4, 6))
    phi, theta = phi | (high & 0xF) << 16, theta | high >> 4 << 16
    return TableRow(
        _motor(header, theta, data), _motor(header >> _PHI_SHIFT, phi, data), pause, bool(header & _LAST)
    )


def _motor(flags: int, count: int, data: bytes) -> Motor:
    moves, cruises, ccw = bool(flags & _MOVES), bool(flags & _CRUISES), bool(flags & _CCW)
    if moves != (count > 0) or ((cruises or ccw) and not moves):
        raise InputError(f"row {data.hex()}: a motor moves if and only if it has steps")
    return Motor(count if ccw else -count, cruises)


def checksum(rows: Sequence[bytes]) -> int:
    """What command 28 answers for a table of rows of 8 bytes."""
    weights = (1, 65536, 256, 1, 256, 1, 256, 1)
    return sum(sum(w * d for w, d in zip(weights, row, strict=True)) + DesiCommand.ROW for row in rows)


def rows_of(tables: MoveTables, unit: int) -> list[TableRow]:
    """The rows of one unit's table, the last one marked; none where it is empty."""
    last = int(tables.rows[unit]) - 1
    steps, cruise = tables.steps[unit].tolist(), tables.cruise[unit].tolist()
    return [
        TableRow(
            Motor(steps[k][0], cruise[k][0]),
            Motor(steps[k][1], cruise[k][1]),
            int(tables.pause_ms[unit, k]),
            k == last,
        )
        for k in range(last + 1)
    ]


def tables_from(rows: Sequence[Sequence[TableRow]]) -> MoveTables:
    """Tables of N units from their rows, padded to the longest."""
    most = max(map(len, rows), default=0)
    still = TableRow(Motor(0), Motor(0))
    padded = [[*unit, *[still] * (most - len(unit))] for unit in rows]
    shape = (len(rows), most, 2)
    steps = [[(r.theta.steps, r.phi.steps) for r in unit] for unit in padded]
    cruise = [[(r.theta.cruise, r.phi.cruise) for r in unit] for unit in padded]
    pause = [[r.pause_ms for r in unit] for unit in padded]
    return MoveTables(
        np.array(steps, dtype=np.int64).reshape(shape),
        np.array(cruise, dtype=bool).reshape(shape),
        np.array(pause, dtype=np.int64).reshape(shape[:2]),
    )


def table_frames(can_id: int, rows: Sequence[TableRow]) -> list[DesiFrame]:
    """What loads a table: clear, its rows, and the question for its checksum. `can_id`: whose."""
    loaded = [DesiFrame.of(can_id, DesiCommand.ROW, encode_row(row)) for row in rows]
    return [DesiFrame.of(can_id, DesiCommand.CLEAR), *loaded, DesiFrame.of(can_id, DesiCommand.CHECKSUM)]


def decode(identifier: int, data: bytes) -> tuple[int, DesiCommand, bytes]:
    """CAN id, command and data of a frame; InputError for an identifier or a command that is none."""
    if not 0 <= identifier < 2**29:
        raise InputError(f"identifier {identifier:#x}: has more than 29 bits")
    number = identifier & 0xFF
    if number not in DesiCommand.__members__.values():
        raise InputError(f"CAN id {identifier >> 8}: command {number} is not known")
    return identifier >> 8, DesiCommand(number), bytes(data)
