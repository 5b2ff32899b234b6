"""After a collision: which arms touch, a verified way apart, flags cleared, the begin check."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field, replace

import numpy as np

from fiberloom.health.status import FibreStatus
from fiberloom.operation.field_state import FieldState
from fiberloom.operation.motion import UnsafePlanError
from fiberloom.operation.move import Goals
from fiberloom.operation.session.clearing import within_reach
from fiberloom.operation.session.motion import SessionMotion
from fiberloom.operation.session.states import Step
from fiberloom.planning import untangle
from fiberloom.planning.untangling import Stage, Untangled
from fiberloom.typing import Flags

TRIES = 3
"""Ways that are begun, before a person has to look; one that shows who does not move is no try."""


@dataclass
class Recovery:
    """Takes the arms of one field apart, and folds them."""

    motion: SessionMotion
    """After its begin check."""
    look_only: bool = False
    """Say what touches and what would be done; move nothing."""
    touching: list[str] = field(default_factory=list)
    """Which touch, and by how much they overlap."""
    stages: list[str] = field(default_factory=list)
    """What was done, or would be."""
    stuck: dict[int, str] = field(default_factory=dict)
    """Why a positioner still touches something."""
    dead: dict[int, str] = field(default_factory=dict)
    """By row: those that were seen not to move, and by what. The begin check alone cannot tell."""

    async def run(self) -> bool:
        """Recovers; True where nothing touches any more. The array is locked otherwise."""
        way = await self._way(0)
        self.touching = _texts(way)
        for text in self.touching:
            self.motion.recorder.event("touching", text)
        if self.look_only:
            self.stages = [stage.what for stage in way.stages]
        else:
            way = await self._apart(way)
        self.stuck = dict(way.stuck)
        free = not self.stuck and not way.overlaps
        text = "; ".join(self.stuck.values()) or f"touching: {', '.join(_texts(way))}"
        await self.motion.step(Step.FREE if free else Step.COLLIDE, "" if free else text)
        return free

    async def _apart(self, way: Untangled) -> Untangled:
        """Follows ways until one has come to its end; what is left then, or after `TRIES` in vain."""
        failed = 0
        while failed < TRIES:
            await self._clear_flags()
            if await self._follow(way):
                return replace(way, overlaps={})
            failed += not await self._begin_again()
            way = await self._way(failed)
        return way

    async def _begin_again(self) -> bool:
        """The begin check anew, with those as obstacles that did not move; True where there is a new one."""
        before, state = len(self.dead), self.motion.state
        for row in np.flatnonzero(state.hearing.heard).tolist():
            if state.faults[row] is FibreStatus.DEAD:
                self.dead[row] = "did not move on the way apart"
        await self.motion.begin_again()
        for row, why in self.dead.items():
            if self.motion.state.mobile[row]:
                self.motion.state.flag(row, FibreStatus.DEAD, why)
        return len(self.dead) > before

    async def _way(self, attempt: int) -> Untangled:
        state = self.motion.state
        self.motion.progress("looking for a way apart")
        plane = state.obstacles()
        within = in_reach_of_lost(state)
        plane = replace(plane, offline=plane.offline | within)
        found = await asyncio.to_thread(untangle, plane, state.here_deg, seed=attempt)
        return _of_bodies(found, state)

    async def _clear_flags(self) -> None:
        """The one place where flags of collisions are cleared: what touches is on record by now."""
        await self.motion.client.stop()
        await self.motion.client.wait_until_done(timeout_s=5.0, stop_on_collision=False)

    async def _follow(self, way: Untangled) -> bool:
        """Carries out the stages; False where one did not end as planned."""
        for stage in way.stages:
            self.stages.append(stage.what)
            self.motion.progress(stage.what)
            if await self._stage(stage):
                return False
        return True

    async def _stage(self, stage: Stage) -> bool:
        """Carries out one; True where it did not end as planned.

        Or did not begin: the last image has put who does not move some micrometres elsewhere, and a way that
        just passed there is proven no more.
        """
        goals = Goals.without_targets(self.motion.plane, np.asarray(stage.plan.end_deg))
        try:
            return bool((await self.motion.stage(stage.what, stage.plan, goals, stage.separates)).any())
        except UnsafePlanError as error:
            self.motion.recorder.event("recovery", f"{stage.what}: {error}; another way is looked for")
            return True


def _texts(way: Untangled) -> list[str]:
    """What touches, and by how much it overlaps."""
    return [f"{a} and {b}: {mm:.2f} mm" for (a, b), mm in way.overlaps.items()]


def in_reach_of_lost(state: FieldState) -> Flags:
    """(N,) positioners whose arms are where one may be of which nothing is known: they stay."""
    within = np.zeros(len(state.plane), dtype=bool)
    for row in np.flatnonzero(state.somewhere & ~state.mobile).tolist():
        within |= within_reach(state.plane, state.here_deg, row)
    return np.asarray(within & state.mobile)


def _of_bodies(found: Untangled, state: FieldState) -> Untangled:
    """Without those that may be anywhere: in their reach, and where they report, no body is for certain."""
    lost = state.plane.positioner_id[state.somewhere & ~state.mobile].tolist()
    first = len(state.plane.fiducials)
    nowhere = {f"positioner {p}" for p in lost} | {f"fiducial {first + k}" for k in range(len(lost))}
    overlaps = {pair: mm for pair, mm in found.overlaps.items() if not nowhere.intersection(pair)}
    touching = {body for pair in overlaps for body in pair}
    stuck = {p: why for p, why in found.stuck.items() if f"positioner {p}" in touching}
    return replace(found, overlaps=overlaps, stuck=stuck)
