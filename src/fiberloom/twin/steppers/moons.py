"""MOONS' units behind their gateways in the twin: bytes in, bytes out. In virtual time."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

import numpy as np

from fiberloom.drive.moons.frames import (
    ALPHA_START,
    ANSWER_PRIORITY,
    BROADCAST,
    GATEWAYS,
    MoonsAnswer,
    MoonsCommand,
    MoonsError,
    MoonsFrame,
    MoonsState,
    PacketReader,
    Segment,
    UnitPlace,
    decode_segment,
    packed,
)
from fiberloom.drive.moons.waveform import LEAST, SEGMENT_S, check_waveform
from fiberloom.errors import InputError
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.steppers.array import CountPath, StepperArray
from fiberloom.twin.steppers.bus import StepperBus
from fiberloom.twin.steppers.interlocks import InterlockStop, StopKind
from fiberloom.typing import Ints

SEARCH_HZ = LEAST / SEGMENT_S
"""Of a datum search: the speed of a start."""
FREE_BETA_STEPS, FREE_ALPHA_STEPS = 10, 11
"""Of a command that frees an arm (ukatc/fpu_driver)."""


READY = MoonsState.READY_FORWARD, MoonsState.READY_REVERSE
"""Holds a waveform."""


@dataclass
class _Unit:
    """What a controller keeps."""

    state: MoonsState = MoonsState.UNINITIALISED
    segments: list[tuple[int, int]] = field(default_factory=list)
    last: list[tuple[int, int]] = field(default_factory=list)
    """The waveform that it has gone to its end, to be repeated or reversed."""
    hit: InterlockStop | None = None
    """What has stopped it, or will: until its protection is on again."""


class MoonsBus(StepperBus):
    """Units by their numbers, behind three gateways."""

    def __init__(self, array: StepperArray) -> None:
        super().__init__(array)
        array.interlocked()
        self.units = {address: _Unit() for address in self.row_of}
        self._readers = [PacketReader() for _ in range(GATEWAYS)]
        self._due: list[tuple[float, int, MoonsCommand]] = []
        """When units say something unasked, and what."""
        self._armed: dict[int, None] = {}
        """Told to start: gateways are synchronised, so that all start together when time goes on. Such a
        unit says that it moves."""
        self._alpha_at: list[tuple[float, list[int]]] = []
        """Searches of alpha, which follow those of beta."""

    def take(self, gateway: int, data: bytes) -> list[tuple[int, bytes]]:
        """Bytes of a client to a gateway; what it sends back at once."""
        answers: list[tuple[int, MoonsAnswer]] = []
        searching: list[int] = []
        for frame in self._readers[gateway].feed(data):
            try:
                command = frame.command
            except InputError:
                continue
            for address in self._addressed(gateway, frame):
                if command is MoonsCommand.FIND_DATUM:
                    searching.append(address)
                elif command is MoonsCommand.EXECUTE:
                    self._armed[address] = None
                else:
                    self._search(searching)  # what comes after them finds them searching
                    searching = []
                    answers += self._obeyed(address, frame, command)
        self._search(searching)
        return [(UnitPlace.of(a).gateway, packed(_frame(a, answer))) for a, answer in answers]

    def _addressed(self, gateway: int, frame: MoonsFrame) -> list[int]:
        if frame.address == BROADCAST:
            line = (gateway, frame.bus)
            return [n for n in self.units if n not in self.unheard and UnitPlace.of(n)[:2] == line]
        number = UnitPlace(gateway, frame.bus, frame.address).number
        return [number] if number in self.units and number not in self.unheard else []

    def _obeyed(
        self, address: int, frame: MoonsFrame, command: MoonsCommand
    ) -> list[tuple[int, MoonsAnswer]]:
        """The answer of an address, where there is one."""
        answer = self._obey(address, frame, command)
        return [] if answer is None else [(address, answer)]

    def _obey(self, address: int, frame: MoonsFrame, command: MoonsCommand) -> MoonsAnswer | None:
        unit, error = self.units[address], MoonsError.NONE
        row = self.row_of[address]
        match command:
            case MoonsCommand.CONFIG_MOTION:
                error = self._load(address, frame)
                if not frame.data[2] & Segment.REPLY and error is MoonsError.NONE:
                    return None
            case MoonsCommand.ABORT:
                self.halt([address])
                unit.state = MoonsState.ABORTED if self.homed[row].all() else MoonsState.UNINITIALISED
            case MoonsCommand.ENABLE_MOVE:
                unit.state = MoonsState.RESTING if unit.state is MoonsState.ABORTED else unit.state
            case MoonsCommand.SERIAL_NUMBER:
                serial = int(self.array.plane.positioner_id[row])
                return MoonsAnswer(frame.data[0], command, 0, self._state(address), error, (serial, 0))
            case MoonsCommand.COUNTER_DEVIATION:
                slip = int(self.slip[row, 0]), int(self.slip[row, 1])
                return MoonsAnswer(frame.data[0], command, 0, self._state(address), error, slip)
            case MoonsCommand.REPEAT | MoonsCommand.REVERSE:
                error = self._again(address, command)
            case MoonsCommand.FREE_BETA | MoonsCommand.FREE_ALPHA:
                error = self._free(address, command, clockwise=bool(frame.data[2]))
            case MoonsCommand.PROTECT_BETA | MoonsCommand.PROTECT_ALPHA:
                error = self._protect(address, command)
            case MoonsCommand.PING:
                error = self._trouble(address)
            case _:
                error = MoonsError.INVALID
        return self._answer(address, frame.data[0], command, error)

    def halt(self, addresses: list[int]) -> None:
        """As of all steppers; what these were about to do or say is dropped."""
        super().halt(addresses)
        self._due = [one for one in self._due if one[1] not in addresses]
        for _, waiting in self._alpha_at:
            for address in set(addresses).intersection(waiting):
                waiting.remove(address)
                self.homed[self.row_of[address]] = False
        for address in addresses:
            self._armed.pop(address, None)
            if self.units[address].state is MoonsState.DATUM_SEARCH:
                self.units[address].state = MoonsState.UNINITIALISED
        for stop in self.array.stops():  # others that now run into these
            self._interrupt(stop)

    def _answer(
        self, address: int, sequence: int, command: MoonsCommand, error: MoonsError = MoonsError.NONE
    ) -> MoonsAnswer:
        alpha, beta = self.array.counts[self.row_of[address]].tolist()
        counters = ALPHA_START + alpha, beta
        return MoonsAnswer(sequence, command, 0, self._state(address), error, counters)

    def _state(self, address: int) -> MoonsState:
        unit, row = self.units[address], self.row_of[address]
        if unit.hit is not None and unit.hit.time_s <= self.time_s + 1e-9:
            return MoonsState.OBSTACLE
        if not self.homed[row].all() and unit.state is not MoonsState.DATUM_SEARCH:
            unit.state = MoonsState.UNINITIALISED
        elif unit.state in READY and address in self._armed:
            return MoonsState.MOVING
        elif unit.state is MoonsState.MOVING and not any(self.moving(row, axis) for axis in (0, 1)):
            unit.state = MoonsState.RESTING
        return unit.state

    def _trouble(self, address: int) -> MoonsError:
        """What a unit in the state of an obstacle has met."""
        hit = self.units[address].hit
        if hit is None or self._state(address) is not MoonsState.OBSTACLE:
            return MoonsError.NONE
        return MoonsError.LIMIT if hit.kind is StopKind.LIMIT else MoonsError.COLLISION

    def _again(self, address: int, command: MoonsCommand) -> MoonsError:
        """The last waveform once more, or back: it starts with the next start."""
        unit = self.units[address]
        may = MoonsState.RESTING, MoonsState.READY_FORWARD, MoonsState.READY_REVERSE
        if self._state(address) not in may or not unit.last:
            return MoonsError.NOT_READY
        if command is MoonsCommand.REPEAT:
            unit.segments, unit.state = list(unit.last), MoonsState.READY_FORWARD
        else:
            unit.segments = [(-alpha, -beta) for alpha, beta in reversed(unit.last)]
            unit.state = MoonsState.READY_REVERSE
        return MoonsError.NONE

    def _free(self, address: int, command: MoonsCommand, *, clockwise: bool) -> MoonsError:
        """An arm that has met something goes a few steps without its interlock."""
        unit, row = self.units[address], self.row_of[address]
        alpha = command is MoonsCommand.FREE_ALPHA
        wanted = MoonsError.LIMIT if alpha else MoonsError.COLLISION
        if self._trouble(address) is not wanted or self.moving(row, 0) or self.moving(row, 1):
            return MoonsError.NOT_READY
        way = np.zeros((1, 2), dtype=np.int64)
        way[0, 0 if alpha else 1] = (-1 if clockwise else 1) * (
            FREE_ALPHA_STEPS if alpha else FREE_BETA_STEPS
        )
        before = self.array.counts[[row]]
        path = np.stack([before, before + way]).astype(np.float64)
        time_s = np.array([[0.0], [np.abs(way).max() / SEARCH_HZ]])
        self.busy_until_s[row] = self.time_s + self.array.go(
            CountPath(np.array([row]), time_s, path), freeing=True
        )
        unit.last = []
        return MoonsError.NONE

    def _protect(self, address: int, command: MoonsCommand) -> MoonsError:
        """The interlock on again: refused where the arm is still at what it has met."""
        unit, row = self.units[address], self.row_of[address]
        error = self._trouble(address)
        if error is MoonsError.NONE:
            return error
        wanted = MoonsError.LIMIT if command is MoonsCommand.PROTECT_ALPHA else MoonsError.COLLISION
        if error is not wanted or self.array.obstructed(row):
            return error
        unit.hit, unit.state = None, MoonsState.RESTING
        return MoonsError.NONE

    def _load(self, address: int, frame: MoonsFrame) -> MoonsError:
        """A segment of a waveform; with the last one all are held against the rules."""
        unit, state = self.units[address], self._state(address)
        if state in (
            MoonsState.MOVING,
            MoonsState.DATUM_SEARCH,
            MoonsState.ABORTED,
            MoonsState.OBSTACLE,
        ):
            return MoonsError.NOT_READY
        if state is MoonsState.UNINITIALISED:
            return MoonsError.NO_DATUM
        steps, flags = decode_segment(frame.data)
        unit.segments = ([] if flags & Segment.FIRST else unit.segments) + [steps]
        unit.state = MoonsState.LOADING
        if flags & Segment.LAST:
            try:
                check_waveform(np.array(unit.segments, dtype=np.int64))
            except InputError:
                unit.segments, unit.state = [], MoonsState.RESTING
                return MoonsError.WAVEFORM
            unit.state = MoonsState.READY_FORWARD
        return MoonsError.NONE

    def _execute(self) -> None:
        """All that are told to, and hold a waveform, start."""
        armed, self._armed = self._armed, {}  # told twice, it starts once
        going = [a for a in armed if self._state(a) in READY]
        if not going:
            return
        rows = np.array([self.row_of[a] for a in going])
        length = max(len(self.units[a].segments) for a in going)
        steps = np.zeros((length, len(going), 2), dtype=np.int64)
        for k, address in enumerate(going):
            unit = self.units[address]
            steps[: len(unit.segments), k] = unit.segments
            end_s = self.time_s + SEGMENT_S * len(unit.segments)
            self.busy_until_s[rows[k]] = end_s
            self._due.append((end_s, address, MoonsCommand.MOTION_FINISHED))
            if unit.state is MoonsState.READY_FORWARD:
                unit.last = unit.segments
            unit.segments, unit.state = [], MoonsState.MOVING
        counts = self.array.counts[rows] + np.concatenate(
            [np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)]
        )
        time_s = np.broadcast_to(SEGMENT_S * np.arange(length + 1.0)[:, None], (length + 1, len(going)))
        self.array.go(CountPath(rows, time_s, counts))
        for stop in self.array.stops():
            self._interrupt(stop)

    def _interrupt(self, stop: InterlockStop) -> None:
        """Units that will meet something on their way: they say so then, and not that they have ended."""
        what = MoonsCommand.ALPHA_LIMIT if stop.kind is StopKind.LIMIT else MoonsCommand.BETA_COLLISION
        for address in [a for a, row in self.row_of.items() if row in stop.rows]:
            unit, row = self.units[address], self.row_of[address]
            if unit.hit is not None:
                continue
            unit.hit, unit.last = stop, []
            self.busy_until_s[row] = np.minimum(self.busy_until_s[row], stop.time_s)
            self._due = [one for one in self._due if one[1:] != (address, MoonsCommand.MOTION_FINISHED)]
            self._due.append((stop.time_s, address, what))

    def _search(self, addresses: list[int]) -> None:
        if not addresses:
            return
        rows = self._rows(addresses)
        for address in addresses:
            self.units[address].state = MoonsState.DATUM_SEARCH
        self.search(rows, 1, SEARCH_HZ)
        self._alpha_at.append((float(self.busy_until_s[rows, 1].max()), addresses))

    def _rows(self, addresses: list[int]) -> Ints:
        return np.array([self.row_of[a] for a in addresses], dtype=np.int64)

    def _search_alpha(self, addresses: list[int]) -> None:
        rows = self._rows(addresses)
        self.search(rows, 0, SEARCH_HZ)
        for address, row in zip(addresses, rows.tolist(), strict=True):
            found = bool(self.homed[row].all())
            end = MoonsCommand.DATUM_FINISHED if found else MoonsCommand.DATUM_TIMEOUT
            self._due.append((float(self.busy_until_s[row].max()) + 1e-3, address, end))

    @property
    def next_s(self) -> float:
        """When something happens by itself; infinity: never."""
        return min([t for t, *_ in self._due] + [t for t, _ in self._alpha_at], default=np.inf)

    def run(self, duration_s: float) -> list[tuple[int, bytes]]:
        """Lets time pass, s, up to the next event at most; what units say unasked."""
        self._execute()
        self.advance(duration_s)
        now = self.time_s + 1e-9
        for due in [one for one in self._alpha_at if one[0] <= now]:
            self._alpha_at.remove(due)
            self._search_alpha(due[1])
        due_now = [one for one in self._due if one[0] <= now]
        self._due = [one for one in self._due if one[0] > now]
        return [
            (UnitPlace.of(a).gateway, packed(_frame(a, self._said(a, what))))
            for _, a, what in due_now
            if a not in self.unheard
        ]

    def _said(self, address: int, what: MoonsCommand) -> MoonsAnswer:
        unit = self.units[address]
        if what is MoonsCommand.DATUM_FINISHED:
            unit.state = MoonsState.AT_DATUM
        elif what is MoonsCommand.DATUM_TIMEOUT:
            unit.state = MoonsState.UNINITIALISED
        return self._answer(address, 0, what)


class VirtualGateways:
    """Implements `fiberloom.drive.moons.link.Gateways`: time passes while a client waits."""

    def __init__(self, bus: MoonsBus, faults: FaultClock) -> None:
        self._bus, self._faults = bus, faults
        self._replies: list[tuple[int, bytes]] = []

    @property
    def time_s(self) -> float:
        """Virtual."""
        return self._bus.time_s

    async def send(self, gateway: int, data: bytes) -> None:
        """To a gateway, at once."""
        self._replies += self._faults.carried(self._bus.take(gateway, data))

    async def receive(self, timeout_s: float) -> list[tuple[int, bytes]]:
        """What was said; else time passes up to the next word, or to the end of the time given."""
        await asyncio.sleep(0)
        end_s = self.time_s + max(timeout_s, 0.0)
        while not self._replies and (left_s := end_s - self.time_s) > 1e-12:
            step_s = min(left_s, max(min(self._faults.next_s, self._bus.next_s) - self.time_s, 1e-6))
            self._replies += self._faults.carried(self._bus.run(step_s))
            self._faults.follow()
        replies, self._replies = self._replies, []
        return replies

    async def close(self) -> None:
        """Nothing to let go of."""


def _frame(address: int, answer: MoonsAnswer) -> MoonsFrame:
    place = UnitPlace.of(address)
    return MoonsFrame(place.bus, ANSWER_PRIORITY << 7 | place.address, answer.data())
