"""The search of stops by motors that report nothing: folded, and only where the way is proven clear."""

from __future__ import annotations

import asyncio
from typing import cast

import numpy as np

from fiberloom.drive.port import CountsSteps, SearchesStops
from fiberloom.operation.safety.stop import reason, to_its_end
from fiberloom.operation.session.motion import SessionMotion
from fiberloom.operation.session.states import Step
from fiberloom.planning import Plan, Trajectory, verify
from fiberloom.typing import Floats, Ints

SLOW_S = 400.0
"""Time in which the verifier is shown a search: slower than any limit."""


class StopSearch:
    """Searches the stops of positioners of a folded field; which were found, and why others were not."""

    def __init__(self, motion: SessionMotion, rows: Ints) -> None:
        """`motion`: of the field, folded; `rows` (n,): of the positioners to search."""
        self.motion, self.rows = motion, rows
        self.found: list[int] = []
        self.left_out: dict[int, str] = {}
        self.lost_steps: dict[int, str] = {}
        """What is found to be lost since the last search, by number."""

    async def run(self) -> None:
        """Searches all at once whose way is proven clear. InputError where the bus is gone."""
        ids = self._ready()
        blocked = await self._blocked(ids)
        if clear := [i for i in ids if i not in blocked]:
            await self._search(clear)
        await self.motion.searched(self.found, datum=True)

    def _ready(self) -> list[int]:
        """Those that answer and are folded."""
        state, plane, folded = self.motion.state, self.motion.plane, self.motion.are_folded
        ready = []
        for row in self.rows.tolist():
            number = int(plane.positioner_id[row])
            if number not in self.motion.drive.ids or plane.offline[row]:
                self.left_out[number] = "does not answer on the bus"
            elif not folded[row] or not state.mobile[row]:
                self.left_out[number] = f"is not folded for certain: {state.why.get(row, 'not at its goal')}"
            else:
                ready.append(number)
        return ready

    async def _blocked(self, ids: list[int]) -> set[int]:
        """Those of `ids` whose arm would meet something on its way to the stops; they are left out."""
        plane = self.motion.state.obstacles()
        found = await asyncio.to_thread(verify, plane, self._way(ids))
        met = {v.positioner_id for v in found.collisions}
        met |= {int(v.other) for v in found.collisions if v.other.isdigit()}
        blocked = met & set(ids)
        self.left_out |= dict.fromkeys(blocked, "its way to the stops is not clear")
        return blocked

    def _way(self, ids: list[int]) -> Plan:
        """Both axes to the stop in their final direction, and the whole of alpha's range."""
        plane, here = self.motion.plane, self.motion.state.here_deg
        stops, searching = plane.stops_of(), np.isin(plane.positioner_id, ids)
        robots = []
        for row, number in enumerate(plane.positioner_id.tolist()):
            points = _search_way(here[row], stops[row]) if searching[row] else here[[row]]
            time_s = np.linspace(0.0, SLOW_S, len(points)) if searching[row] else np.zeros(1)
            robots.append(Trajectory(number, time_s, *points.T))
        return Plan(plane.instrument.name, plane.collision_buffer_mm, tuple(robots))

    async def _search(self, ids: list[int]) -> None:
        motion, drive = self.motion, cast("SearchesStops", self.motion.drive)
        motion.progress(f"searching stops: {len(ids)} positioners")
        await motion.step(Step.MOVE)
        motion.has_moved = True
        try:
            results = await drive.home(ids)
        except BaseException as error:
            await to_its_end(motion.stop(reason(error)))
            raise
        self.found = [i for i in ids if results[i].ok]
        if isinstance(drive, CountsSteps):
            self.lost_steps = drive.lost_steps()
            for number, text in self.lost_steps.items():
                motion.state.recorder.event("alarm", text, number)
        self.left_out |= {i: f"its search ended otherwise: {results[i]}" for i in ids if not results[i].ok}


def _search_way(here_deg: Floats, stops_deg: Floats) -> Floats:
    """(3, 2) deg: alpha from where it is to one stop and to the other; beta stays folded."""
    return np.array([[stop, here_deg[1]] for stop in (here_deg[0], *stops_deg[0])])
