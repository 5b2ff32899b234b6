"""The rule of a motion in which a positioner does not do its part: who goes on, and who is stopped?

Stopping half of a verified motion is what collides: what cannot be reached goes on, among arms that were
stopped in its way. Going on past an arm that is not where the plan has it collides too. So the verifier
decides, for the places where that arm may be.

Where one cannot be reached, the rule looks for the largest part of the others that can be stopped. All
pairs that go on are proven by the plan, and two at rest stay apart; so only pairs of one that rests and one
that goes on count. Of such a pair the one that was stopped is let go on, until none meet. One that is let go
had to be, whatever the others do: it was in the way of one that goes on in every choice. So where
any choice is free of contacts this one is.
"""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.bus.motion import RECONNECT_S, Deviation, DeviationKind, Going, MotionWatch
from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan, Trajectory, Violation, verify
from fiberloom.typing import Ints

STOPS = 7
"""Places along its trajectory at which a positioner may have come to rest that are tried."""

STOPPED_S = 0.5
"""So long after the choice one that is stopped is at rest: the verifier, the bus, the motor."""

AT_ITS_START = frozenset({DeviationKind.NOT_STARTED, DeviationKind.REFUSED})


@dataclass(frozen=True)
class Choice:
    """Who is stopped, and what the verifier finds then."""

    stop: frozenset[int]
    contacts: tuple[Violation, ...] = ()


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
        poll_s: float = 1.0,
    ) -> None:
        """`plane`: N positioners, with the obstacles of the plan; `planned`: the motion that runs; `event`:
        records kind, text and positioner; `poll_s`: time between polls, s."""
        super().__init__(poll_s)
        self._plane, self._planned, self._event = plane, planned, event
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
        choice = await asyncio.to_thread(self.best, going)
        for kind, text in _told(choice, going):
            self._event(kind, text, None)
        self._rests |= self._stopped_at(choice.stop, going)
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
            return [cut_off_at(whole, 0.0)] * STOPS
        # a restart drops what the motor had still to go: it may rest a little later than it was seen
        collided = deviation.kind is DeviationKind.COLLIDED
        last_s = deviation.time_s + (0.0 if collided else self.poll_s / 2)
        return [cut_off_at(whole, t) for t in np.linspace(deviation.known_s, last_s, STOPS)]

    def is_proven(self) -> bool:
        """True when nothing meets the positioners that may rest, wherever they do."""
        rows = self._around(self.resting_rows())
        return not any(
            self._meeting(rows, {i: places[k] for i, places in self._rests.items()}) for k in range(STOPS)
        )

    def resting_rows(self) -> Ints:
        """Rows of the positioners that may be at rest."""
        return np.atleast_1d(self._plane.index_of(np.array(sorted(self._rests), dtype=np.int64)))

    # who is stopped

    def best(self, going: Going) -> Choice:
        """The largest part of the reachable ones that can be stopped without a contact.

        Where there is none, the better one of those that were tried.
        """
        tried = [self._with(going.reachable, going)]
        while tried[-1].contacts:
            stop = tried[-1].stop
            in_the_way = {i for contact in tried[-1].contacts for i in self._stopped_of(contact, stop)}
            if not in_the_way:
                break
            tried.append(self._with(stop - in_the_way, going))
        return min(tried, key=_rank)

    def _stopped_of(self, contact: Violation, stop: frozenset[int]) -> list[int]:
        """Of a contact the one that was stopped, if the other one is on its way."""
        pair = _pair(contact)
        mixed = len(pair & stop) == 1 and not (pair - stop) & self._rests.keys()
        return list(pair & stop) if mixed else []

    def _with(self, stop: frozenset[int], going: Going) -> Choice:
        """What the verifier finds where these are stopped now and the others go on."""
        rests = self._places(stop, going)
        pairs = self._plane.neighbour_pairs()
        ids = self._plane.positioner_id[pairs]
        mixed = np.isin(ids, list(rests)).any(axis=1) & ~np.isin(ids, list(stop)).all(axis=1)
        found = {}
        for robots in self._worlds(rests, going):
            for contact in self._meeting(np.unique(pairs[mixed]), robots):
                found[_pair(contact)] = contact
        return Choice(stop, tuple(found.values()))

    def _places(self, stop: frozenset[int], going: Going) -> dict[int, list[Trajectory]]:
        """STOPS places for each that is at rest then, or may be."""
        known = {i: rests for i, rests in self._rests.items() if i not in going.reachable}
        return self._stopped_at(stop, going) | known

    def _stopped_at(self, stop: frozenset[int], going: Going) -> dict[int, list[Trajectory]]:
        """Places of those that are stopped now."""
        when_s = np.linspace(going.time_s, going.time_s + STOPPED_S, STOPS)
        robots = {r.positioner_id: r for r in self._planned.robots}
        return {i: [cut_off_at(robots[i], t) for t in when_s] for i in stop}

    def _worlds(self, rests: dict[int, list[Trajectory]], going: Going) -> Iterator[dict[int, Trajectory]]:
        """By positioner, what differs from the plan: each of the places, and that who may go on does."""
        for k in range(STOPS):
            yield {i: places[k] for i, places in rests.items()}
        if rests.keys() & going.unreachable:
            yield {i: places[-1] for i, places in rests.items() if i not in going.unreachable}

    def _meeting(self, rows: Ints, instead: dict[int, Trajectory]) -> tuple[Violation, ...]:
        """Contacts among these rows where some do not follow the plan, but something else."""
        plane = self._plane.select(rows)
        near = set(plane.positioner_id.tolist())
        refused = {p: why for p, why in self._planned.refused.items() if p in near}
        robots = [self._planned.robots[row] for row in rows]
        robots = [instead.get(r.positioner_id, r) for r in robots]
        local = dataclasses.replace(self._planned, robots=tuple(robots), refused=refused)
        return verify(plane, local).collisions

    def _around(self, rows: Ints) -> Ints:
        """These rows and those whose arms can meet theirs: all other pairs are proven by the plan."""
        pairs = self._plane.neighbour_pairs()
        near = pairs[np.isin(pairs, rows).any(axis=1)]
        return np.union1d(near.ravel(), rows)


def _rank(choice: Choice) -> tuple[int, float]:
    """Lower is better: the number of pairs that touch, then the time of the first contact in s, negative."""
    pairs = {_pair(contact) for contact in choice.contacts}
    return len(pairs), -min((contact.time_s for contact in choice.contacts), default=0.0)


def _pair(contact: Violation) -> frozenset[int]:
    """The positioners of a contact; with an obstacle there is one."""
    other = {int(contact.other)} if contact.other.isdecimal() else set()
    return frozenset({contact.positioner_id, *other})


def _told(choice: Choice, going: Going) -> Iterator[tuple[str, str]]:
    """Kinds and texts of the events of a choice."""
    on = len(going.reachable) - len(choice.stop)
    unreached = ", ".join(map(str, sorted(going.unreachable)))
    text = f"{len(choice.stop)} are stopped, {on} go on; no stop reaches {unreached}"
    yield "deviation", f"{text}: {'not ' if choice.contacts else ''}proven clear of contacts"
    if choice.contacts:
        found = "; ".join(map(str, choice.contacts[:3]))
        yield "alarm", f"in every choice of those to stop arms may touch; in this one: {found}"


def cut_off_at(whole: Trajectory, time_s: float) -> Trajectory:
    """A trajectory that comes to rest at once at this time, in s."""
    before = whole.time_s < time_s
    end_deg = whole.at(time_s)
    if not before.any() or not whole.moves:
        return Trajectory(whole.positioner_id, np.zeros(1), end_deg[:1], end_deg[1:])
    return Trajectory(
        whole.positioner_id,
        np.append(whole.time_s[before], time_s),
        np.append(whole.alpha_deg[before], end_deg[0]),
        np.append(whole.beta_deg[before], end_deg[1]),
    )


async def when_linked(client: Client, ids: Iterable[int], within_s: float = RECONNECT_S) -> bool:
    """Waits until every link to these positioners is up, at most `within_s`; returns whether they are."""
    asked = list(ids)

    def linked() -> bool:
        return not client.exchange.cut_off(asked)

    return linked() or await client.exchange.wait(linked, client.time_s + within_s)
