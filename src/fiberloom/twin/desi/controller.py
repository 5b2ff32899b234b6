"""The controller in front of a unit's two motors: frames in, a table held, frames out."""

from __future__ import annotations

from typing import Protocol

from fiberloom.drive.desi.frames import (
    STILL_ALIVE_S,
    DesiCommand,
    DesiFrame,
    TableRow,
    checksum,
    decode,
    decode_row,
)
from fiberloom.errors import InputError

FIRMWARE_VERSION = bytes([6, 20])
TEMPERATURE_COUNTS = 1800
"""[A] What the thermistor reads."""
CHECKSUM_BYTES = 4
"""[A] Of the reply, big-endian."""


class Controller(Protocol):
    """What stands behind one address of a bus."""

    def receive(self, frame: DesiFrame) -> list[DesiFrame]:
        """Takes a frame; the replies."""
        ...

    def advance(self, duration_s: float) -> None:
        """Lets time pass, s."""
        ...


class DesiController:
    """One positioner's controller. It has no encoder: it reports what it was told, never where the arm is.

    What it does not understand it does not answer. After a minute without a frame it goes to standby and runs
    nothing until it is reset.
    """

    def __init__(self, can_id: int) -> None:
        self.can_id = can_id
        self.rows: list[TableRow] = []
        self._raw: list[bytes] = []
        self._silent_s, self._left_s = 0.0, 0.0
        self.standby = False
        self.waiting_for_sync = False
        self.started = False
        """Asked to run; what drives the motors takes that by `begin`."""
        self.stopped = False

    @property
    def moving(self) -> bool:
        """Whether a table runs."""
        return self._left_s > 0.0

    @property
    def complete(self) -> bool:
        """Whether the table has its last row."""
        return bool(self.rows) and self.rows[-1].last

    def begin(self, duration_s: float) -> list[TableRow]:
        """The table runs from now on, for so many s."""
        self.started, self._left_s = False, duration_s
        return self.rows

    def sync(self) -> None:
        """The signal on the line for which a table may wait."""
        self.started = self.started or (self.waiting_for_sync and not self.standby)
        self.waiting_for_sync = False

    def advance(self, duration_s: float) -> None:
        """Lets time pass, s."""
        self._left_s = max(self._left_s - duration_s, 0.0)
        self._silent_s += duration_s
        self.standby = self.standby or self._silent_s > STILL_ALIVE_S

    def receive(self, frame: DesiFrame) -> list[DesiFrame]:
        """Takes a frame; the replies carry this unit's own identifier."""
        try:
            _, command, data = decode(*frame)
        except InputError:
            return []
        self._silent_s = 0.0
        answer = self._act(command, data)
        return [] if answer is None else [DesiFrame.of(self.can_id, command, answer)]

    def _act(self, command: DesiCommand, data: bytes) -> bytes | None:
        match command:
            case DesiCommand.ROW:
                self._load(data)
            case DesiCommand.CLEAR:
                self._clear()
            case DesiCommand.RUN:
                self._run(data)
            case DesiCommand.STOP | DesiCommand.STANDBY:
                self.stopped, self._left_s, self.waiting_for_sync = self.moving, 0.0, False
                self.standby = self.standby or command is DesiCommand.STANDBY
            case DesiCommand.RESET:
                self._clear()
                self.standby = False
            case _:
                return self._told(command)
        return None

    def _told(self, command: DesiCommand) -> bytes | None:
        match command:
            case DesiCommand.CHECKSUM:
                return checksum(self._raw).to_bytes(CHECKSUM_BYTES, "big")
            case DesiCommand.MOVE_STATUS:
                return bytes([self.moving])
            case DesiCommand.VERSION:
                return FIRMWARE_VERSION
            case DesiCommand.TEMPERATURE:
                return TEMPERATURE_COUNTS.to_bytes(2, "big")
            case _:
                return None

    def _load(self, data: bytes) -> None:
        if self.moving or self.complete:
            return
        try:
            self.rows.append(decode_row(data))
        except InputError:
            return
        self._raw.append(data)

    def _clear(self) -> None:
        if not self.moving:
            self.rows, self._raw = [], []

    def _run(self, data: bytes) -> None:
        if self.standby or self.moving or not self.complete or data not in (b"\x00", b"\x01"):
            return
        self.waiting_for_sync, self.started = data == b"\x00", data == b"\x01"
