"""Patience for motions to end, and running trajectories under watch.

After START every positioner is polled at once and then once a second. What is found is a `Deviation`; whether
the others go on, and which of them are stopped, is for the watch to say. A link that is down stops no other
positioner: those behind it follow their trajectories to the end, and the plan keeps clear of collisions only
if all do (docs/bus.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from fiberloom import units
from fiberloom.bus.exchange import LONGEST_WAIT_S
from fiberloom.bus.outcome import Outcome, Result, Results, all_of
from fiberloom.bus.protocol import Command, Status
from fiberloom.bus.requests import POLL_TIMEOUT_S, Requests
from fiberloom.bus.trajectory import WireTrajectory
from fiberloom.timing import part

RECONNECT_S = 15.0
"""So long after the planned end a link that is down may take to come back."""
SILENT_POLLS, SILENT_S = 3, 2.0
"""A motion that has not been reported as ended is booked TIMED_OUT after so many polls without an answer,
over so long."""
CONFIRM_S = 0.1
"""A positioner that seems not to move is asked once more after this time: some report late that they move."""

COLLIDED_S = 0.1
"""So long before it says so, a positioner that collided may have come to rest: the control sees that late."""

_SAME_S = 1e-6
"""Less than a tick of any clock."""

# Plain integers: a poll looks at every bit of 500 positioners ten times a second.
_COLLIDED = int(Status.COLLISION)
_COMPLETED = int(Status.DISPLACEMENT_COMPLETED)
# It has lost its supply on the way, and rests somewhere: that is no arrival.
_LOST_WAY = int(Status.ESTIMATED_POSITION)


class DeviationKind(StrEnum):
    """What a positioner does instead of following its trajectory."""

    NOT_STARTED = "did not start"
    REFUSED = "refused to start"
    SILENT = "does not answer"  # its link is up; it may move or not
    LINK_DOWN = "its link is down"  # it follows its trajectory, as far as is known
    LEFT = "left its trajectory"  # came to rest before the end, or has restarted
    COLLIDED = "collided"


HARMLESS = frozenset({DeviationKind.SILENT, DeviationKind.LINK_DOWN})
"""Kinds that do not stop the others where there is no better rule."""


@dataclass(frozen=True, slots=True)
class Deviation:
    """One positioner that does not do its part, or of which it is not known. Times in s after START."""

    positioner: int
    kind: DeviationKind
    time_s: float
    """When it was found."""
    known_s: float = 0.0
    """Until when it was known to follow its trajectory; 0: never."""


@dataclass(frozen=True, slots=True)
class Going:
    """Who follows a trajectory still, as far as is known."""

    time_s: float
    """After START, s."""
    reachable: frozenset[int]
    unreachable: frozenset[int] = frozenset()
    """A link that is down, or no answer: no stop can be counted on."""


@dataclass
class MotionWatch:
    """How a motion is watched. A caller with a better rule overrides `may_go_on` and `chosen`."""

    poll_s: float = 1.0
    """Time between polls; infinity: none, as before START was watched."""
    deviations: list[Deviation] = field(default_factory=list)
    """All that was found so far."""
    stopping: bool = False
    """The motion is to end, as soon as that can be done."""
    on_start: Callable[[float], None] = lambda _: None
    """Told when positioners are told to go; time of the bus, s."""

    async def to_stop(self, deviations: Sequence[Deviation], going: Going) -> frozenset[int]:
        """Which positioners are stopped now: none while the others may go on.

        `deviations`: found by one poll; `going`: all others. Asked again when one of them is reached.
        """
        if deviations and not await self.may_go_on(deviations):
            self.stopping = True
        return await self.chosen(going) if self.stopping else frozenset()

    async def chosen(self, going: Going) -> frozenset[int]:
        """Which are stopped where the motion is to end: all, as far as they can be reached."""
        return going.reachable | going.unreachable

    async def may_go_on(self, deviations: Sequence[Deviation]) -> bool:
        """Whether the other positioners may go on, given what was found by one poll."""
        return all(deviation.kind in HARMLESS for deviation in deviations)


@dataclass(frozen=True)
class Patience:
    """How the end of motions is waited for. Times in s."""

    timeout_s: float = 60.0
    expected_s: float = 0.0
    """The first poll comes after this time."""
    poll_s: float = 0.1
    stop_on_collision: bool = True
    """A collision stops the others too."""


class Arrivals:
    """Polls motions until each has ended, in whatever way."""

    def __init__(self, client: Requests, ids: Iterable[int], waiting: Patience) -> None:
        self.results = all_of(ids, Outcome.TIMED_OUT)
        self._client, self._waiting = client, waiting
        self._active = set(self.results)
        self._silent: dict[int, list[float]] = {}

    async def wait(self) -> Results:
        """The outcome of each. A silent one costs the others nothing: theirs is booked at each poll."""
        client, waiting = self._client, self._waiting
        deadline_s = client.time_s + waiting.timeout_s
        await client.exchange.wait(self._something, min(client.time_s + waiting.expected_s, deadline_s))
        while self._active:
            self._judge(await client.poll(self._active))
            self.results.polls += 1
            if self._active and waiting.stop_on_collision and self._collided():
                await client.abort(self._active)
                self.results.update(all_of(self._active, Outcome.STOPPED))
                break
            if not self._active or self._given_up(deadline_s):
                break
            await client.rest(self._active, client.time_s + waiting.poll_s)
        return self.results

    def _something(self) -> bool:
        """A collision, or a link that has gone down: no reason to rest any longer."""
        collided = not self._client.collided.isdisjoint(self._active)
        return collided or bool(self._client.exchange.cut_off(self._active))

    def _collided(self) -> bool:
        return any(result.outcome is Outcome.COLLIDED for result in self.results.values())

    def _given_up(self, deadline_s: float) -> bool:
        """The deadline is for those that answer; a silent one has its own number of polls."""
        return self._client.time_s >= deadline_s and self._active.isdisjoint(self._silent)

    @part("bus")
    def _judge(self, answers: Results) -> None:
        """Books those whose motion has ended."""
        collided, done, ended = self._client.collided, Outcome.DONE, Results()
        for i, answer in answers.items():
            ok = answer.outcome is done
            bits = answer.values[0] if ok else 0
            if bits & _COLLIDED or i in collided:
                ended[i] = Result(i, Outcome.COLLIDED)
            elif answer.outcome is Outcome.TIMED_OUT:
                if self._silent_for_good(i):
                    ended[i] = answer
            elif not ok:
                ended[i] = answer
            elif bits & _COMPLETED:
                ended[i] = Result(i, Outcome.MISPLACED if bits & _LOST_WAY else done)
            else:
                self._silent.pop(i, None)
        self._book(ended)

    def _book(self, ended: Results) -> None:
        self.results.update(ended)
        self._active.difference_update(ended)
        for positioner in self._silent.keys() & ended.keys():
            del self._silent[positioner]

    def _silent_for_good(self, positioner: int) -> bool:
        polls = self._silent.setdefault(positioner, [])
        polls.append(self._client.time_s)
        return len(polls) >= SILENT_POLLS and polls[-1] - polls[0] + POLL_TIMEOUT_S >= SILENT_S


class _Followers:
    """What polls have shown of positioners that should follow their trajectories."""

    def __init__(self, client: Requests, trajectories: Mapping[int, WireTrajectory], begun_s: float) -> None:
        self._client, self._begun_s = client, begun_s
        self._duration_s = {i: t.duration_s for i, t in trajectories.items()}
        self.answers = Results()
        self.confirmed: set[int] = set()
        """Those that have answered START."""
        self._known_s: dict[int, float] = {}
        self._silent: dict[int, int] = {}
        self._told: dict[int, DeviationKind] = {}

    @property
    def elapsed_s(self) -> float:
        return self._client.time_s - self._begun_s

    async def look(self, ids: set[int]) -> list[Deviation]:
        """Polls these; what is new."""
        self.answers = await self._client.poll(ids)
        early = self._early(ids)
        if early:
            await self._client.sleep(CONFIRM_S)
            self.answers.update(await self._client.poll(early))
        return self._deviations(ids)

    @part("bus")
    def _early(self, ids: set[int]) -> list[int]:
        return [i for i in ids if self._at_rest_early(i)]

    @part("bus")
    def _deviations(self, ids: set[int]) -> list[Deviation]:
        return [found for i in sorted(ids) if (found := self._deviation(i)) is not None]

    def collided(self, ids: set[int]) -> list[Deviation]:
        """Those of these that have said by themselves that they collided."""
        since_s = max(self.elapsed_s - COLLIDED_S, 0.0)
        ids = ids & self._client.collided
        return [Deviation(i, DeviationKind.COLLIDED, self.elapsed_s, since_s) for i in sorted(ids)]

    @property
    def silent(self) -> set[int]:
        """Those that have left two polls in a row without an answer."""
        return {i for i, kind in self._told.items() if kind is DeviationKind.SILENT}

    def _at_rest_early(self, positioner: int) -> bool:
        answer = self.answers[positioner]
        bits = answer.values[0] if answer.ok else 0
        if not bits & (_COMPLETED | _LOST_WAY) or bits & _COLLIDED:
            return False  # nearly all, at every poll
        return bool(bits & _LOST_WAY) or self.elapsed_s < self._duration_s[positioner]

    def _deviation(self, positioner: int) -> Deviation | None:
        kind = self._kind(positioner)
        before = self._told.pop(positioner, None)
        if kind is not None:
            self._told[positioner] = kind
        elif self.answers[positioner].ok:
            self._known_s[positioner] = self.elapsed_s
        if kind is None or kind is before:
            return None
        return Deviation(positioner, kind, self.elapsed_s, self._known_s.get(positioner, 0.0))

    def _kind(self, positioner: int) -> DeviationKind | None:
        answer = self.answers[positioner]
        silent = answer.outcome is Outcome.TIMED_OUT
        self._silent[positioner] = self._silent.get(positioner, 0) + 1 if silent else 0
        if positioner in self._client.collided or (answer.ok and answer.values[0] & _COLLIDED):
            return DeviationKind.COLLIDED
        unheard = positioner not in self.confirmed and positioner not in self._known_s
        if unheard and (silent or answer.outcome is Outcome.DISCONNECTED):
            return DeviationKind.NOT_STARTED  # neither START nor two requests since were answered
        if silent:
            return DeviationKind.SILENT if self._silent[positioner] >= 2 else None
        if answer.outcome is Outcome.DISCONNECTED:
            return DeviationKind.LINK_DOWN
        if not answer.ok:  # the bootloader's status is another
            return DeviationKind.LEFT
        if not self._at_rest_early(positioner):
            return None
        return DeviationKind.LEFT if positioner in self._known_s else DeviationKind.NOT_STARTED


@dataclass(frozen=True)
class Tolerance:
    """What is still an arrival."""

    margin_s: float = 3.0
    """Time allowed beyond the longest trajectory."""
    tolerance_deg: float = 0.1
    """Largest difference of the reported wire position from the end."""


class MotionRun:
    """One START, and all that comes of it, for positioners that hold their trajectories."""

    def __init__(
        self,
        client: Requests,
        trajectories: Mapping[int, WireTrajectory],
        watch: MotionWatch,
        tolerance: Tolerance,
    ) -> None:
        self._client, self._trajectories = client, trajectories
        self._watch, self._tolerance = watch, tolerance
        self.results = all_of(trajectories, Outcome.TIMED_OUT)
        self._let_go: frozenset[int] = frozenset()
        """Those that the rule has let go on, although the motion is to end."""

    async def run(self) -> Results:
        """The outcome of each positioner."""
        client, longest_s = self._client, max(t.duration_s for t in self._trajectories.values())
        self._watch.stopping = False
        self._followers = _Followers(client, self._trajectories, client.time_s)
        if await self._cut_before_start():
            return self.results
        self._watch.on_start(client.time_s)
        started = await client.broadcast(Command.START_TRAJECTORY, self.results, POLL_TIMEOUT_S)
        self._followers.confirmed = set(started.ok_ids)
        until_s = client.time_s + longest_s
        going = await self._follow(started, until_s)
        left_s = max(until_s - client.time_s, 0.0)
        if not going:
            return self.results
        waiting = Patience(left_s + self._tolerance.margin_s, left_s)
        self.results.update(await Arrivals(client, going, waiting).wait())
        await self._when_back()
        await self._check_ends(going)
        return self.results

    async def _cut_before_start(self) -> bool:
        """A START that cannot reach all is not sent. True when that is so."""
        cut = self._client.exchange.cut_off(self.results)
        if cut:
            self.results.update(all_of(self.results, Outcome.STOPPED))
            self.results.update(all_of(cut, Outcome.DISCONNECTED))
            await self._client.abort(i for i in self.results if i not in cut)
        return bool(cut)

    async def _follow(self, started: Results, until_s: float) -> set[int]:
        """Polls until the planned end; those that go on till then, or may: a stop did not reach them."""
        client, poll_s = self._client, self._watch.poll_s
        active = set(self.results)
        refused = [i for i, r in started.items() if r.outcome is Outcome.REFUSED]
        self.results.update({i: started[i] for i in refused})
        found = [Deviation(i, DeviationKind.REFUSED, self._followers.elapsed_s) for i in refused]
        if np.isinf(poll_s):
            return active - set(refused)
        polled_s = -np.inf
        while True:
            now_s = client.time_s
            if collided := self._followers.collided(active):  # at once, before any poll
                found += collided
            elif now_s >= polled_s + poll_s - LONGEST_WAIT_S / 2:
                found += await self._followers.look(active - set(refused))
                polled_s = now_s
            await self._settle(found, active)
            if not active:
                return active
            found = []
            # in the reader's own steps: on a virtual clock the end then comes in the same tick, polled or not
            last = until_s <= now_s + LONGEST_WAIT_S
            ahead_s, early_s = (until_s, 0.0) if last else (now_s + LONGEST_WAIT_S, _SAME_S)
            if not await client.rest(active, ahead_s, early_s) and last:
                return active

    async def _settle(self, found: list[Deviation], active: set[int]) -> None:
        """Asks the rule; takes those out of `active` that do not move, or were stopped."""
        self._watch.deviations += found
        out = [d for d in found if d.kind not in HARMLESS]
        for deviation in out:
            self._book(deviation)
            active.discard(deviation.positioner)
        going = self._going(active)
        if found or (self._watch.stopping and going.reachable - self._let_go):
            stop = await self._watch.to_stop(found, going)
            self._let_go = going.reachable - stop
            # what has deviated holds its trajectory still, and a later START would set it off
            await self._stop(stop, active, [d.positioner for d in out])

    async def _stop(self, stop: frozenset[int], active: set[int], out: list[int]) -> None:
        """Stops these, and those that are `out`; who does not answer stays active: it may go on."""
        asked = [*stop, *out]
        stopped = await self._client.stop_all(ids=asked) if asked else Results()
        for i in stop:
            self.results[i] = Result(i, Outcome.STOPPED) if stopped[i].ok else stopped[i]
            if stopped[i].ok:
                active.discard(i)

    def _going(self, active: set[int]) -> Going:
        """Who is on the way, and who of them can be reached."""
        unreachable = frozenset(active & (self._client.exchange.cut_off(active) | self._followers.silent))
        return Going(self._followers.elapsed_s, frozenset(active) - unreachable, unreachable)

    def _book(self, deviation: Deviation) -> None:
        """What became of one that does not follow its trajectory."""
        i = deviation.positioner
        if deviation.kind is DeviationKind.COLLIDED:
            self.results[i] = Result(i, Outcome.COLLIDED)
        elif deviation.kind is DeviationKind.NOT_STARTED:
            self.results[i] = Result(i, Outcome.NOT_STARTED)
        elif deviation.kind is DeviationKind.LEFT:
            answer = self._followers.answers[i]
            self.results[i] = Result(i, Outcome.MISPLACED) if answer.ok else answer

    async def _when_back(self) -> None:
        """Asks those again whose link was down at the end, once it is up."""
        client = self._client
        cut = [i for i, r in self.results.items() if r.outcome is Outcome.DISCONNECTED]
        if not cut or client.exchange.lost:
            return

        def back() -> bool:
            return not client.exchange.cut_off(cut)

        await client.exchange.wait(back, client.time_s + RECONNECT_S)
        waiting = Patience(self._tolerance.margin_s)
        self.results.update(await Arrivals(client, cut, waiting).wait())

    async def _check_ends(self, going: set[int]) -> None:
        """Reads where they are. What did not answer before, but rests at its end, has arrived."""
        asked = [i for i in self.results if i in going and self.results[i].outcome in _TO_READ]
        # an abort first: without it a positioner that never started may report its goal
        await self._client.abort(asked)
        limit = self._tolerance.tolerance_deg * units.COUNTS_PER_DEG
        for i, where in (await self._client.positions(asked)).items():
            if not where.ok:
                self.results[i] = where
                continue
            ends = zip(where.values, self._trajectories[i].end_counts, strict=True)
            arrived = all(abs(is_at - end) <= limit for is_at, end in ends)
            self.results[i] = Result(i, Outcome.DONE if arrived else Outcome.MISPLACED, values=where.values)


_TO_READ = (Outcome.DONE, Outcome.TIMED_OUT)
