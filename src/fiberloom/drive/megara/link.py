"""MEGARA's rotors over a bus of our frames: goals, a start for all, and questions until all are still."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from fiberloom.bus.links import LinkPatience, cut_off
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
from fiberloom.drive.steppers import together
from fiberloom.drive.steppers.link import Homed, Leg, UnitTold
from fiberloom.drive.steppers.together import NotStarted, Say, held_as, line_of, not_started, unsaid
from fiberloom.errors import InputError

ANSWER_S = 0.5
TRIES = 3
"""Of a question."""
POLL_S = 0.5
"""Between two questions whether a motion has ended."""
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

    async def _states(self, robots: Sequence[int], patient: bool = True) -> dict[tuple[int, int], ToldState]:
        """Of both rotors of each robot that answers; `patient` as for any question."""
        return {
            (frame.robot, frame.rotor): decode_state(frame)
            for frame in await self._asked(robots, MegaraCommand.STATE, 0, 2, patient)
        }

    async def _numbers(self, robots: Sequence[int], command: MegaraCommand, rotor: int) -> dict[int, int]:
        told = await self._asked(robots, command, rotor, 1)
        return {frame.robot: decode_number(frame) for frame in told}

    async def _asked(
        self,
        robots: Sequence[int],
        command: MegaraCommand,
        rotor: int,
        answers: int,
        patient: bool = True,
    ) -> list[MegaraFrame]:
        """Answers to a question; who has not given so many is asked again.

        `patient`: a link that is down is waited for; else who is behind it is not asked: others move.
        """
        found: dict[tuple[int, int], MegaraFrame] = {}
        left = list(robots)
        for _ in range(TRIES):
            if not left:
                break
            if patient:
                await self._patience.wait()
            cut = set() if patient else cut_off(self.transport, left)
            if cut.issuperset(left):
                break
            await self._send([MegaraFrame.of(robot, rotor, command) for robot in left if robot not in cut])
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

    async def run(self, ids: Sequence[int], leg: Leg, say: Say = unsaid) -> dict[int, Outcome]:
        """One group of a programme: a message for each rotor, then the start for all.

        Nothing starts where a link to one of `ids` is down; where one has not started on the `leg`, or all
        of a port are silent, all stop. `say` is told which.
        """
        goals = {robot: (int(a), int(b)) for robot, (a, b) in zip(ids, leg.counts[-1], strict=True)}
        await self.stop()  # the start is for all: who still has a goal of a start that never came drops it
        await self._send(goal_frames(goals))
        end_s = self.time_s + leg.duration_s
        going = [robot for robot, way in zip(ids, _goes(leg), strict=True) if way]
        start = MegaraFrame.of(0, 0, MegaraCommand.START)
        late = await together.start(
            self.transport, going, lambda: self._send([start]), lambda: self._late(goals, going), say
        )
        if late is None:
            await self.sleep(end_s - self.time_s)
            states = await self._until_still(ids, (ALPHA, BETA), leg.duration_s)  # the start may come late
        else:
            await together.hold(self.stop, self._patience)
            states = await self._states(ids)
        return {robot: _ended(goals[robot], states, robot, late) for robot in ids}

    async def _late(self, goals: dict[int, tuple[int, int]], going: Sequence[int]) -> NotStarted:
        """Who of those that are `going` has not started: robots say so, or none of their port answers."""
        states = await self._states(going, patient=False)
        silent = {n for n in going if (n, ALPHA) not in states or (n, BETA) not in states}
        stand = {
            robot
            for robot in set(going) - silent
            if not any(_moves(states[robot, rotor]) for rotor in (ALPHA, BETA))
            and not _there(goals[robot], states, robot)
        }
        return not_started(going, stand, silent, lambda number: line_of(self.transport, number))

    async def home(self, ids: Sequence[int]) -> dict[int, Homed]:
        """Searches the switches of rotors 2, then of rotors 1; one that does not answer is missing."""
        slips: dict[tuple[int, int], int] = {}
        states: dict[tuple[int, int], ToldState] = {}
        for rotor in (BETA, ALPHA):
            await self._send([MegaraFrame.of(robot, rotor, MegaraCommand.HOME) for robot in ids])
            states |= await self._until_still(ids, (rotor,), LONGEST_SEARCH_S)
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

    async def _until_still(
        self, ids: Sequence[int], rotors: Sequence[int], within_s: float
    ) -> dict[tuple[int, int], ToldState]:
        """What robots say once none of these rotors moves, or after `within_s`."""
        end_s = self.time_s + within_s
        while True:
            states = await self._states(ids)
            moves = any(rotor in rotors and _moves(one) for (_, rotor), one in states.items())
            if not moves or self.time_s > end_s:
                return states
            await self.sleep(POLL_S)

    async def stop(self) -> None:
        """All rotors stop where they are."""
        await self._send([MegaraFrame.of(0, 0, MegaraCommand.STOP)])

    async def stop_told(self, within_s: float) -> dict[int, bool]:
        """As `stop`; by number of each robot that says so `within_s` whether it moves still."""
        await self.stop()
        await self._send([MegaraFrame.of(0, 0, MegaraCommand.STATE)])
        moving: dict[int, bool] = {}
        end_s = self.time_s + within_s
        while (left_s := end_s - self.time_s) > 1e-9:
            for reply in await self.transport.receive(left_s):
                frame = MegaraFrame(reply.id, reply.data)
                if _is(frame, MegaraCommand.STATE):
                    moving[frame.robot] = moving.get(frame.robot, False) or _moves(decode_state(frame))
        return moving

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


def _goes(leg: Leg) -> list[bool]:
    """(m,) whether each has a way in a leg."""
    return [bool(way) for way in (leg.counts[-1] != leg.counts[0]).any(axis=1)]


def _moves(told: ToldState) -> bool:
    return told.state is RotorState.MOVING


def _there(goal: tuple[int, int], states: dict[tuple[int, int], ToldState], robot: int) -> bool:
    """At its goal, and at rest: one on its way counts where it will end."""
    return all(
        states[robot, rotor].steps == steps and not _moves(states[robot, rotor])
        for rotor, steps in zip((ALPHA, BETA), goal, strict=True)
    )


def _ended(
    goal: tuple[int, int],
    states: dict[tuple[int, int], ToldState],
    robot: int,
    late: NotStarted | None,
) -> Outcome:
    """`late`: those for which all were stopped; None: none was."""
    if (robot, ALPHA) not in states or (robot, BETA) not in states:
        return Outcome.DISCONNECTED
    if _there(goal, states, robot):
        return Outcome.DONE
    return Outcome.TIMED_OUT if late is None else held_as(robot, True, late)
