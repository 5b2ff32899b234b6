"""Who is stopped, where a motion is to end and not all can be reached.

The rule looks for the largest part of the others that can be stopped. All pairs that go on are proven by the
plan, and two at rest stay apart; so only pairs of one that rests and one that goes on count. Of such a pair
the one that was stopped is let go on, until none meet. One that is let go had to be, whatever the others
do: it was in the way of one that goes on in every choice. So where any choice is free of contacts
this one is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiberloom.bus.motion import Going
from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan, Trajectory, Violation, verify
from fiberloom.typing import Floats, Ints

Places = Mapping[int, Sequence[Trajectory]]


@dataclass(frozen=True)
class Choice:
    """Who is stopped, and what the verifier finds then."""

    stop: frozenset[int]
    contacts: tuple[Violation, ...] = ()


class Choosing:
    """The search of one choice. Only what is ahead counts; arms go on while it is made."""

    def __init__(
        self, plane: FocalPlane, planned: Plan, going: Going, stopped_s: Floats, resting: Places
    ) -> None:
        """`plane`: N positioners, with the obstacles of the plan `planned`; `stopped_s`: (K,) s after START,
        when one that is stopped now may come to rest; `resting`: K trajectories by positioner, for those that
        rest or may rest already."""
        now_s = going.time_s
        self._plane, self._going = plane, going
        self._planned = replace(planned, robots=tuple(ahead(r, now_s) for r in planned.robots))
        robots = {r.positioner_id: r for r in self._planned.robots}
        self._resting = {
            i: [ahead(t, now_s) for t in places] for i, places in resting.items() if i not in going.reachable
        }
        self._stopped = {i: cut_off_at(robots[i], stopped_s - now_s) for i in going.reachable}
        self._count = len(stopped_s)

    def best(self) -> Choice:
        """The largest part of the reachable ones that can be stopped without a contact.

        Where there is none, the better one of those that were tried.
        """
        places = self._stopped | self._resting
        stop = self._going.reachable
        tried = [Choice(stop, tuple(self._meetings(places.keys(), places).values()))]
        while tried[-1].contacts:
            let_go = {i for contact in tried[-1].contacts for i in self._stopped_of(contact, stop)}
            if not let_go:
                break
            stop -= let_go
            places = {i: where for i, where in places.items() if i not in let_go}
            tried.append(Choice(stop, self._with_let_go(tried[-1].contacts, let_go, places)))
        best = min(tried, key=rank)
        at_s = self._going.time_s
        return Choice(best.stop, tuple(replace(c, time_s=at_s + c.time_s) for c in best.contacts))

    def _stopped_of(self, contact: Violation, stop: frozenset[int]) -> list[int]:
        """Of a contact the one that was stopped, if the other one is on its way."""
        pair = _pair(contact)
        mixed = len(pair & stop) == 1 and not (pair - stop) & self._resting.keys()
        return list(pair & stop) if mixed else []

    def _with_let_go(
        self, contacts: Iterable[Violation], let_go: set[int], places: Places
    ) -> tuple[Violation, ...]:
        """Contacts once these go on too: nothing has changed for pairs without any of them."""
        others = {_pair(contact): contact for contact in contacts if not _pair(contact) & let_go}
        return tuple((others | self._meetings(let_go, places)).values())

    def _meetings(self, among: Iterable[int], places: Places) -> dict[frozenset[int], Violation]:
        """Contacts by pair, of one of `among`, one that is at its places, not both stopped now."""
        pairs = self._plane.neighbour_pairs()
        ids = self._plane.positioner_id[pairs]
        stopped = np.isin(ids, list(places.keys() & self._stopped.keys()))
        asked = np.isin(ids, list(among)).any(axis=1) & np.isin(ids, list(places)).any(axis=1)
        rows = np.unique(pairs[asked & ~stopped.all(axis=1)])
        worlds = self._worlds(places)
        found = (c for world in worlds for c in meeting(self._plane, self._planned, rows, world))
        return {_pair(contact): contact for contact in found}

    def _worlds(self, places: Places) -> Iterator[dict[int, Trajectory]]:
        """By positioner, what differs from the plan: each of the places, and that who may go on does."""
        unreachable = self._going.unreachable
        for k in range(self._count):
            yield {i: where[k] for i, where in places.items()}
        if places.keys() & unreachable:
            yield {i: where[-1] for i, where in places.items() if i not in unreachable}


def meeting(
    plane: FocalPlane, planned: Plan, rows: Ints, instead: Mapping[int, Trajectory]
) -> tuple[Violation, ...]:
    """Contacts among these `rows` of `plane` where some do not follow what is `planned`, but go `instead`."""
    part = plane.select(rows)
    near = set(part.positioner_id.tolist())
    refused = {p: why for p, why in planned.refused.items() if p in near}
    robots = [planned.robots[row] for row in rows]
    robots = [instead.get(r.positioner_id, r) for r in robots]
    return verify(part, replace(planned, robots=tuple(robots), refused=refused)).collisions


def rank(choice: Choice) -> tuple[int, float]:
    """Lower is better: the number of pairs that touch, then the time of the first contact in s, negative."""
    pairs = {_pair(contact) for contact in choice.contacts}
    return len(pairs), -min((contact.time_s for contact in choice.contacts), default=0.0)


def _pair(contact: Violation) -> frozenset[int]:
    """The positioners of a contact; with an obstacle there is one."""
    other = {int(contact.other)} if contact.other.isdecimal() else set()
    return frozenset({contact.positioner_id, *other})


def cut_off_at(whole: Trajectory, when_s: Floats) -> list[Trajectory]:
    """The `whole` trajectory, but at rest from `when_s` on; one for each of these times in s."""
    ends_deg = whole.at(when_s)
    counts = np.searchsorted(whole.time_s, when_s) if whole.moves else np.zeros(len(when_s), dtype=np.int64)
    return [_up_to(whole, n, t, end) for n, t, end in zip(counts, when_s, ends_deg, strict=True)]


def _up_to(whole: Trajectory, n: int, time_s: float, end_deg: Floats) -> Trajectory:
    """Its first `n` points, and rest in another one; if it has none before, it does not move."""
    if n == 0:
        return Trajectory(whole.positioner_id, np.zeros(1), end_deg[:1], end_deg[1:])
    times = np.concatenate([whole.time_s[:n], [time_s]])
    alpha = np.concatenate([whole.alpha_deg[:n], end_deg[:1]])
    return Trajectory(whole.positioner_id, times, alpha, np.concatenate([whole.beta_deg[:n], end_deg[1:]]))


def ahead(whole: Trajectory, now_s: float) -> Trajectory:
    """What is left of the `whole` at `now_s`, in s, which is the 0 of its times."""
    first = int(np.searchsorted(whole.time_s, now_s, side="right"))
    ((alpha, beta),) = whole.at([now_s])
    return Trajectory(
        whole.positioner_id,
        np.concatenate([[0.0], whole.time_s[first:] - now_s]),
        np.concatenate([[alpha], whole.alpha_deg[first:]]),
        np.concatenate([[beta], whole.beta_deg[first:]]),
    )
