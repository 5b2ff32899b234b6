"""84 boards behind one FPGA, as its client meets them: bytes in, bytes out later. No sockets, no clock.

One operation runs at a time. RUN, CAL, SETFREQ and HOUSEKEEPING are answered when they are received, and
again when they are done. Boards hang in chains of 14; those behind one without power do not answer. What is
sent to them is lost without a word: a RUN ends well, and their cobras have not moved (ics_mps_fpga).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fiberloom.drive.pfs.frames import (
    ALL_SECTORS,
    LONGEST_PULSE_US,
    Admin,
    Arm,
    BoardReply,
    BoardState,
    Calibrate,
    Code,
    Command,
    CommandReader,
    Diagnose,
    Housekeeping,
    Opcode,
    Power,
    RefusedCommand,
    RunCommand,
    SetFrequency,
    admin_reply,
    boards_of,
    diag_reply,
    has,
    plugs_on_board,
)
from fiberloom.drive.pfs.numbering import (
    BOARDS,
    BOARDS_PER_SECTOR,
    COBRAS,
    COBRAS_PER_BOARD,
    SECTORS,
    cobras_at,
    plugs_of,
    sector_of,
)
from fiberloom.twin.cobras.array import CobraArray, CobraMove
from fiberloom.typing import Flags, Floats, Ints, Records

GROUPS, COBRAS_PER_GROUP = 16, 2
"""Of a board: two cobras pulse at once."""
RECEIVED_S = 0.002
"""[A] From the last byte to the first reply."""
CAL_S_PER_PERIOD = 0.007
"""At most, for each period that is tried (ics_cobraCharmer)."""
QUIET_S = 1.0
"""[A] So long an unfinished command is waited for."""
VERSION = (2, 0)
PERIODS = (257, 160)
"""Of theta and phi as they wake up, in 1/16 us: 62.3 and 100 kHz."""


class Answer(NamedTuple):
    """Bytes for the client, and when they go."""

    at_s: float
    data: bytes


@dataclass
class Boards:
    """The FPGA, its boards and the cobras behind them. `clock` tells the time in s."""

    array: CobraArray
    clock: Callable[[], float]
    unpowered: set[int] = field(default_factory=set)
    """Boards, 1 to 84, that have lost their power."""

    def __post_init__(self) -> None:
        self.sectors_on = ALL_SECTORS
        self.runs = 0
        self.periods = np.tile(PERIODS, (BOARDS, COBRAS_PER_BOARD, 1)).astype(np.int64)
        self._reader, self._heard_s, self._busy_until_s = CommandReader(), 0.0, 0.0
        self._row_of = np.full(COBRAS + 1, -1)
        self._row_of[self.array.plane.positioner_id] = np.arange(len(self.array.plane))
        self.array.clock = self.clock

    def connected(self) -> None:
        """A client is there: what an earlier one left unfinished is forgotten. What runs goes on."""
        self._reader = CommandReader()

    def take(self, data: bytes) -> list[Answer]:
        """Bytes of the client."""
        answers = self.quiet()
        self._heard_s = self.clock()
        for found in self._reader.feed(data):
            answers += self._refuse(found) if isinstance(found, RefusedCommand) else self._obey(found)
        return answers

    def quiet(self) -> list[Answer]:
        """To be called when nothing has come for a while: an unfinished command is given up."""
        if self.clock() - self._heard_s < QUIET_S:
            return []
        left = self._reader.expire()
        return [] if left is None else self._refuse(left)

    def answering(self) -> Flags:
        """(84,) boards that have power and hang in an unbroken chain."""
        on = np.ones((SECTORS, BOARDS_PER_SECTOR), dtype=bool)
        on[[not self.sectors_on >> k & 1 for k in range(SECTORS)]] = False
        for board in self.unpowered:
            on[divmod(board - 1, BOARDS_PER_SECTOR)] = False
        return np.logical_and.accumulate(on, axis=1).ravel()

    def _refuse(self, found: RefusedCommand) -> list[Answer]:
        if found.opcode == Opcode.DIAG:
            return [self._now(bytes([*diag_reply(found.number, [0] * SECTORS)[:9], found.code, 0, 0]))]
        return [self._now(BoardReply(*found).to_bytes())]

    def _now(self, data: bytes) -> Answer:
        return Answer(self.clock() + RECEIVED_S, data)

    def _obey(self, command: Command) -> list[Answer]:
        match command:
            case Diagnose():
                counts = self.answering().reshape(SECTORS, -1).sum(axis=1)
                return [self._now(diag_reply(command.count, counts.tolist()))]
            case Admin():
                return [self._now(admin_reply(command.count, VERSION, round(1e3 * self.clock())))]
            case Power():
                return self._power(command)
            case RunCommand():
                return self._timed(Opcode.RUN, command, self._run(command))
            case Calibrate():
                return self._timed(Opcode.CAL, command, self._calibrate(command.arms))
            case SetFrequency():
                return self._timed(Opcode.SETFREQ, command, self._set(command))
        return self._housekeeping(command)

    def _timed(
        self, opcode: Opcode, command: RunCommand | Calibrate | SetFrequency, took_s: float
    ) -> list[Answer]:
        """Received, and done: or the time given is over, and motors that run go on."""
        first = self._now(BoardReply(opcode, command.count, Code.OK).to_bytes())
        begins_s = max(first.at_s, self._busy_until_s)
        self._busy_until_s = begins_s + took_s
        late = took_s > 1e-3 * command.timeout_ms
        code = Code.TIMEOUT if late else Code.OK
        ends_s = begins_s + min(took_s, 1e-3 * command.timeout_ms)
        return [first, Answer(ends_s, BoardReply(opcode, command.count, code).to_bytes())]

    def _power(self, command: Power) -> list[Answer]:
        was = self.answering()
        self.sectors_on = command.on & ALL_SECTORS
        lost = was & (~self.answering() | _in_sectors(command.reset))
        self.array.halt(lost[plugs_of(self.array.plane.positioner_id).board - 1])
        self.periods[lost] = PERIODS
        return [self._now(BoardReply(Opcode.POWER, command.count, Code.OK).to_bytes())]

    def _run(self, command: RunCommand) -> float:
        """Starts the motors; how long they run in s."""
        self.runs += 1
        step_s = step_durations_s(command.arms, command.interleave_us)
        return self.array.start(self._move(command.arms, step_s))

    def _move(self, arms: Records, step_s: Floats) -> CobraMove:
        board = boards_of(arms)
        row = self._row_of[cobras_at(board, plugs_on_board(arms))]
        there = (row >= 0) & self.answering()[board - 1]
        arms, row = arms[there], row[there]
        n = len(self.array.plane)
        steps, pulse, sleeps = np.zeros((n, 2), np.int64), np.ones((n, 2)), np.zeros((n, 2), np.int64)
        for k, (name, on, ccw) in enumerate(_MOTORS):
            sign = np.where(has(arms, ccw), -1, 1) * has(arms, on)
            steps[row, k] = sign * arms[f"{name}_steps"].astype(np.int64)
            pulse[row, k], sleeps[row, k] = arms[f"{name}_us"], arms[f"{name}_sleeps"]
        # what is not on does not wait either
        sleeps[steps == 0] = 0
        return CobraMove(steps, pulse, sleeps, step_s[plugs_of(self.array.plane.positioner_id).board - 1])

    def _calibrate(self, arms: Records) -> float:
        """The search of resonances: how long it takes in s. Motors keep the periods that they have."""
        wide = np.abs(arms["theta_last"].astype(int) - arms["theta_first"])
        wide = np.maximum(wide, np.abs(arms["phi_last"].astype(int) - arms["phi_first"]))
        per_board = np.bincount(boards_of(arms), weights=wide, minlength=1)
        return CAL_S_PER_PERIOD * float(per_board.max(initial=0.0))

    def _set(self, command: SetFrequency) -> float:
        arms = command.arms
        for k, name in enumerate(("theta", "phi")):
            on = (arms["flags"] >> k & 1 == 1) & self.answering()[boards_of(arms) - 1]
            at = boards_of(arms)[on] - 1, plugs_on_board(arms)[on] - 1
            self.periods[(*at, k)] = arms[f"{name}_period"][on]
        return 0.01

    def _housekeeping(self, command: Housekeeping) -> list[Answer]:
        first = self._now(BoardReply(Opcode.HOUSEKEEPING, command.count, Code.OK).to_bytes())
        nothing = np.zeros((COBRAS_PER_BOARD, 2), dtype=np.int64)
        if not self.answering()[command.board - 1]:
            silent = BoardState(command.board, (0, 0), 0, nothing, nothing)
            at_s = first.at_s + 1e-3 * command.timeout_ms
            return [first, Answer(at_s, silent.to_bytes(command.count, Code.TIMEOUT))]
        state = BoardState(command.board, (1500, 1500), 2000, self.periods[command.board - 1], nothing)
        return [first, Answer(first.at_s + 0.02, state.to_bytes(command.count))]


_MOTORS = (("theta", Arm.THETA_ON, Arm.THETA_CCW), ("phi", Arm.PHI_ON, Arm.PHI_CCW))


def _in_sectors(bits: int) -> Flags:
    """(84,) boards of sectors whose bit is set."""
    set_: Flags = bits >> sector_of(np.arange(1, BOARDS + 1)) & 1 == 1
    return set_


def step_durations_s(arms: Records, interleave_us: int) -> Floats:
    """(84,) s: a step of every cobra of each board, for which its groups pulse in turn."""
    longest = np.full((BOARDS, GROUPS), interleave_us, dtype=np.int64)
    group = (boards_of(arms) - 1, (plugs_on_board(arms) - 1) // COBRAS_PER_GROUP)
    for name, on, _ in _MOTORS:
        pulse: Ints = np.where(has(arms, on), arms[f"{name}_us"], 0).astype(np.int64)
        np.maximum.at(longest, group, np.minimum(pulse, LONGEST_PULSE_US))
    total: Floats = 1e-6 * longest.sum(axis=1)
    return total
