"""MOONS' units behind their gateways: waveforms are loaded, all start together, and counters tell the end."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from fiberloom.bus.links import LinkPatience, cut_off, links_of
from fiberloom.bus.outcome import Outcome
from fiberloom.drive.moons.frames import (
    ALPHA_START,
    BROADCAST,
    BUSES,
    GATEWAYS,
    MoonsAnswer,
    MoonsCommand,
    MoonsError,
    MoonsState,
    PacketReader,
    Segment,
    UnitPlace,
    command_frame,
    decode_answer,
    packed,
    segment_data,
    unwrapped,
)
from fiberloom.drive.moons.waveform import MOST_SEGMENTS, SEGMENT_S
from fiberloom.drive.steppers import together
from fiberloom.drive.steppers.link import Homed, Leg, UnitTold
from fiberloom.drive.steppers.together import NotStarted, Say, held_as, not_started, unsaid
from fiberloom.errors import InputError
from fiberloom.typing import Ints

ANSWER_S = 0.5
TRIES = 3
LONGEST_SEARCH_S = 120.0
"""[D] The whole range of alpha at the speed of a start takes 82 s."""
SETTLE_S = 0.05
MIDDLE = -ALPHA_START, 0
"""Counts about which counters are read: all that arms can reach are within 16 bits of these."""
LOADED = {MoonsState.READY_FORWARD, MoonsState.READY_REVERSE}
"""Of a unit that holds a waveform and stands."""
SEARCHED = {MoonsCommand.DATUM_FINISHED, MoonsCommand.DATUM_TIMEOUT}
FREE_TRIES, FREE_S = 6, 0.05
"""Tries (ukatc/fpu_driver), and s that the steps of one take."""
NONE, ENDS = Segment(0), Segment.LAST | Segment.REPLY


class Gateways(Protocol):
    """Connections to the gateways. Their clock may be virtual."""

    @property
    def time_s(self) -> float:
        """Never runs backwards."""
        ...

    async def send(self, gateway: int, data: bytes) -> None:
        """Bytes to a gateway, 0 to 2; lost where it has no power."""
        ...

    async def receive(self, timeout_s: float) -> list[tuple[int, bytes]]:
        """What gateways have said; waits up to `timeout_s` for anything."""
        ...

    async def close(self) -> None:
        """Lets go."""
        ...


class MoonsLink:
    """Implements `fiberloom.drive.steppers.StepperLink`."""

    def __init__(self, gateways: Gateways) -> None:
        self.gateways = gateways
        self._patience = LinkPatience(gateways, self.sleep)
        self._readers = [PacketReader() for _ in range(GATEWAYS)]
        self._sequence = 0

    @property
    def time_s(self) -> float:
        """Of the gateways."""
        return self.gateways.time_s

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, s; what is said meanwhile is dropped."""
        end_s = self.time_s + duration_s
        while (left_s := end_s - self.time_s) > 1e-9:
            await self._heard(left_s)

    async def _heard(self, timeout_s: float) -> list[tuple[int, MoonsAnswer]]:
        """Answers by number of the unit."""
        out = []
        for gateway, data in await self.gateways.receive(timeout_s):
            for frame in self._readers[gateway].feed(data):
                try:
                    answer = decode_answer(frame)
                    out.append((UnitPlace(gateway, frame.bus, frame.address).number, answer))
                except InputError:
                    continue
        return out

    async def _send(self, commands: Iterable[tuple[int, MoonsCommand, bytes]]) -> None:
        streams = [bytearray() for _ in range(GATEWAYS)]
        for number, command, data in commands:
            self._sequence += 1
            place = UnitPlace.of(number)
            streams[place.gateway] += packed(command_frame(place, self._sequence, command, data))
        for gateway, stream in enumerate(streams):
            if stream:
                await self.gateways.send(gateway, bytes(stream))

    async def _to_all(self, command: MoonsCommand) -> None:
        """To every bus."""
        for gateway in range(GATEWAYS):
            frames = [command_frame(UnitPlace(gateway, bus, BROADCAST), 0, command) for bus in range(BUSES)]
            await self.gateways.send(gateway, b"".join(map(packed, frames)))

    async def _asked(
        self, ids: Iterable[int], command: MoonsCommand, data: bytes = b""
    ) -> dict[int, MoonsAnswer]:
        """Answers to a command; who has not answered is asked again."""
        found: dict[int, MoonsAnswer] = {}
        left = set(ids)
        for _ in range(TRIES):
            if not left:
                break
            await self._patience.wait()
            await self._send((number, command, data) for number in sorted(left))
            found |= await self._until(left, {command}, ANSWER_S)
            left -= set(found)
        return found

    async def _until(
        self, ids: set[int], kinds: set[MoonsCommand], timeout_s: float
    ) -> dict[int, MoonsAnswer]:
        """The first answer of these kinds of each, or what came in time."""
        found: dict[int, MoonsAnswer] = {}
        end_s = self.time_s + timeout_s
        while len(found) < len(ids) and (left_s := end_s - self.time_s) > 1e-9:
            for number, answer in await self._heard(left_s):
                if number in ids and answer.command in kinds:
                    found.setdefault(number, answer)
        return found

    async def ask(self, ids: Iterable[int]) -> dict[int, UnitTold]:
        """What these say of themselves; one that does not answer is missing."""
        told = await self._asked(ids, MoonsCommand.PING)
        serials = await self._asked(told, MoonsCommand.SERIAL_NUMBER)
        return {
            number: UnitTold(
                serials[number].counters[0],
                answer.state not in (MoonsState.UNINITIALISED, MoonsState.DATUM_SEARCH),
                _counts(answer),
                answer.state in (MoonsState.MOVING, MoonsState.DATUM_SEARCH),
            )
            for number, answer in told.items()
            if number in serials
        }

    async def run(self, ids: Sequence[int], leg: Leg, say: Say = unsaid) -> dict[int, Outcome]:
        """Loads a waveform into each, starts all and waits. Nothing starts where one does not hold it.

        Nothing starts either where the connection to a gateway of `ids` is down; where one does not confirm
        the start of the `leg`, all stop. `say` is told which.
        """
        await self.stop()  # the start is for all: who still holds a waveform that never ran drops it
        ready = await self._load(ids, leg)
        missing = {n for n in ids if n not in ready or ready[n].error is not MoonsError.NONE}
        if missing:
            why = {n: Outcome.REFUSED if n in ready else Outcome.DISCONNECTED for n in missing}
            return {number: why.get(number, Outcome.STOPPED) for number in ids}
        goals = {number: (int(a), int(b)) for number, (a, b) in zip(ids, leg.counts[-1], strict=True)}
        end_s = self.time_s + leg.duration_s + SETTLE_S
        late = await self._start(ids, say)
        if late is None:
            await self.sleep(end_s - self.time_s)
        told = await self._asked(ids, MoonsCommand.PING) if late is None else await self._hold(ids)
        ended = {number: _ended(goals[number], told.get(number), number, late) for number in ids}
        met = {number: told[number] for number, how in ended.items() if how is Outcome.COLLIDED}
        await self._free(met, dict(zip(ids, leg.counts.swapaxes(0, 1), strict=True)))
        return ended

    async def _start(self, ids: Sequence[int], say: Say) -> NotStarted | None:
        """Starts all of `ids`; None: they go. Else who does not, and the others are to be held."""
        return await together.start(
            self.gateways, ids, lambda: self._to_all(MoonsCommand.EXECUTE), lambda: self._late(ids), say
        )

    async def _late(self, ids: Sequence[int]) -> NotStarted:
        """Who has not started: units say so, or none behind their gateway answers."""
        left, stand = set(ids), set[int]()
        for _ in range(TRIES):
            reached = left - cut_off(self.gateways, left)  # others move: no link is waited for
            if not reached:
                break
            await self._send((number, MoonsCommand.PING, b"") for number in sorted(reached))
            told = await self._until(reached, {MoonsCommand.PING}, ANSWER_S)
            stand |= {number for number, answer in told.items() if answer.state in LOADED}
            stand -= (gone := {number for number, answer in told.items() if answer.state not in LOADED})
            left -= gone
            if stand:
                await self.sleep(SETTLE_S)
        return not_started(ids, stand, left - stand, self._line)

    def _line(self, number: int) -> str:
        gateway = UnitPlace.of(number).gateway
        links = links_of(self.gateways)
        return f"gateway {gateway + 1}" + (f" ({links[gateway].name})" if links else "")

    async def _hold(self, ids: Sequence[int]) -> dict[int, MoonsAnswer]:
        """Stops all, where they have not started together; what they say then."""
        await together.hold(self.stop, self._patience)
        return await self._asked(ids, MoonsCommand.PING)

    async def _free(self, met: dict[int, MoonsAnswer], ways: dict[int, Ints]) -> None:
        """Those that have `met` something go a few steps at a time until their interlocks agree.

        `ways` (C, 2): counts that each was to go through. First back where it came from, then the other way,
        for only one axis is freed; one that is not free then stays where it is.
        """
        clockwise = {
            n: _came_rising(_counts(one), ways[n], 0 if one.error is MoonsError.LIMIT else 1)
            for n, one in met.items()
        }
        for k in range(3 * FREE_TRIES):
            if not met:
                return
            back = k < FREE_TRIES
            await self._send(
                (
                    n,
                    MoonsCommand.FREE_ALPHA if one.error is MoonsError.LIMIT else MoonsCommand.FREE_BETA,
                    bytes([clockwise[n] == back]),
                )
                for n, one in met.items()
            )
            await self.sleep(FREE_S)
            for command in (MoonsCommand.PROTECT_BETA, MoonsCommand.PROTECT_ALPHA):
                met = {n: one for n, one in (await self._asked(met, command)).items() if one.error}

    async def reverse(self, ids: Sequence[int], say: Say = unsaid) -> dict[int, Outcome]:
        """Units `ids` go their last waveform back, all at once: a field returns to where it began.

        Nothing starts where one cannot; gateways and `say` as in `run`.
        """
        begin = await self._asked(ids, MoonsCommand.PING)
        ready = await self._asked(ids, MoonsCommand.REVERSE)
        if not all(n in ready and ready[n].error is MoonsError.NONE for n in ids):
            await self.stop()
            missing = {n: Outcome.REFUSED if n in ready else Outcome.DISCONNECTED for n in ids}
            return {n: missing[n] if n not in ready or ready[n].error else Outcome.STOPPED for n in ids}
        if (late := await self._start(ids, say)) is not None:
            held = await self._hold(ids)
            return {number: held_as(number, number in held, late) for number in ids}
        await self._until(set(ids), {MoonsCommand.MOTION_FINISHED}, MOST_SEGMENTS * SEGMENT_S + SETTLE_S)
        told = await self._asked(begin, MoonsCommand.PING)
        return {
            n: Outcome.DISCONNECTED
            if n not in told
            else Outcome.COLLIDED
            if told[n].error
            else Outcome.DONE
            if told[n].state is MoonsState.RESTING
            else Outcome.TIMED_OUT
            for n in ids
        }

    async def _load(self, ids: Sequence[int], leg: Leg) -> dict[int, MoonsAnswer]:
        """The answer of each to its last segment."""
        steps = np.diff(leg.counts, axis=0)
        found: dict[int, MoonsAnswer] = {}
        left = dict(zip(ids, range(len(ids)), strict=True))
        for _ in range(TRIES):
            if not left:
                break
            await self._send(
                (number, MoonsCommand.CONFIG_MOTION, data)
                for number, k in left.items()
                for data in _segments(steps[:, k])
            )
            found |= await self._until(set(left), {MoonsCommand.CONFIG_MOTION}, ANSWER_S)
            left = {number: k for number, k in left.items() if number not in found}
        return found

    async def home(self, ids: Sequence[int]) -> dict[int, Homed]:
        """Searches both switches of all at once; one that does not answer is missing."""
        there = set(await self._asked(ids, MoonsCommand.PING))  # none waits for one that is silent
        await self._send((number, MoonsCommand.FIND_DATUM, b"\0") for number in sorted(there))
        told = await self._until(there, SEARCHED, LONGEST_SEARCH_S)
        told |= await self._asked(there - set(told), MoonsCommand.PING)  # whose word was lost
        slips = await self._asked(told, MoonsCommand.COUNTER_DEVIATION)
        return {
            number: Homed(answer.state is MoonsState.AT_DATUM, slips[number].counters)
            for number, answer in told.items()
            if number in slips
        }

    async def stop(self) -> None:
        """Aborts all motion, and lets units move again."""
        await self._to_all(MoonsCommand.ABORT)
        await self._to_all(MoonsCommand.ENABLE_MOVE)

    async def stop_told(self, within_s: float) -> dict[int, bool]:
        """As `stop`; by number of each unit that says so `within_s` whether it moves still."""
        await self.stop()
        moving: dict[int, bool] = {}
        end_s = self.time_s + within_s
        while (left_s := end_s - self.time_s) > 1e-9:
            for number, answer in await self._heard(left_s):
                if answer.command in (MoonsCommand.ABORT, MoonsCommand.ENABLE_MOVE):
                    moving[number] = answer.state in (MoonsState.MOVING, MoonsState.DATUM_SEARCH)
        return moving

    async def close(self) -> None:
        """Lets go of the gateways."""
        await self.gateways.close()


def _counts(answer: MoonsAnswer) -> tuple[int, int]:
    """Counts from the datum, by counters of 16 bits."""
    shown = answer.counters
    return unwrapped(shown[0] - ALPHA_START, MIDDLE[0]), unwrapped(shown[1], MIDDLE[1])


def _ended(
    goal: tuple[int, int], answer: MoonsAnswer | None, number: int, late: NotStarted | None
) -> Outcome:
    """`late`: those for which all were stopped; None: none was."""
    if answer is None:
        return Outcome.DISCONNECTED
    if _counts(answer) == goal and answer.state is MoonsState.RESTING:
        return Outcome.DONE
    if answer.error:
        return Outcome.COLLIDED
    return Outcome.TIMED_OUT if late is None else held_as(number, True, late)


def _came_rising(here: tuple[int, int], way: Ints, axis: int) -> bool:
    """Whether an axis was counting upwards where it has stopped on its way (C, 2): it is freed clockwise.

    One that stood is freed towards the datum, where its arm is folded.
    """
    off = np.abs(way - here).sum(axis=1)
    k = int(np.argmin(off[:-1] + off[1:]))
    change = way[k + 1, axis] - way[k, axis]
    return bool(change > 0 if change else here[axis] > 0)


def _segments(steps: Ints) -> list[bytes]:
    """Data of CONFIG_MOTION for the steps (K, 2) of a unit.

    With the rests at its end: backwards, they make it wait for those that it waited for.
    """
    last = len(steps) - 1
    return [
        segment_data(
            (int(a), int(b)),
            (Segment.FIRST if k == 0 else NONE) | (ENDS if k == last else NONE),
        )
        for k, (a, b) in enumerate(steps.tolist())
    ]
