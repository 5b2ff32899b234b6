"""The rule of a motion in which a positioner does not do its part: who goes on, and who is stopped?

Stopping half of a verified motion is what collides: what cannot be reached goes on, among arms that were
stopped in its way. Going on past an arm that is not where the plan has it collides too. So the verifier
decides, for the places where that arm may be.
"""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from fiberloom.bus.motion import Deviation, DeviationKind, Going, MotionWatch
from fiberloom.instruments import FocalPlane
from fiberloom.operation.safety.choice import Choice, Choosing, cut_off_at, meeting
from fiberloom.planning import Plan, Trajectory
from fiberloom.typing import Floats, Ints

STOPS = 7
"""Places along its trajectory at which a positioner may have come to rest that are tried."""

CHOOSING_S = 0.3
"""What a choice may take."""
STOPPING_S = 0.3
"""So long after a stop is sent a positioner is at rest: the bus, the motor."""
CHOICES = 3
"""So often a choice is made anew that took longer than it allowed for."""

AT_ITS_START = frozenset({DeviationKind.NOT_STARTED, DeviationKind.REFUSED})


class MotionRule(MotionWatch):
    """Lets a motion go on where the verifier proves it safe with the deviating positioners where they are.

    A link that is down stops none: what is behind it follows the plan, which is proven. For one that is
    silent both are proven: that it goes on, by the plan, and that it came to rest anywhere since it was
    last known to move. A collision stops all; while one cannot be reached, as many as can be stopped
    so that no arms meet, and the others as soon as all can be reached again.
    """

    def __init__(
        self,
        plane: FocalPlane,
        planned: Plan,
        event: Callable[[str, str, int | None], None],
        clock: Callable[[], float],
        poll_s: float = 1.0,
    ) -> None:
        """`plane`: N positioners, with the obstacles of the plan; `planned`: the motion that runs; `event`:
        records kind, text and positioner; `clock`: time of the bus, s; `poll_s`: time between polls, s."""
        super().__init__(poll_s)
        self._plane, self._planned, self._event, self._clock = plane, planned, event, clock
        self._rests: dict[int, list[Trajectory]] = {}

    async def may_go_on(self, deviations: Sequence[Deviation]) -> bool:
        """Whether the others may go on with these positioners, and those before, where they may be."""
        for d in deviations:
            self._event("deviation", f"{d.kind.value}, {d.time_s:.1f} s after START", d.positioner)
        doubtful = [d for d in deviations if d.kind is not DeviationKind.LINK_DOWN]
        if not doubtful:
            return True
        if any(d.kind is DeviationKind.COLLIDED for d in deviations):
            self._rests |= {d.positioner: self._resting(d) for d in doubtful}
            return False
        proven = await asyncio.to_thread(self._is_proven_with, doubtful)
        for d in doubtful:
            text = "the others go on: proven clear of it" if proven else "not proven clear of it"
            self._event("deviation", text, d.positioner)
        return proven

    async def chosen(self, going: Going) -> frozenset[int]:
        """Those whose stop leaves no arm in the way of another; all, where all can be reached.

        Where no choice is proven, the one with the fewest contacts, and an alarm.
        """
        all_ids = going.reachable | going.unreachable
        if not going.unreachable:
            self._event("deviation", f"all {len(all_ids)} on the way are stopped", None)
            return all_ids
        choice, stopped_s = await self._in_time(going)
        for kind, text in _told(choice, going):
            self._event(kind, text, None)
        self._rests |= self._stopped_at(choice.stop, stopped_s)
        # one that gives no answer may hear nevertheless
        return all_ids if choice.stop == going.reachable else choice.stop

    def _is_proven_with(self, doubtful: Sequence[Deviation]) -> bool:
        self._rests |= {d.positioner: self._resting(d) for d in doubtful}
        return self.is_proven()

    def _resting(self, deviation: Deviation) -> list[Trajectory]:
        """Its trajectory, cut off where it may have come to rest."""
        row = int(self._plane.index_of(deviation.positioner))
        whole = self._planned.robots[row]
        if deviation.kind in AT_ITS_START:
            return cut_off_at(whole, np.zeros(1)) * STOPS
        # a restart drops what the motor had still to go: it may rest a little later than it was seen
        collided = deviation.kind is DeviationKind.COLLIDED
        last_s = deviation.time_s + (0.0 if collided else self.poll_s / 2)
        return cut_off_at(whole, np.linspace(deviation.known_s, last_s, STOPS))

    def is_proven(self) -> bool:
        """True when nothing meets the positioners that may rest, wherever they do."""
        rows = self._around(self.resting_rows())
        worlds = ({i: places[k] for i, places in self._rests.items()} for k in range(STOPS))
        return not any(meeting(self._plane, self._planned, rows, world) for world in worlds)

    def resting_rows(self) -> Ints:
        """Rows of the positioners that may be at rest."""
        return np.atleast_1d(self._plane.index_of(np.array(sorted(self._rests), dtype=np.int64)))

    # who is stopped

    async def _in_time(self, going: Going) -> tuple[Choice, Floats]:
        """A choice, and the times after START in s at which those it stops may come to rest.

        Arms go on while it is made. One that took longer than it allowed for is made anew, with twice
        the time.
        """
        choosing_s = CHOOSING_S
        for _ in range(CHOICES):
            began_s = self._clock()
            stopped_s = going.time_s + np.linspace(0.0, choosing_s + STOPPING_S, STOPS)
            choice = await asyncio.to_thread(self.best, going, stopped_s)
            took_s = self._clock() - began_s
            if took_s <= choosing_s:
                return choice, stopped_s
            going = dataclasses.replace(going, time_s=going.time_s + took_s)
            choosing_s = 2.0 * took_s
        text = f"the choice of who is stopped took {took_s:.1f} s: arms may be further than it was proven for"
        self._event("alarm", text, None)
        return choice, stopped_s

    def best(self, going: Going, stopped_s: Floats) -> Choice:
        """Who is stopped; `stopped_s`: (STOPS,) s after START, when those may come to rest."""
        return Choosing(self._plane, self._planned, going, stopped_s, self._rests).best()

    def _stopped_at(self, stop: Iterable[int], stopped_s: Floats) -> dict[int, list[Trajectory]]:
        """Places of those that come to rest at these times."""
        rows = self._plane.index_of(np.array(sorted(stop), dtype=np.int64))
        robots = [self._planned.robots[row] for row in np.atleast_1d(rows)]
        return {r.positioner_id: cut_off_at(r, stopped_s) for r in robots}

    def _around(self, rows: Ints) -> Ints:
        """These rows and those whose arms can meet theirs: all other pairs are proven by the plan."""
        pairs = self._plane.neighbour_pairs()
        near = pairs[np.isin(pairs, rows).any(axis=1)]
        return np.union1d(near.ravel(), rows)


def _told(choice: Choice, going: Going) -> Iterator[tuple[str, str]]:
    """Kinds and texts of the events of a choice."""
    on = len(going.reachable) - len(choice.stop)
    unreached = ", ".join(map(str, sorted(going.unreachable)))
    text = f"{len(choice.stop)} are stopped, {on} go on; no stop reaches {unreached}"
    yield "deviation", f"{text}: {'not ' if choice.contacts else ''}proven clear of contacts"
    if choice.contacts:
        found = "; ".join(map(str, choice.contacts[:3]))
        yield "alarm", f"in every choice of those to stop arms may touch; in this one: {found}"
