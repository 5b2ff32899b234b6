"""MEGARA's rotors over a bus of our frames: goals, a start for all, and questions until all are still."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from fiberloom.bus.links import LinkPatience
from fiberloom.bus.outcome import Outcome
from fiberloom.bus.transport import Transport
from fiberloom.drive.megara.frames import (
    MegaraCommand,
    MegaraFrame,
    RotorState,
    ToldState,
    command_of,
    decode_number,
    decode_state,
    goal_frames,
)
from fiberloom.drive.steppers.link import Homed, Leg, UnitTold
from fiberloom.errors import InputError

ANSWER_S = 0.5
TRIES = 3
"""Of a question."""
POLL_S = 0.5
"""Between two questions for the end of a search."""
LONGEST_SEARCH_S = 90.0
"""[D] A turn of rotor 1 takes 64.7 s."""
BETA, ALPHA = 2, 1
"""Rotors in the order of a search."""


class MegaraLink:
    """Implements `fiberloom.drive.steppers.StepperLink`."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self._patience = LinkPatience(transport, self.sleep)

    @property
    def time_s(self) -> float:
        """Of the bus."""
        return self.transport.time_s

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, s; what is said meanwhile is dropped."""
        end_s = self.time_s + duration_s
        while (left_s := end_s - self.time_s) > 1e-9:
            await self.transport.receive(left_s)

    async def ask(self, ids: Iterable[int]) -> dict[int, UnitTold]:
        """What these say of themselves; one that does not answer is missing."""
        asked = list(ids)
        states = await self._states(asked)
        numbers = await self._numbers(asked, MegaraCommand.IDENTIFY, 0)
        there = [
            robot for robot in asked if (robot, 1) in states and (robot, 2) in states and robot in numbers
        ]
        return {robot: _told(numbers[robot], states[robot, 1], states[robot, 2]) for robot in there}

    async def _states(self, robots: Sequence[int]) -> dict[tuple[int, int], ToldState]:
        """Of both rotors of each robot that answers."""
        return {
            (frame.robot, frame.rotor): decode_state(frame)
            for frame in await self._asked(robots, MegaraCommand.STATE, 0, 2)
        }

    async def _numbers(self, robots: Sequence[int], command: MegaraCommand, rotor: int) -> dict[int, int]:
        told = await self._asked(robots, command, rotor, 1)
        return {frame.robot: decode_number(frame) for frame in told}

    async def _asked(
        self, robots: Sequence[int], command: MegaraCommand, rotor: int, answers: int
    ) -> list[MegaraFrame]:
        """Answers to a question; who has not given so many is asked again."""
        found: dict[tuple[int, int], MegaraFrame] = {}
        left = list(robots)
        for _ in range(TRIES):
            if not left:
                break
            await self._patience.wait()
            await self._send([MegaraFrame.of(robot, rotor, command) for robot in left])
            end_s = self.time_s + ANSWER_S
            while left and (left_s := end_s - self.time_s) > 1e-9:
                for reply in await self.transport.receive(left_s):
                    frame = MegaraFrame(reply.id, reply.data)
                    if _is(frame, command):
                        found[frame.robot, frame.rotor] = frame
                heard = Counter(robot for robot, _ in found)
                left = [robot for robot in left if heard[robot] < answers]
        return list(found.values())

    async def _send(self, frames: list[MegaraFrame]) -> None:
        await self.transport.send(frames)

    async def run(self, ids: Sequence[int], leg: Leg) -> dict[int, Outcome]:
        """One group of a programme: a message for each rotor, then the start for all."""
        goals = {robot: (int(a), int(b)) for robot, (a, b) in zip(ids, leg.counts[-1], strict=True)}
        await self.stop()  # the start is for all: who still has a goal of a start that never came drops it
        await self._send(goal_frames(goals))
        await self._send([MegaraFrame.of(0, 0, MegaraCommand.START)])
        await self.sleep(leg.duration_s)
        states = await self._states(list(ids))
        return {robot: _ended(goals[robot], states, robot) for robot in ids}

    async def home(self, ids: Sequence[int]) -> dict[int, Homed]:
        """Searches the switches of rotors 2, then of rotors 1; one that does not answer is missing."""
        slips: dict[tuple[int, int], int] = {}
        states: dict[tuple[int, int], ToldState] = {}
        for rotor in (BETA, ALPHA):
            await self._send([MegaraFrame.of(robot, rotor, MegaraCommand.HOME) for robot in ids])
            states |= await self._until_still(ids, rotor)
            told = await self._numbers(ids, MegaraCommand.SLIP, rotor)
            slips |= {(robot, rotor): slip for robot, slip in told.items()}
        rotors = (ALPHA, BETA)
        there = [robot for robot in ids if all((robot, r) in slips and (robot, r) in states for r in rotors)]
        return {
            robot: Homed(
                all(states[robot, rotor].state is RotorState.STILL for rotor in rotors),
                (slips[robot, ALPHA], slips[robot, BETA]),
            )
            for robot in there
        }

    async def _until_still(self, ids: Sequence[int], rotor: int) -> dict[tuple[int, int], ToldState]:
        end_s = self.time_s + LONGEST_SEARCH_S
        while True:
            states = await self._states(ids)
            moving = [
                r for (r, which), one in states.items() if which == rotor and one.state is RotorState.MOVING
            ]
            if not moving or self.time_s > end_s:
                return states
            await self.sleep(POLL_S)

    async def stop(self) -> None:
        """All rotors stop where they are."""
        await self._send([MegaraFrame.of(0, 0, MegaraCommand.STOP)])

    async def close(self) -> None:
        """Closes the bus."""
        await self.transport.close()


def _is(frame: MegaraFrame, command: MegaraCommand) -> bool:
    """Whether a frame is an answer to a question that is understood."""
    try:
        if command_of(frame) is not command:
            return False
        (decode_state if command is MegaraCommand.STATE else decode_number)(frame)
    except InputError:
        return False
    return True


def _told(serial: int, first: ToldState, second: ToldState) -> UnitTold:
    known = {RotorState.STILL, RotorState.MOVING}
    homed = first.state in known and second.state in known
    return UnitTold(
        serial, homed, (first.steps, second.steps), RotorState.MOVING in (first.state, second.state)
    )


def _ended(goal: tuple[int, int], states: dict[tuple[int, int], ToldState], robot: int) -> Outcome:
    told = [states.get((robot, rotor)) for rotor in (ALPHA, BETA)]
    if any(one is None for one in told):
        return Outcome.DISCONNECTED
    there = all(one is not None and one.steps == g for one, g in zip(told, goal, strict=True))
    return Outcome.DONE if there else Outcome.TIMED_OUT
