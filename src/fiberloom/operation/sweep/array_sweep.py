"""The sweep of an array: every axis through its points, upward and downward, an image after every step.

On a bench each arm turns alone; here all turn together (`ways`). Every step is a plan that has passed the
verifier, started at once on the whole bus and watched like any other motion. Arms are thicker than they are,
since the maps are not known yet: the linear ratio of the gears is used.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import numpy as np

from fiberloom.calibration.transmission.sweep import SweepSettings, wire_grid
from fiberloom.calibration.transmission.sweep_data import SweepData
from fiberloom.errors import InputError
from fiberloom.health.status import FibreStatus
from fiberloom.instruments.model import AXES
from fiberloom.operation.field_state import SAME_DEG
from fiberloom.operation.motion import RECOVERIES, FieldMotion
from fiberloom.operation.move import Goals
from fiberloom.operation.sweep.kept import KeptPass, KeptSweep
from fiberloom.operation.sweep.ways import ClearWays, SweepPass, clear_ways, slow_plan
from fiberloom.planning import Plan, PlanSettings
from fiberloom.typing import Flags, Floats

THICKER_MM = 0.5
"""Of the arms while the maps are not known; a linear ratio misses by 0.1 mm, a zero that is 1 deg off by
0.4 mm. So much further from where it reports may a positioner be at the begin."""

ALPHAS_DEG = (180.0, 60.0, 300.0, 120.0, 240.0, 0.0)
"""Where alpha rests while beta turns, in this order: another one for those whose way was not clear."""

AT_BEGIN_DEG = 2.0
"""So near its place a positioner is at the begin of a pass."""

NOT_ASKED = "excluded, or switched off"
NO_SIGHT = "dark: its fibre is not seen"


class ArraySweep:
    """Sweeps the positioners of a field, and says why some were not swept."""

    def __init__(
        self,
        motion: FieldMotion,
        settings: SweepSettings,
        progress: Callable[[int, int], None] = lambda done, total: None,
        kept: KeptSweep | None = None,
    ) -> None:
        """`motion`: of the N positioners, connected, with arms thicker by THICKER_MM; `settings`: how to
        sweep; `progress`: called with the points done and all; `kept`: what was measured before."""
        self.motion, self.settings, self.plane = motion, settings, motion.plane
        self._progress, self._done, self._total = progress, 0, 4 * settings.n_points
        self._kept = kept or KeptSweep()
        self._left: dict[int, str] = {}
        self._number, self._pass_number = 0, 0
        self._place_deg = motion.state.here_deg

    async def run(self) -> SweepData:
        """Sweeps alpha, then beta as often as it takes, then folds.

        Returns the points of all, with the reason for each positioner that has none. Raises InputError
        where the sweep is stopped again and again.
        """
        k, n = self.settings.n_points, len(self.plane)
        xy = np.full((2, 2, k, n, 2), np.nan)
        await self.motion.client.set_precise_moves(self._able_ids(), on=False)
        await self._fold()
        xy[0], _ = await self._pass(self._pass_of(0, self.settings.beta_lever_deg))
        await self._sweep_beta(xy[1])
        await self._fold()
        return SweepData(wire_grid(self.plane, self.settings), xy, self._trouble(xy))

    async def _sweep_beta(self, xy: Floats) -> None:
        """Fills `xy` (2, K, N, 2): of each positioner the first pass in which nothing was in its way."""
        whole = np.zeros(len(self.plane), dtype=bool)
        number = 0
        while number == 0 or (self._able & ~whole).any():
            known = self._kept.at(self._pass_number)
            best = known.swept if known else await asyncio.to_thread(self._best_pass, whole)
            if best is None and number:
                return
            if number:
                self._total += 2 * self.settings.n_points
            swept = best or self._pass_of(1, ALPHAS_DEG[0])
            seen, ways = await self._pass(swept)
            now = _whole(swept, ways) & ~whole
            fill = now if number else np.ones_like(now)
            xy[:, :, fill] = seen[:, :, fill]
            whole |= now
            number += 1

    def _best_pass(self, whole: Flags) -> SweepPass | None:
        """The first pass over beta in which the most can turn wholly that have not yet; None: none can."""
        passes = [self._pass_of(1, alpha_deg) for alpha_deg in ALPHAS_DEG]
        gains = [int((_whole(p, self._ways(p)) & ~whole).sum()) for p in passes]
        return passes[int(np.argmax(gains))] if max(gains) else None

    # one pass

    def _pass_of(self, axis: int, rest_deg: float) -> SweepPass:
        points_deg = wire_grid(self.plane, self.settings)[axis]
        return SweepPass(axis, points_deg, rest_deg, self.settings.run_up_of(self.plane))

    async def _pass(self, swept: SweepPass) -> tuple[Floats, ClearWays]:
        """Points (2, K, N, 2) of one pass; begun anew where a positioner drops out on the way."""
        done, number = self._done, self._pass_number
        self._pass_number += 1
        known = self._kept.at(number)
        for _ in range(RECOVERIES + 1):
            if known is None or not known.complete:
                known = await self._to_begin(swept, known)
                self._kept.begin(number, known)
            self._done = done + known.done
            if known.swept.axis == 0:  # beta has other passes
                self._left |= known.ways.why
            if await self._finished(known):
                return known.xy_mm, known.ways
            known = None
            self.motion.recorder.event("recovery", f"the sweep of {AXES[swept.axis]} is begun anew")
            await self._fold()
        which = ", ".join(map(str, self._troubled())) or "none of those that move"
        raise InputError(
            f"the sweep of {AXES[swept.axis]} was stopped {RECOVERIES + 1} times; positioners that do not "
            f"follow: {which}; exclude them"
        )

    async def _to_begin(self, swept: SweepPass, known: KeptPass | None) -> KeptPass:
        """Brings those that can take part to where a pass begins, or goes on.

        `known`: the pass as it was left; it is begun anew where others take part now.
        """
        for _ in range(RECOVERIES + 1):
            ways = await asyncio.to_thread(self._ways, swept)
            if not ways.takes.any():
                raise InputError(f"no positioner can be swept: {self._first_reason(ways)}")
            begun = known if known and known.fits(swept, ways) else KeptPass.begun(swept, ways)
            begin_deg = begun.begin_deg()
            goal_deg = np.where(ways.takes[:, None], begin_deg, self.motion.state.here_deg)
            await self.motion.go(Goals.without_targets(self.plane, goal_deg))
            late = np.abs(self.motion.state.here_deg - goal_deg).max(axis=1) > AT_BEGIN_DEG
            dropped = ways.takes & ~self.motion.state.mobile
            if not (dropped | (late & ways.takes)).any():
                self._place_deg = goal_deg
                return begun
            for row in np.flatnonzero(late & self.motion.state.mobile):
                self._left[int(row)] = "could not be brought to where its sweep begins"
        raise InputError("positioners could not be brought to where the sweep begins; home them first")

    async def _finished(self, begun: KeptPass) -> bool:
        """Measures what is left of a pass; False where a positioner dropped out on the way."""
        self.motion.progress(f"sweeping {AXES[begun.swept.axis]}")
        self._progress(self._done, self._total)
        swept, ways, first = begun.swept, begun.ways, begun.done
        places_deg, usable = swept.places_deg(ways.low_deg), swept.usable(ways.low_deg)
        for direction, k in begun.steps[first:]:
            label = f"{AXES[swept.axis]} {('down', 'up')[direction]}"
            turns = (direction, k) == (0, len(usable) - 1) and begun.done > first
            if turns and not await self._step(places_deg[-1], ways, f"{label}, run-up"):
                return False
            if not await self._step(places_deg[k + 1], ways, label):
                return False
            image = self.motion.moves[-1].measurement
            good = image.seen & usable[k] & ways.takes
            begun.xy_mm[direction, k, good] = image.xy_mm[good]
            begun.done, self._done = begun.done + 1, self._done + 1
            await self.motion.writer.now(self._kept.save)
            self._progress(self._done, self._total)
        return True

    async def _step(self, place_deg: Floats, ways: ClearWays, label: str) -> bool:
        """One step of all; False where one of them dropped out."""
        motion = self.motion
        planned = await motion.care.planned(self._planned, place_deg, ways.takes)
        self._place_deg = planned.end_deg
        self._number += 1
        goals = Goals.without_targets(self.plane, planned.end_deg)
        interrupted = await motion.move(self._number, f"sweep, {label}", planned, goals)
        del motion.moves[:-1]  # they are in the store; thousands of plans need not stay in memory
        return bool(not interrupted.any() and motion.state.mobile[ways.takes].all())

    def _planned(self, place_deg: Floats, takes: Flags, settings: PlanSettings | None = None) -> Plan:
        """The straight way of all to a place (N, 2), in the time that the longest takes."""
        here_deg, place_deg = self._begun_deg(), np.where(takes[:, None], place_deg, self._begun_deg())
        speed_deg_s = (settings or PlanSettings()).of(self.plane).speed_deg_s or 0.0
        way_deg = np.abs(place_deg - here_deg).max(axis=1)
        step_s = max(float(way_deg.max()) / speed_deg_s, SHORTEST_S)
        return slow_plan(self.plane, np.stack([here_deg, place_deg]), way_deg > 0.0, step_s)

    def _begun_deg(self) -> Floats:
        """(N, 2) where a step begins: where the last one was to end, so that an axis at rest is not moved."""
        here_deg = self.motion.state.here_deg
        return np.where(np.abs(here_deg - self._place_deg) < SAME_DEG, self._place_deg, here_deg)

    # who takes part

    @property
    def _able(self) -> Flags:
        """(N,) follow commands and have not been left out."""
        able = self.motion.state.mobile.copy()
        able[list(self._left)] = False
        return able

    def _able_ids(self) -> list[int]:
        return [int(p) for p in self.plane.positioner_id[self._able]]

    def _ways(self, swept: SweepPass) -> ClearWays:
        state = self.motion.state
        obstacles = state.obstacles()
        ways = clear_ways(obstacles, state.here_deg, self._able, swept)
        # those that may be anywhere are the last of the discs
        anywhere = self.plane.positioner_id[state.somewhere & ~state.mobile]
        first = len(obstacles.fiducials) - len(anywhere)
        for k, positioner in enumerate(anywhere):
            told = f"positioner {positioner}, which may be anywhere within reach,"
            for row, text in ways.why.items():
                ways.why[row] = text.replace(f"fiducial {first + k} ", f"{told} ")
        return ways

    async def _fold(self) -> None:
        """Folds those that are not; a move of nothing would tell as little of those that do not follow."""
        here_deg = self.motion.state.here_deg[self.motion.state.mobile]
        if (np.abs(here_deg - self.plane.park_deg[self.motion.state.mobile]) > AT_BEGIN_DEG).any():
            await self.motion.go(Goals.without_targets(self.plane, self.plane.park_deg))

    def _troubled(self) -> list[int]:
        state = self.motion.state
        return [int(p) for p in self.plane.positioner_id[~state.mobile & ~self.plane.offline]]

    def _first_reason(self, ways: ClearWays) -> str:
        reasons = {**self._reasons(), **self._left, **ways.why}
        row = min(reasons, default=-1)
        return "" if row < 0 else f"positioner {self.plane.positioner_id[row]}: {reasons[row]}"

    def _reasons(self) -> dict[int, str]:
        """By row why positioners do not move."""
        state = self.motion.state
        reasons = {row: state.why.get(row, NOT_ASKED) for row in np.flatnonzero(~state.mobile).tolist()}
        for row, fault in enumerate(state.faults):
            if fault in (FibreStatus.LYING, FibreStatus.ASTRAY):
                reasons[row] = f"{fault}: seen elsewhere than it reports"
        return reasons

    def _trouble(self, xy: Floats) -> list[str]:
        """(N,) why a positioner was not swept; empty for the others."""
        reasons = {**self._left, **self._reasons()}
        unseen: Flags = np.asarray(np.isnan(xy).all(axis=(0, 1, 2, 4)))
        for row, fault in enumerate(self.motion.state.faults):
            if fault is FibreStatus.DARK and unseen[row]:
                reasons[row] = NO_SIGHT
        return [reasons.get(row, "") for row in range(len(self.plane))]


SHORTEST_S = 0.2
"""Of a step: the firmware's ticks and its smoothing need some."""


def _whole(swept: SweepPass, ways: ClearWays) -> Flags:
    """(N,) which have nothing in their way in all of a pass."""
    return np.asarray(ways.takes & swept.usable(ways.low_deg).all(axis=0))
