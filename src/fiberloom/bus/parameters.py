"""The firmware parameters of positioners over the bus: read, write, compare, save (230 to 236, 53).

Firmware of this project only (docs/firmware.md): another answers UNKNOWN_COMMAND. Values are written to a
copy and take effect together, or not at all: the positioner compares the CRC-32 of its copy with that of
what the host meant to write. Nothing outlives a power cut before it is saved.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from fiberloom._core import firmware as _firmware
from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Outcome, Result, Results, result_of
from fiberloom.bus.protocol import COMMANDS, Command, Response, Status
from fiberloom.errors import InputError
from fiberloom.typing import Flags
from fiberloom.units import AXES

_SET = (Command.SET_PARAMETER_ALPHA, Command.SET_PARAMETER_BETA)
_GET = (Command.GET_PARAMETER_ALPHA, Command.GET_PARAMETER_BETA)
_BITE = 16
"""Frames of one command under way to a positioner: its queue of answers holds so many."""
_TIMEOUT_S = 2.0
_REPEAT = "switch its power off and on, and repeat"


@dataclass(frozen=True, slots=True)
class Parameter:
    """A line of the firmware's table (firmware/positioner/axis/fl_params.h)."""

    index: int
    name: str
    unit: str
    low: float
    high: float
    default: float
    """Of the alpha axis of an SDSS-V positioner."""
    meaning: str


PARAMETERS: tuple[Parameter, ...] = tuple(Parameter(k, *row) for k, row in enumerate(_firmware.AXIS_PARAMS))
"""Every parameter of an axis, in the order of the wire."""

PARAMETERS_BY_NAME: dict[str, Parameter] = {p.name: p for p in PARAMETERS}

PARAMETERS_DTYPE = np.dtype([(p.name, np.float32) for p in PARAMETERS])
"""One axis."""

AxisParameters = NDArray[np.void]
"""Records of PARAMETERS_DTYPE; (2,) for the axes of a positioner."""


@cache
def table_crc() -> int:
    """CRC-32 of the table that this host knows: names, units, ranges and defaults."""
    text = b"".join(
        p.name.encode() + b"\0" + p.unit.encode() + b"\0"
        + np.array([p.low, p.high, p.default], dtype="<f4").tobytes()
        for p in PARAMETERS
    )  # fmt: skip
    return zlib.crc32(text)


def values_crc(values: AxisParameters) -> int:
    """CRC-32 of the parameters of both axes, (2,) records, as a positioner computes it."""
    return zlib.crc32(np.ascontiguousarray(values).tobytes())


def out_of_range(values: AxisParameters) -> list[tuple[int, Parameter, float]]:
    """(axis, parameter, value in the parameter's SI unit) of each value that the firmware would refuse.

    `values`: (2,) records, alpha and beta.
    """
    return [
        (axis, p, float(values[axis][p.name]))
        for axis in range(2)
        for p in PARAMETERS
        # the range is single precision there
        if not np.float32(p.low) <= values[axis][p.name] <= np.float32(p.high)
    ]


@dataclass(frozen=True)
class ParameterState:
    """What a positioner holds."""

    values: AxisParameters
    """(2,) alpha and beta."""
    reason: str = ""
    """Why it could not be read; then the values are the table's defaults."""


@dataclass(frozen=True)
class Written:
    """How writing to a positioner ended."""

    positioner_id: int
    reason: str
    """Why it failed; empty when the values are in force, read back and saved."""
    in_force: str
    """What it works with now: "new", "old", or "unknown"."""

    @property
    def ok(self) -> bool:
        """In force, read back, saved."""
        return not self.reason


async def read_parameters(client: Client, ids: Iterable[int] | None = None) -> dict[int, ParameterState]:
    """All parameters of each positioner; what could not be read has a reason."""
    out: dict[int, ParameterState] = {}
    tables = await client.command(Command.GET_PARAMETER_TABLE, ids)
    good = [i for i, r in tables.items() if not _table_fault(r)]
    bits, answered = await _read_values(client, good)
    for row, number in enumerate(good):
        values = bits[row].view(PARAMETERS_DTYPE)[:, 0]
        if not answered[row]:
            out[number] = _unread("a parameter was not answered; check the bus and repeat")
        elif values_crc(values) != tables[number].values[1]:
            out[number] = _unread("the parameters read are not those that its checksum tells; repeat")
        else:
            out[number] = ParameterState(values)
    out |= {i: _unread(_table_fault(r)) for i, r in tables.items() if i not in out}
    return {i: out[i] for i in tables}


def _unread(reason: str) -> ParameterState:
    row = tuple(p.default for p in PARAMETERS)
    return ParameterState(np.array([row, row], dtype=PARAMETERS_DTYPE), reason)


def _table_fault(result: Result) -> str:
    if result.code is Response.UNKNOWN_COMMAND:
        return "its firmware has no parameter commands (230 to 236)"
    if not result.ok:
        return f"{_told(result)} to GET_PARAMETER_TABLE"
    if result.values[0] != table_crc():
        return (
            f"its parameter table is {result.values[0]:08x}, this host's is {table_crc():08x}: "
            "use the host of the firmware's version, or upgrade the firmware"
        )
    return ""


def _told(result: Result) -> str:
    return str(result).partition(": ")[2]


Asked = tuple[int, tuple[int, ...]]
"""A positioner, and the values of a request to it."""


async def _read_values(client: Client, ids: Sequence[int]) -> tuple[NDArray[np.uint32], Flags]:
    """Bits (n, 2, P), and whether every one of them was answered (n,)."""
    bits = np.zeros((len(ids), 2, len(PARAMETERS)), dtype=np.uint32)
    heard = np.zeros(bits.shape, dtype=bool)
    row_of = {number: row for row, number in enumerate(ids)}
    for axis in range(2):
        asked: list[Asked] = [(i, (p.index,)) for p in PARAMETERS for i in ids]
        for (number, (index,)), result in await _many(client, _GET[axis], asked):
            if result.ok and result.values[0] == index:
                bits[row_of[number], axis, index] = result.values[1]
                heard[row_of[number], axis, index] = True
    return bits, np.asarray(heard.all(axis=(1, 2)))


async def _many(client: Client, command: Command, asked: list[Asked]) -> list[tuple[Asked, Result]]:
    """Many requests to each positioner, by bites; those without an answer are asked again."""
    spec = COMMANDS[command]
    out: dict[Asked, Result] = {}
    for _ in range(client.retries + 1):
        rest = [a for a in asked if a not in out or out[a].outcome is Outcome.TIMED_OUT]
        for bite in _bites(rest):
            replies = await client.exchange.unicast(
                command, [i for i, _ in bite], [spec.pack(*values) for _, values in bite], _TIMEOUT_S
            )
            out |= {
                a: result_of(a[0], command, r, client.exchange.cut_off(a[0]))
                for a, r in zip(bite, replies, strict=True)
            }
    return [(a, out[a]) for a in asked]


def _bites(asked: list[Asked]) -> list[list[Asked]]:
    """In order, at most _BITE of a positioner in each."""
    count: dict[int, int] = {}
    out: list[list[Asked]] = []
    for a in asked:
        bite = count.get(a[0], 0) // _BITE
        count[a[0]] = count.get(a[0], 0) + 1
        if bite == len(out):
            out.append([])
        out[bite].append(a)
    return out


async def write_parameters(client: Client, wanted: Mapping[int, AxisParameters]) -> dict[int, Written]:
    """Writes (2,) records to positioners: all values or none, read back, compared, saved.

    Where something fails after they took effect the old ones are put back. A cancelled call does so too.
    InputError, before anything is sent, for a value outside of its range.
    """
    for number, values in wanted.items():
        for axis, p, value in out_of_range(values):
            raise InputError(
                f"positioner {number}, {AXES[axis]} {p.name} = {value:g} {p.unit}: "
                f"must be {p.low:g} to {p.high:g}"
            )
    before = await read_parameters(client, wanted)
    writer = _Writer(client, {i: np.array(v) for i, v in wanted.items()}, before)
    try:
        return await writer.run()
    except BaseException:
        await writer.restore(list(writer.changed), "")
        raise


class _Writer:
    """Drops each positioner at its first fault and keeps what to tell of it."""

    def __init__(
        self, client: Client, wanted: dict[int, AxisParameters], before: dict[int, ParameterState]
    ) -> None:
        self._client, self._wanted, self._before = client, wanted, before
        self.changed: dict[int, bool] = {}
        """Positioners in which the new values are, or may be, in force and not saved."""
        self._fault = {i: s.reason for i, s in before.items()}
        self._in_force = dict.fromkeys(wanted, "old")

    async def run(self) -> dict[int, Written]:
        await self._stage(self._left(), self._wanted)
        await self._commit(self._left(), self._wanted)
        await self._compare()
        await self._save()
        return {i: Written(i, self._fault[i], self._in_force[i]) for i in self._wanted}

    def _left(self) -> list[int]:
        return [i for i in self._wanted if not self._fault[i]]

    def _book(self, results: Results, what: str) -> None:
        for i, r in results.failed.items():
            after = "the old parameters are in force"
            if self._in_force[i] == "unknown":
                after = f"which parameters are in force is not known: {_REPEAT}"
            self._fault[i] = self._fault[i] or f"{_told(r)} to {what}; {after}"

    async def _stage(self, ids: list[int], values: dict[int, AxisParameters]) -> None:
        """The copy, and in it what differs from what is in force."""
        begun = await self._client.command(Command.BEGIN_PARAMETERS, ids, table_crc())
        self._book(begun, "BEGIN_PARAMETERS")
        for axis in range(2):
            asked = [a for i in begun.ok_ids for a in self._differing(i, axis, values[i])]
            for (number, (index, _)), result in await _many(self._client, _SET[axis], asked):
                self._book(Results({number: result}), f"SET_PARAMETER of {PARAMETERS[index].name}")

    def _differing(self, number: int, axis: int, values: AxisParameters) -> list[Asked]:
        now = self._before[number].values[axis].tobytes()
        new = values[axis].tobytes()
        bits = np.frombuffer(new, dtype="<u4")
        # putting back: everything, for what is in force is not known
        every = number in self.changed
        differ = np.frombuffer(now, dtype="<u4") != bits
        return [(number, (int(k), int(bits[k]))) for k in np.flatnonzero(differ | every)]

    async def _commit(self, ids: list[int], values: dict[int, AxisParameters]) -> None:
        self.changed |= dict.fromkeys(ids, True)
        crcs = [values_crc(values[i]) for i in ids]
        results = await self._client.command(Command.COMMIT_PARAMETERS, ids, crcs)
        await self._settle_lost(results, values)
        for i in results.ok_ids:
            self._in_force[i] = "new"
        for i in results.failed:
            self.changed.pop(i, None)
        self._book(results, "COMMIT_PARAMETERS (a frame was lost, or it moved)")

    async def _settle_lost(self, results: Results, values: dict[int, AxisParameters]) -> None:
        """An answer that was lost: the checksum tells whether the commit was."""
        silent = [i for i, r in results.items() if r.outcome is Outcome.TIMED_OUT]
        for i, table in (await self._client.command(Command.GET_PARAMETER_TABLE, silent)).items():
            if table.ok and table.values[1] == values_crc(values[i]):
                results[i] = Result(i, Outcome.DONE)
            elif not table.ok:
                self._in_force[i] = "unknown"

    async def _compare(self) -> None:
        now = await read_parameters(self._client, self._left())
        wrong = {i: self._difference(i, s) for i, s in now.items()}
        for i, why in wrong.items():
            if why:
                await self.restore([i], f"reading back: {why}")

    def _difference(self, number: int, state: ParameterState) -> str:
        if state.reason:
            return state.reason
        for axis, name in enumerate(AXES):
            for p in PARAMETERS:
                meant, found = self._wanted[number][axis][p.name], state.values[axis][p.name]
                if meant.tobytes() != found.tobytes():
                    return f"{name} {p.name} is {found:g}, {meant:g} was written"
        return ""

    async def _save(self) -> None:
        ids = self._left()
        saved = await self._client.command(Command.SAVE_INTERNAL_CALIBRATION, ids)
        status = await self._client.status(saved.ok_ids)
        tables = await self._client.command(Command.GET_PARAMETER_TABLE, saved.ok_ids)
        for i in ids:
            if saved[i].outcome is Outcome.REFUSED:
                await self.restore([i], f"{_told(saved[i])} to SAVE_INTERNAL_CALIBRATION")
            elif not saved[i].ok:
                await self.restore([i], f"{_told(saved[i])} to SAVE_INTERNAL_CALIBRATION", perhaps_saved=True)
            elif not _is_saved(status[i]):
                await self.restore([i], "it does not report what was saved", perhaps_saved=True)
            elif not tables[i].ok or tables[i].values[1] != values_crc(self._wanted[i]):
                # its power was cut in between: it has saved what it started with
                await self.restore([i], "other parameters are in force after the save", perhaps_saved=True)
            else:
                self.changed.pop(i, None)

    async def restore(self, ids: list[int], why: str, perhaps_saved: bool = False) -> None:
        """Puts the old parameters back in force (and in the storage, if need be), and says why."""
        old = {i: self._before[i].values for i in ids}
        for i in ids:
            self._fault[i] = ""
        await self._stage(ids, old)
        await self._commit([i for i in ids if not self._fault[i]], old)
        kept = Results()
        if perhaps_saved:
            back = [i for i in ids if not self._fault[i]]
            kept = await self._client.command(Command.SAVE_INTERNAL_CALIBRATION, back)
        for i in ids:
            self._conclude(i, why, i in kept.failed)

    def _conclude(self, number: int, why: str, not_kept: bool) -> None:
        self.changed.pop(number, None)
        fault = self._fault[number].partition(";")[0]  # without what is in force: that is not the old ones
        self._in_force[number] = "unknown" if fault else "old"
        after = "the old parameters are in force again"
        if fault:
            after = f"putting the old ones back failed ({fault}): {_REPEAT}"
        elif not_kept:
            after += ", but after a power cut it may start with the new ones: repeat"
        self._fault[number] = f"{why}; {after}"


def _is_saved(status: Result) -> bool:
    if not status.ok:
        return False
    word = Status(status.values[0])
    return bool(word & Status.CALIBRATION_SAVED) and not word & Status.CONFIG_CHANGED
