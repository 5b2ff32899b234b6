"""A client of the FPGA: sends a programme to all cobras at once and knows what became of it.

A RUN that was interrupted is not sent again: how far its motors came is not known. The client connects
anew, and an image tells.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from fiberloom.bus.links import retries_s
from fiberloom.drive.pfs.frames import (
    ADMIN_BYTES,
    ALL_SECTORS,
    DIAG_BYTES,
    HOUSEKEEPING_BYTES,
    REPLY_BYTES,
    RUN_ARM,
    SETFREQ_ARM,
    Admin,
    Arm,
    BoardReply,
    BoardState,
    Code,
    Command,
    Diagnose,
    Housekeeping,
    Power,
    RunCommand,
    SetFrequency,
    arm_flags,
    encode,
)
from fiberloom.drive.pfs.numbering import BOARDS_PER_SECTOR, SECTORS, plugs_of, sector_of
from fiberloom.drive.pfs.streams import Connect, Stream, StreamLost
from fiberloom.errors import InputError
from fiberloom.typing import Flags, Floats, Ints, Records

ANSWER_S = 3.0
"""So long an answer is waited for that the FPGA gives at once."""
INTERLEAVE_US = 156
"""16 groups: 2.5 ms for a step of all (ics_cobraCharmer)."""
MOST_PULSE_US = 140
MOST_STEPS = 0xFFFF
STEP_GROUPS = 16


class Ended(Enum):
    """How a RUN ended for a cobra."""

    DONE = "done"
    REFUSED = "refused"
    TIMED_OUT = "timed out"
    UNPOWERED = "its board does not answer"
    UNKNOWN = "the connection was lost"


@dataclass(frozen=True, eq=False)
class Orders:
    """What n cobras shall do."""

    cobra_id: Ints
    """(n,)."""
    steps: Ints
    """(n, 2) of theta and phi, signed."""
    pulse_us: Floats
    """(n, 2)."""
    sleeps: Ints | None = None
    """(n, 2) steps that a motor waits before its own; None: none waits."""

    def records(self) -> Records:
        """As they go over the wire; InputError where a board would refuse them."""
        self._check()
        arms = np.zeros(len(self.cobra_id), dtype=RUN_ARM)
        board, plug = plugs_of(self.cobra_id)
        on, ccw = self.steps != 0, self.steps < 0
        low = ccw[:, 0] * int(Arm.THETA_CCW) + ccw[:, 1] * int(Arm.PHI_CCW)
        low = low + on[:, 0] * int(Arm.THETA_ON) + on[:, 1] * int(Arm.PHI_ON)
        arms["flags"] = arm_flags(board, plug, low)
        for k, name in enumerate(("theta", "phi")):
            arms[f"{name}_us"] = np.rint(self.pulse_us[:, k])
            arms[f"{name}_steps"] = np.abs(self.steps[:, k])
            if self.sleeps is not None:
                arms[f"{name}_sleeps"] = self.sleeps[:, k]
        return arms

    def duration_s(self, interleave_us: int = INTERLEAVE_US) -> float:
        """At most, of the whole RUN, in s."""
        sleeps = 0 if self.sleeps is None else self.sleeps
        steps = (np.abs(self.steps) + sleeps).max(initial=0)
        longest = max(interleave_us, self.pulse_us.max(initial=0.0, where=self.steps != 0))
        return float(1e-6 * STEP_GROUPS * longest * steps)

    def _check(self) -> None:
        plugs_of(self.cobra_id)
        _refuse_first(
            self.cobra_id,
            (self.steps != 0) & ((self.pulse_us < 1.0) | (self.pulse_us > MOST_PULSE_US)),
            self.pulse_us, f"us; pulses have 1 to {MOST_PULSE_US} us",
        )  # fmt: skip
        _refuse_first(
            self.cobra_id, np.abs(self.steps) > MOST_STEPS, self.steps, f"steps; at most {MOST_STEPS}"
        )
        if self.sleeps is not None:
            wrong = (self.sleeps < 0) | (self.sleeps > MOST_STEPS)
            _refuse_first(self.cobra_id, wrong, self.sleeps, f"steps of sleep; 0 to {MOST_STEPS}")


def _refuse_first(cobra_id: Ints, wrong: Flags, values: Floats | Ints, what: str) -> None:
    if not np.any(wrong):
        return
    row, motor = np.argwhere(wrong)[0]
    name = ("theta", "phi")[motor]
    raise InputError(f"cobra {cobra_id[row]}, {name}: {values[row, motor]:g} {what}")


@dataclass(frozen=True, eq=False)
class RunResult:
    """What became of orders."""

    cobra_id: Ints
    ended: list[Ended]
    """Of each cobra."""
    code: Code
    took_s: float

    def ids(self, how: Ended) -> list[int]:
        """Cobras for which it ended so."""
        return [int(c) for c, e in zip(self.cobra_id, self.ended, strict=True) if e is how]


class FpgaClient:
    """Talks to one FPGA. Connects by itself, again where the connection was lost."""

    def __init__(self, connect: Connect, tries: int = 4) -> None:
        """`connect`: makes a connection; `tries` of it, with growing waits between them."""
        self._connect, self._tries = connect, tries
        self._stream: Stream | None = None
        self._last_s = 0.0
        self._count = 0
        self.reconnected = 0
        """How often the connection was lost and made anew."""

    async def open(self) -> None:
        """Connects; InputError where none listens."""
        await self._open()

    async def _open(self) -> Stream:
        if self._stream is None:
            self._stream = await self._try_to_open()
        return self._stream

    async def _try_to_open(self) -> Stream:
        reason = ""
        waits_s = retries_s()
        for k in range(self._tries):
            try:
                return await self._connect()
            except StreamLost as error:
                reason = str(error)
            if k + 1 < self._tries:
                await _pause(self._stream, next(waits_s))
        raise InputError(f"{reason or 'FPGA: no connection'}; check its address and power")

    @property
    def time_s(self) -> float:
        """Of the connection's clock; where there is none, when the last one was let go."""
        return self._last_s if self._stream is None else self._stream.time_s

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, s."""
        await (await self._open()).sleep(duration_s)

    async def close(self) -> None:
        """Lets go."""
        await self._drop()

    async def _drop(self) -> None:
        if self._stream is not None:
            self._last_s = self._stream.time_s
            await self._stream.close()
        self._stream = None

    async def run(self, orders: Orders, interleave_us: int = INTERLEAVE_US) -> RunResult:
        """Sends `orders` and waits until their motors stand; how it ended for each cobra.

        `interleave_us`: at least so long each of the 16 groups of a board has its turn.
        """
        timeout_ms = int(min(1.2e3 * orders.duration_s(interleave_us) + 1000.0, 0xFFFF))
        command = RunCommand(orders.records(), timeout_ms, interleave_us, self._next())
        if len(orders.cobra_id) == 0:
            return RunResult(orders.cobra_id, [], Code.OK, 0.0)
        there = await self.powered(orders.cobra_id)
        begun_s = self.time_s
        try:
            code, received = await self._twice(command, 1e-3 * timeout_ms + ANSWER_S)
        except (StreamLost, TimeoutError):
            await self._again()
            return RunResult(orders.cobra_id, [Ended.UNKNOWN] * len(orders.cobra_id), Code.EXECUTION, 0.0)
        how = Ended.DONE if code is Code.OK else Ended.TIMED_OUT if received else Ended.REFUSED
        ended = [how if powered else Ended.UNPOWERED for powered in there]
        return RunResult(orders.cobra_id, ended, code, self.time_s - begun_s)

    async def boards(self) -> list[int]:
        """Boards that answer in each of the 6 sectors."""
        data = await self._ask(Diagnose(self._next()), DIAG_BYTES)
        return list(data[2 : 2 + SECTORS])

    async def powered(self, cobra_id: Ints) -> Flags:
        """(n,) cobras whose board answers: in each sector the first so many do."""
        counts, board = np.array(await self.boards()), plugs_of(cobra_id).board
        there: Flags = (board - 1) % BOARDS_PER_SECTOR < counts[sector_of(board)]
        return there

    async def version(self) -> tuple[int, int]:
        """Of the FPGA's software."""
        data = await self._ask(Admin(count=self._next()), ADMIN_BYTES)
        return data[2], data[3]

    async def housekeeping(self, board: int) -> BoardState:
        """What a board tells of itself; InputError where it does not answer."""
        stream, command = await self._open(), Housekeeping(board, 2000, self._next())
        await stream.write(encode(command))
        self._accepted(BoardReply.of(await self._reply(stream, REPLY_BYTES, ANSWER_S)), command)
        data = await self._reply(stream, HOUSEKEEPING_BYTES, ANSWER_S + 2.0)
        self._accepted(BoardReply.of(data), command)
        return BoardState.of(data)

    async def power(self, on: int = ALL_SECTORS, reset: int = 0) -> None:
        """Gives power to the sectors whose bits are set in `on`, and resets those in `reset`."""
        command = Power(on, reset, self._next())
        self._accepted(BoardReply.of(await self._ask(command, REPLY_BYTES)), command)

    async def set_periods(self, cobra_id: Ints, periods: Ints) -> None:
        """Gives motors their periods, (n, 2) of theta and phi in 1/16 us."""
        arms = np.zeros(len(cobra_id), dtype=SETFREQ_ARM)
        arms["flags"] = arm_flags(*plugs_of(cobra_id), np.full(len(cobra_id), 3))
        arms["theta_period"], arms["phi_period"] = periods.T
        command = SetFrequency(arms, 2000, self._next())
        code, _ = await self._twice(command, 2.0 + ANSWER_S)
        self._accepted(BoardReply(3, command.count, code), command)

    def _next(self) -> int:
        self._count = (self._count + 1) % 256
        return self._count

    async def _twice(self, command: Command, timeout_s: float) -> tuple[Code, bool]:
        """The code of the last reply, and whether the command was received well."""
        stream = await self._open()
        await stream.write(encode(command))
        first = await self._matching(stream, command.count, ANSWER_S)
        if first.code != Code.OK:
            return Code(first.code), False
        return Code((await self._matching(stream, command.count, timeout_s)).code), True

    async def _matching(self, stream: Stream, count: int, timeout_s: float) -> BoardReply:
        """The next reply to this command; what is left of an earlier one is passed over."""
        deadline_s = stream.time_s + timeout_s
        while True:
            reply = BoardReply.of(await stream.read(REPLY_BYTES, deadline_s - stream.time_s))
            if reply.number == count:
                return reply

    async def _ask(self, command: Command, size: int) -> bytes:
        """The one reply of `size` bytes; once more on a new connection where it was lost."""
        try:
            stream = await self._open()
            await stream.write(encode(command))
            return await self._reply(stream, size, ANSWER_S)
        except StreamLost:
            stream = await self._again()
            await stream.write(encode(command))
            return await self._reply(stream, size, ANSWER_S)

    async def _reply(self, stream: Stream, size: int, timeout_s: float) -> bytes:
        try:
            return await stream.read(size, timeout_s)
        except TimeoutError:
            raise InputError(f"FPGA: no answer within {timeout_s:g} s; check its power and address") from None

    async def _again(self) -> Stream:
        await self._drop()
        self.reconnected += 1
        return await self._open()

    def _accepted(self, reply: BoardReply, command: Command) -> None:
        if reply.code != Code.OK:
            name, code = type(command).__name__, Code(reply.code).name.lower()
            where = f" of board {command.board}" if isinstance(command, Housekeeping) else ""
            raise InputError(f"FPGA: {name}{where} was answered by '{code}'; check power and numbers")


async def _pause(stream: Stream | None, duration_s: float) -> None:
    import asyncio

    await (asyncio.sleep(duration_s) if stream is None else stream.sleep(duration_s))
