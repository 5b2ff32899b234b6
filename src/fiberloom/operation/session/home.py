"""The datum search of an array: folded first, then alpha, then beta in rounds in which no arms can meet."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np

from fiberloom.bus.protocol import Status
from fiberloom.drive.sdssv.limits import groups_within_supply
from fiberloom.instruments import FocalPlane
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.move import Goals
from fiberloom.operation.reference.declare import declare_seen_right
from fiberloom.operation.safety.begin import Standing
from fiberloom.operation.safety.stop import reason, to_its_end
from fiberloom.operation.session.clearing import FOLDED_DEG, Clearing, Round, within_reach
from fiberloom.operation.session.states import Step
from fiberloom.planning import Plan, Trajectory, verify
from fiberloom.planning.bodies import travel_rad, travels_rad
from fiberloom.timing import part
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import rad_to_deg

SEARCH_S = 600.0
"""A search of a whole turn takes less."""

SLOW_S = 200.0
"""Time in which the verifier is shown a search: slower than any limit."""

TURN_MM = 0.03
"""An image that agrees so well with a whole motor turn more or less, and not without it, says so."""

NEAR_DEG = 10.0
"""So far from its stop the search of a beta begins. Five motor turns are 1.8 deg (SDSS-V), and a stretched
arm whose fibre is seen 1 mm from where it reports is off by 4 deg."""

TRIES = 2
"""Rounds in which one is tried whose way turned out not to be clear."""

UNSEEN, LIGHT = "where it is cannot be seen", "light its fibre, exclude it, or search it on the bench"

_INITIALIZED = {"alpha": Status.DATUM_ALPHA_INITIALIZED, "beta": Status.DATUM_BETA_INITIALIZED}


class Homing:
    """Searches the datum of positioners of a field; which were found, and why others were not."""

    def __init__(self, motion: FieldMotion, rows: Ints, counts_turns: bool = True) -> None:
        """`motion`: of the field, after its begin check; `rows`: of the positioners to search.

        `counts_turns`: the layout is known well enough for an image to tell a motor turn.
        """
        self._counts = counts_turns
        self.motion, self.rows = motion, [int(r) for r in rows]
        self.found: list[int] = []
        self.left_out: dict[int, str] = {}
        self._lost = -1
        """Row of the one that searches though nothing is known of it; -1: none."""
        self._alpha: set[int] = set()
        """Rows whose alpha was found."""
        self._why: dict[int, str] = {}
        """Of rows that did not follow on the way to their search: what was seen."""
        self._misses_mm = np.zeros((len(motion.plane), 2))
        """(N, 2) by which the maps err where all are folded; 0 where that is not known."""

    @property
    def _plane(self) -> FocalPlane:
        return self.motion.plane

    async def run(self) -> None:
        """Searches all that can be searched safely."""
        self._leave_out_the_silent()
        await declare_seen_right(self.motion)
        await self._search_lost()
        await self._whole()
        await self._fold()
        self._learn_misses()
        await self._search_alpha()
        await self._search_beta()
        for row in self.rows:
            if self._id(row) not in self.found:
                why = self._why.get(row, "its way was not clear of neighbours that do not move")
                self.left_out.setdefault(self._id(row), why)

    def _id(self, row: int) -> int:
        return int(self._plane.positioner_id[row])

    def _leave_out_the_silent(self) -> None:
        state = self.motion.state
        for row in list(self.rows):
            fault = state.faults[row]
            if self._id(row) not in self.motion.client.ids:
                self._give_up(row, "does not answer on the bus")
            elif self._plane.offline[row]:
                self._give_up(row, f"{fault}: excluded, or switched off")

    def _give_up(self, row: int, why: str) -> None:
        self.left_out[self._id(row)] = why
        self.rows.remove(row)

    # the rounds

    def _clearing(self) -> Clearing:
        state = self.motion.state
        lost = state.somewhere & ~state.mobile & (np.arange(len(self._plane)) != self._lost)
        return Clearing(self._plane, state.here_deg, state.mobile, lost)

    def _near(self, row: int) -> Flags:
        """(N,) whose arms may be within the reach of one, as all are now."""
        state = self.motion.state
        return within_reach(self._plane, state.here_deg, row, state.standing(Standing.BLIND))

    async def _search_lost(self) -> None:
        """Those of which nothing is known, one at a time, before the others fold.

        One may be anywhere within its reach. So all others have to be out of it; they keep out of it, and
        only then it searches. One that is within it now has no way out that is known to be free.
        """
        state = self.motion.state
        for row in [r for r in self.rows if state.somewhere[r] and not state.mobile[r]]:
            state = self.motion.state
            near = await asyncio.to_thread(self._near, row)
            if near.any():
                who = ", ".join(map(str, self._plane.positioner_id[near]))
                self._give_up(
                    row, f"{UNSEEN}, and no way out of its reach is known to be free for {who}; {LIGHT}"
                )
                continue
            self._lost = row
            try:
                await self._rounds([row], "both")
            finally:
                self._lost = -1
            if self._id(row) not in self.found:
                why = self.left_out.get(self._id(row), "something that does not move is within its reach")
                self._give_up(row, f"{UNSEEN}, and {why}; {LIGHT}")

    async def _whole(self) -> None:
        """Those that are seen, but not where they report: both axes, with the neighbours out of reach."""
        doubted = [row for row in self.rows if not self.motion.state.mobile[row]]
        await self._rounds(doubted, "both")
        for row in doubted:
            if self._id(row) not in self.found:
                self._give_up(row, "not where it reports, and its neighbours cannot all get out of its reach")

    async def _search_alpha(self) -> None:
        waiting = [row for row in self.rows if self._id(row) not in self.found]
        for row in list(waiting):
            if not self._folded()[row]:
                self._give_up(row, "could not be folded")
                waiting.remove(row)
        await self._rounds(waiting, "alpha")
        await self._fold()

    async def _search_beta(self) -> None:
        await self._rounds([row for row in self.rows if row in self._alpha], "beta")

    async def _rounds(self, waiting: list[int], axis: str) -> None:
        tried = dict.fromkeys(waiting, 0)
        while waiting:
            clearing = self._clearing()
            make = {"both": clearing.whole_round, "alpha": clearing.alpha_round, "beta": clearing.beta_round}
            made = await asyncio.to_thread(make[axis], waiting)
            if not made.searchers:
                return
            self.motion.progress(f"datum search, {axis}: {len(made.searchers)} of {len(waiting)} that wait")
            await self._clear(made)
            ready = self._ready(made, axis)
            if axis == "beta" and ready:
                ready = await self._approach(made, ready)
            for row in made.searchers:
                tried[row] += 1
            begun = await self._search(ready, axis)
            if any(self._id(row) in self.left_out for row in begun):
                await declare_seen_right(self.motion)  # a search that was stopped has forgotten the datum
            waiting = [row for row in waiting if row not in begun and tried[row] < TRIES]

    async def _clear(self, made: Round) -> None:
        """Brings every other one out of the way, by a verified plan."""
        here_deg = self.motion.state.here_deg
        if np.abs(made.goals_deg - here_deg)[self.motion.state.mobile].max(initial=0.0) > 0.0:
            await self.motion.go(Goals.without_targets(self._plane, made.goals_deg))

    async def _approach(self, made: Round, rows: list[int]) -> list[int]:
        """Brings these near the stop of beta, by a verified plan: to search all of the way would take long.

        Returns those that may search now. One for which there is no such plan has stayed, and searches all of
        its way.
        """
        goals_deg = self.motion.state.here_deg.copy()
        goals_deg[rows, 1] = near_stop_deg(self._plane, rows, goals_deg)
        await self._clear(replace(made, goals_deg=goals_deg))
        here_deg = self.motion.state.here_deg
        stayed = [row for row in rows if np.abs(here_deg[row] - made.goals_deg[row]).max() < FOLDED_DEG]
        goals_deg[stayed] = made.goals_deg[stayed]
        state = self.motion.state
        self._why |= {row: state.why[row] for row in rows if not state.mobile[row] and row in state.why}
        return self._ready(replace(made, searchers=rows, goals_deg=goals_deg), "beta")

    @part("clearing")
    def _ready(self, made: Round, axis: str) -> list[int]:
        """Searchers whose way is clear as positioners really are, and passes the verifier."""
        clearing, state = self._clearing(), self.motion.state
        begun = np.abs(state.here_deg - made.goals_deg).max(axis=1) < FOLDED_DEG
        # one that was seen not to follow on the way there is an obstacle by now
        begun &= state.mobile | (axis == "both")
        sweeps = {row: made.sweeps[row] for row in made.searchers if begun[row]}
        rows = [row for row in sweeps if not clearing.blocked(row, sweeps[row], sweeps)]
        return rows if axis == "both" else self._verified(rows, axis)

    def _verified(self, rows: list[int], axis: str) -> list[int]:
        """Of searchers those on whose way the verifier finds nothing.

        All at once: their discs keep them apart from each other. The others are where they are.
        """
        column, state = 0 if axis == "alpha" else 1, self.motion.state
        low_deg = rad_to_deg(travel_rad(self._plane))[column, 0]
        ways = [
            Trajectory(int(p), np.zeros(1), *place_deg[None].T)
            for p, place_deg in zip(self._plane.positioner_id, state.here_deg, strict=True)
        ]
        for row in rows:
            way = np.tile(state.here_deg[row], (2, 1))
            way[1, column] = low_deg
            # there and back to zero: the same places
            ways[row] = Trajectory(ways[row].positioner_id, np.array([0.0, SLOW_S]), *way.T)
        plane = state.obstacles()
        found = verify(plane, Plan(plane.instrument.name, plane.collision_buffer_mm, tuple(ways)))
        if found.unsound:
            return []
        return [row for row in rows if self._id(row) not in found.at_fault]

    async def _search(self, rows: list[int], axis: str) -> list[int]:
        """Searches one axis or both of these, so many at once as the supply can feed; rows that began.

        Where a group does not end as it should the next one does not begin: where all are is seen first.
        """
        ids, begun, done = [self._id(row) for row in rows], [], []
        for group in groups_within_supply(self._plane.instrument, ids):
            begun += group
            found = await self._search_group(group, axis)
            done += found
            if len(found) < len(group):
                break
        if begun:
            await self._book(done, axis)
        return [row for row in rows if self._id(row) in begun]

    async def _search_group(self, ids: list[int], axis: str) -> list[int]:
        """Searches one axis or both of these at once; stops them all where anything goes wrong."""
        motion = self.motion
        await motion.step(Step.MOVE)
        motion.has_moved = True
        try:
            begun = await motion.client.home(ids, None if axis == "both" else axis)
            ended = await motion.client.wait_until_done(begun.ok_ids, SEARCH_S)
            initialized = set(await self._initialized(ids, axis))
        except BaseException as error:
            await to_its_end(motion.stop(reason(error)))
            raise
        await motion.step(Step.REST)
        failed = {**begun.failed, **ended.failed}
        done = [i for i in ids if i not in failed and i in initialized]
        for i in ids:
            if i not in done:
                self.left_out[i] = f"its search of {axis} ended otherwise: {failed.get(i, 'no datum')}"
        return done

    async def _initialized(self, ids: list[int], axis: str) -> list[int]:
        """Which say that the datum is set."""
        wanted = Status.DATUMS_INITIALIZED if axis == "both" else _INITIALIZED[axis]
        answers = await self.motion.client.status(ids)
        return [i for i, a in answers.items() if a.ok and a.values[0] & wanted == wanted]

    async def _book(self, ids: list[int], axis: str) -> None:
        """Keeps what was found, then sees whether all are where they report."""
        if axis == "alpha":
            self._alpha |= {int(r) for r in self._plane.index_of(ids)}
        else:
            self.found += ids
        await self.motion.searched(ids, datum=False)
        await self._count_turns(ids, axis)
        await self.motion.searched(ids, datum=axis != "alpha")

    async def _count_turns(self, ids: list[int], axis: str) -> None:
        """The stop says the angle of the motor, not always its turn: where the image does, it is declared.

        Looked at folded: there the maps are good, and the approach has closed the backlash as usual.
        """
        motion, rows = self.motion, np.asarray(self._plane.index_of(ids))
        if not len(rows) or not self._counts:
            return
        await self._fold()
        here_deg = motion.state.here_deg[rows]
        seen_mm = motion.moves[-1].measurement.xy_mm[rows] - self._misses_mm[rows]
        turns = _turns_off(self._plane, rows, here_deg, seen_mm, axis)
        off = np.flatnonzero(turns.any(axis=1))
        gear = np.array([a.gear for a in self._plane.instrument.axes])
        right_deg = motion.state.wire_deg[rows] + turns * 360.0 / gear
        await motion.client.set_position(self._plane.positioner_id[rows[off]].tolist(), *right_deg[off].T)
        for k in off:
            text = f"datum found {turns[k].tolist()} motor turns off, by the image; declared so"
            motion.recorder.event("datum", text, self._id(rows[k]))

    def _learn_misses(self) -> None:
        """By how much the maps err where all are folded, before a search can change what is reported.

        A motor turn of alpha moves a folded fibre by 45 um (SDSS-V): no more than twice what maps may err by.
        """
        if (image := self.motion.image) is None:
            return
        miss_mm = image.xy_mm - self._plane.forward(*self.motion.state.here_deg.T)
        known = self._folded() & (np.hypot(*miss_mm.T) < TURN_MM)
        self._misses_mm = np.where(known[:, None], miss_mm, 0.0)

    async def _fold(self) -> None:
        state = self.motion.state
        if (np.abs(state.here_deg - self._plane.park_deg).max(axis=1)[state.mobile] > 0.0).any():
            await self.motion.go(Goals.without_targets(self._plane, self._plane.park_deg))

    def _folded(self) -> Flags:
        off_deg: Floats = np.abs(self.motion.state.here_deg - self._plane.park_deg).max(axis=1)
        return np.asarray(off_deg < FOLDED_DEG)


def near_stop_deg(plane: FocalPlane, rows: list[int], here_deg: Floats) -> Floats:
    """(n,) deg: beta from which to search these `rows` of the `plane`, which are at `here_deg` (N, 2).

    Near the stop, but on the way of a plan, and not farther from the stop than each is.
    """
    near_deg = plane.stops_of(np.asarray(rows))[:, 1, 0] + NEAR_DEG
    travels = travels_rad(plane)
    low = travel_rad(plane)[1, 0] if travels is None else travels[rows, 1, 0]
    return np.minimum(np.maximum(near_deg, rad_to_deg(low)), here_deg[rows, 1])


def _turns_off(plane: FocalPlane, rows: Ints, here_deg: Floats, seen_mm: Floats, axis: str) -> Ints:
    """(n, 2) motor turns to add to what these report, so that the image fits; 0 where it fits as it is.

    `rows` (n,) of the `plane`, reported at `here_deg` (n, 2) and seen at `seen_mm` (n, 2); `axis`: that
    was searched, or both.
    """
    turn_deg = np.array([360.0 / a.gear for a in plane.instrument.axes])
    some, few, none = range(-3, 4), range(-1, 2), (0,)  # of both axes at once more would look alike
    steps = {"alpha": (some, none), "beta": (none, some), "both": (few, few)}[axis]
    tried = np.array([(a, b) for a in steps[0] for b in steps[1]])
    turned = [(here_deg + k * turn_deg).T for k in tried]
    places = [plane.forward(alpha_deg, beta_deg, index=rows) for alpha_deg, beta_deg in turned]
    miss_mm = np.stack([np.hypot(*(seen_mm - place).T) for place in places])
    miss_mm = np.where(np.isfinite(miss_mm), miss_mm, np.inf)
    best, as_is = miss_mm.argmin(axis=0), np.flatnonzero(~tried.any(axis=1))[0]
    clear = (miss_mm.min(axis=0) < TURN_MM) & (miss_mm[as_is] > TURN_MM)
    return np.where(clear[:, None], tried[best], 0)
