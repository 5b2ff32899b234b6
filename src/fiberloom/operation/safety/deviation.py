"""The rule of a motion in which a positioner does not do its part: may the others go on?

Stopping half of a verified motion is what collides: what cannot be reached goes on, among arms that were
stopped in its way. Going on past an arm that is not where the plan has it collides too. So the verifier
decides, for the places where that arm may be.
"""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.bus.motion import RECONNECT_S, Deviation, DeviationKind, MotionWatch
from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan, Trajectory, verify
from fiberloom.typing import Ints

STOPS = 7
"""Places along its trajectory at which a positioner may have come to rest that are tried."""

AT_ITS_START = frozenset({DeviationKind.NOT_STARTED, DeviationKind.REFUSED})


class MotionRule(MotionWatch):
    """Lets a motion go on where the verifier proves it safe with the deviating positioners where they are.

    A collision stops all. A link that is down stops none: what is behind it follows the plan, which is
    proven. For one that is silent both are proven: that it goes on, by the plan, and that it came to rest
    anywhere since it was last known to move.
    """

    def __init__(
        self,
        plane: FocalPlane,
        planned: Plan,
        event: Callable[[str, str, int], None],
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
        if any(d.kind is DeviationKind.COLLIDED for d in deviations):
            return False
        doubtful = [d for d in deviations if d.kind is not DeviationKind.LINK_DOWN]
        if not doubtful:
            return True
        proven = await asyncio.to_thread(self._is_proven_with, doubtful)
        for d in doubtful:
            text = "the others go on: proven clear of it" if proven else "all are stopped: not proven clear"
            self._event("deviation", text, d.positioner)
        return proven

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
        last_s = deviation.time_s + self.poll_s / 2
        return [cut_off_at(whole, t) for t in np.linspace(deviation.known_s, last_s, STOPS)]

    def is_proven(self) -> bool:
        """True when nothing meets the positioners that may rest, wherever they do."""
        rows = self._around(self.resting_rows())
        plane = self._plane.select(rows)
        near = set(plane.positioner_id.tolist())
        refused = {p: why for p, why in self._planned.refused.items() if p in near}
        for k in range(STOPS):
            robots = [self._planned.robots[row] for row in rows]
            robots = [self._rests.get(r.positioner_id, [r] * STOPS)[k] for r in robots]
            local = dataclasses.replace(self._planned, robots=tuple(robots), refused=refused)
            if verify(plane, local).collisions:
                return False
        return True

    def resting_rows(self) -> Ints:
        """Rows of the positioners that may be at rest."""
        return np.atleast_1d(self._plane.index_of(np.array(sorted(self._rests), dtype=np.int64)))

    def _around(self, rows: Ints) -> Ints:
        """These rows and those whose arms can meet theirs: all other pairs are proven by the plan."""
        pairs = self._plane.neighbour_pairs()
        near = pairs[np.isin(pairs, rows).any(axis=1)]
        return np.union1d(near.ravel(), rows)


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
