"""MEGARA's controllers in the twin: our frames in, rotors that turn, frames out. No clock of its own."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from fiberloom.drive.megara.frames import (
    MegaraCommand,
    MegaraFrame,
    RotorState,
    ToldState,
    command_of,
    decode_goal,
    number_frame,
    state_frame,
)
from fiberloom.drive.steppers.square import SquareMaker
from fiberloom.errors import InputError
from fiberloom.twin.steppers.array import CountPath, StepperArray
from fiberloom.twin.steppers.bus import StepperBus

BUSES = 4
"""[A] So many, each with a supply of its own; robots by their number in turn."""


def bus_of(robot: int) -> int:
    """Number of the bus of a robot by its own, from 0."""
    return robot % BUSES


class MegaraBus(StepperBus):
    """Robots on a bus: what an outside host would meet."""

    def __init__(self, array: StepperArray) -> None:
        super().__init__(array)
        self._maker = SquareMaker.of(array.plane.instrument, 0.0)
        self._goals: dict[int, dict[int, int]] = {}
        """By address, then rotor."""
        self._lost: set[tuple[int, int]] = set()
        """Row and axis of searches that end without their switch."""

    def send(self, frames: Iterable[tuple[int, bytes]]) -> list[MegaraFrame]:
        """Puts frames (identifier, data) on the bus now, in order; the replies."""
        replies: list[MegaraFrame] = []
        searching: dict[int, list[int]] = {}
        for identifier, data in frames:
            frame = MegaraFrame(identifier, bytes(data))
            try:
                command = command_of(frame)
            except InputError:
                continue
            if command is MegaraCommand.HOME:
                for address in self._addressed(frame):
                    for rotor in _rotors(frame):
                        searching.setdefault(rotor, []).append(address)
                continue
            self._search_all(searching)  # what comes after them finds them searching
            replies += self._obey(frame, command)
        self._search_all(searching)
        return replies

    def _search_all(self, searching: dict[int, list[int]]) -> None:
        """Begins the searches of these addresses by rotor, and forgets them."""
        for rotor, addresses in searching.items():
            self._search(addresses, rotor)
        searching.clear()

    def run(self, duration_s: float) -> list[MegaraFrame]:
        """Lets time pass, s. No robot speaks unasked."""
        self.advance(duration_s)
        return []

    def _addressed(self, frame: MegaraFrame) -> list[int]:
        whom = list(self.row_of) if frame.robot == 0 else [frame.robot]
        return [address for address in whom if address in self.row_of and address not in self.unheard]

    def _obey(self, frame: MegaraFrame, command: MegaraCommand) -> list[MegaraFrame]:
        addresses = self._addressed(frame)
        match command:
            case MegaraCommand.GOAL:
                self._take_goal(frame, addresses)
            case MegaraCommand.START:
                self._start(addresses)
            case MegaraCommand.STOP:
                self.halt(addresses)
            case MegaraCommand.STATE:
                return [self._state(a, rotor) for a in addresses for rotor in _rotors(frame)]
            case MegaraCommand.IDENTIFY:
                return [number_frame(a, 0, command, self._serial(a)) for a in addresses]
            case MegaraCommand.SLIP:
                return [
                    number_frame(a, r, command, int(self.slip[self.row_of[a], r - 1]))
                    for a in addresses
                    for r in _rotors(frame)
                ]
        return []

    def halt(self, addresses: list[int]) -> None:
        """As of all steppers; goals that wait for a start are dropped."""
        super().halt(addresses)
        for address in addresses:
            self._goals.pop(address, None)

    def _serial(self, address: int) -> int:
        return int(self.array.plane.positioner_id[self.row_of[address]])

    def _take_goal(self, frame: MegaraFrame, addresses: list[int]) -> None:
        try:
            goal = decode_goal(frame)
        except InputError:
            return
        for address in addresses:
            for rotor in _rotors(frame):
                self._goals.setdefault(address, {})[rotor] = goal

    def _start(self, addresses: list[int]) -> None:
        """All that have a goal go, unless they have no datum or still move."""
        going = [
            address
            for address in addresses
            if address in self._goals
            and self.homed[self.row_of[address]].all()
            and not any(self.moving(self.row_of[address], axis) for axis in (0, 1))
        ]
        goals, self._goals = self._goals, {a: g for a, g in self._goals.items() if a not in addresses}
        if not going:
            return
        rows = np.array([self.row_of[address] for address in going])
        before = self.array.counts[rows]
        after = before.copy()
        for k, address in enumerate(going):
            for rotor, goal in goals[address].items():
                after[k, rotor - 1] = goal
        leg = self._maker.leg(rows, before, after)
        self.array.go(CountPath(rows, leg.time_s, leg.counts.astype(np.float64)))
        self.busy_until_s[rows] = self.time_s + np.abs(after - before) / self._maker.rate_Hz

    def _search(self, addresses: list[int], rotor: int) -> None:
        rows = np.array([self.row_of[address] for address in addresses], dtype=np.int64)
        axis = rotor - 1
        missed = self.search(rows, axis, float(self._maker.rate_Hz[axis]))
        self._lost -= {(row, axis) for row in rows.tolist()}
        self._lost |= {(row, axis) for row in missed.tolist()}

    def _state(self, address: int, rotor: int) -> MegaraFrame:
        row, axis = self.row_of[address], rotor - 1
        if (row, axis) in self._lost:
            state = RotorState.NO_SWITCH
        elif self.moving(row, axis):
            state = RotorState.MOVING
        else:
            state = RotorState.STILL if self.homed[row, axis] else RotorState.UNKNOWN
        return state_frame(address, rotor, ToldState(state, int(self.array.counts[row, axis])))


def _rotors(frame: MegaraFrame) -> tuple[int, ...]:
    return (1, 2) if frame.rotor == 0 else (frame.rotor,)
