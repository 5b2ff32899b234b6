"""Finds positioners of which it is not certain where they are: a small move of one of them, then an image.

A move is made only where it is proven clear for every place at which the positioner may be, and for every
other one that is not certain, in case their numbers on the bus are exchanged.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

import numpy as np

from fiberloom.bus.outcome import Outcome
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Measurement
from fiberloom.operation.safety.begin import Standing
from fiberloom.operation.safety.explore import (
    SPEED_DEG_S,
    WAYS_DEG,
    Doubt,
    at_spot,
    found_place,
    is_clear,
    places_of,
    possible,
)
from fiberloom.operation.session.motion import SessionMotion
from fiberloom.operation.session.states import SessionState, Step
from fiberloom.typing import Floats

UNFOLDING = 8
"""Moves in which an arm that is folded onto its axis is unfolded until its direction shows."""

TELLS_NOTHING = frozenset({Standing.SWAPPED, Standing.BEYOND})
"""Standings of which a small move tells no more: numbers exchanged, or its place is known."""

BEYOND_MM = 0.5
"""A spot that is so far out of the reach of an arm is none of its own."""


ELBOW_DEG = 5.0
"""Beta of two places with the elbow on either side differs by more, but near a stretched or folded arm."""


@dataclass
class Exploration:
    """Explores one field, one positioner at a time."""

    motion: SessionMotion
    """After its begin check, nothing touching anything."""
    look_only: bool = False
    """Say what would be done; move nothing."""
    found: list[int] = field(default_factory=list)
    """Positioners that were found, told so, and passed the begin check."""
    stages: list[str] = field(default_factory=list)
    """What was done, or would be."""
    left_out: dict[int, str] = field(default_factory=dict)
    """Why a positioner was not found, and what to do."""

    async def run(self) -> None:
        """Explores all that can be; again what one that was found has made room for."""
        found = -1
        while found < len(self.found) and not (self.look_only and found >= 0):
            found = len(self.found)
            for row in np.flatnonzero(self.motion.state.unproven).tolist():
                if self.motion.state.unproven[row] and not await self._explore(row):
                    return

    @property
    def _plane(self) -> FocalPlane:
        return self.motion.plane

    def _id(self, row: int) -> int:
        return int(self._plane.positioner_id[row])

    def _leave_out(self, row: int, why: str) -> None:
        self.left_out[self._id(row)] = f"{why}; `fiberloom home --only {self._id(row)}`, or exclude it"

    async def _explore(self, row: int) -> bool:
        """Looks for one positioner; False: something was touched, nothing more may move."""
        doubt = await asyncio.to_thread(self._doubt, row)
        if doubt is None:
            return True
        for _ in range(UNFOLDING if self._is_folded(row) else 1):
            way = await asyncio.to_thread(self._way, doubt)
            if way is None:
                text = f"no small move is proven clear for the {len(doubt.places_deg)} places where it may be"
                self._leave_out(row, text)
                return True
            self._say(row, way, len(doubt.places_deg))
            if self.look_only:
                return True
            await self._bring_into_range(doubt, way)
            if not await self._move(row, way):
                return await self._forget()
            doubt = Doubt(row, doubt.places_deg + np.array(way)) if self._is_folded(row) else doubt
            place_deg = self._concluded(doubt, way)
            if place_deg is not None:
                await self._declare(row, place_deg)
                return True
        self._leave_out(row, "the image after its move shows no place at which it alone can be")
        return await self._forget()

    async def _forget(self) -> bool:
        """The begin check anew, after a move that told nothing; False after a collision."""
        if self.motion.lock.state is SessionState.LOCKED:
            return False
        await self.motion.begin_again()
        return True

    # where it may be

    def _is_folded(self, row: int) -> bool:
        beginning = self.motion.state.beginning
        return beginning is not None and beginning.standing[row] is Standing.BLIND

    def _doubt(self, row: int) -> Doubt | None:
        """Every place at which it may be; None where a move would tell nothing, which is said."""
        state, image = self.motion.state, self.motion.image
        if image is None or state.beginning is None:
            return None
        if state.beginning.standing[row] in TELLS_NOTHING:
            self._leave_out(row, state.beginning.text[row])
            return None
        reported_deg = self.motion.reported_deg[row]
        spots_mm = self._spots(row, image)
        if self._is_folded(row):
            doubt = places_of(self._plane, row, spots_mm, reported_deg, folded=True)
        elif not len(spots_mm):
            self._leave_out(row, "its fibre is not seen, so a move would tell nothing")
            return None
        elif image.seen[row]:  # the spot is its own: it is not where it reports
            doubt = Doubt(row, at_spot(self._plane, row, spots_mm[0]))
        else:
            doubt = places_of(self._plane, row, spots_mm, reported_deg, folded=False)
        doubt = possible(state.obstacles(but=row), state.here_deg, doubt)
        if not len(doubt.places_deg):
            self._leave_out(row, "wherever it may be it would be in another arm")
            return None
        return doubt

    def _spots(self, row: int, image: Measurement) -> Floats:
        """(n, 2) spots that may be its own: the one that is, else those that belong to none."""
        if image.seen[row]:
            return np.asarray(image.xy_mm[[row]])
        loose_mm = np.zeros((0, 2)) if image.loose_mm is None else image.loose_mm
        reach_mm = self._plane.l_alpha_mm[row] + self._plane.l_beta_mm[row] + BEYOND_MM
        return np.asarray(loose_mm[np.hypot(*(loose_mm - self._plane.centres_mm[row]).T) < reach_mm])

    # the move

    def _way(self, doubt: Doubt) -> tuple[float, float] | None:
        """The first small move that is clear wherever it is, and for others that are not certain."""
        state = self.motion.state
        others = [i for i in np.flatnonzero(state.unproven & ~state.somewhere).tolist() if i != doubt.row]
        doubts = [doubt, *(Doubt(i, state.here_deg[[i]]) for i in others)]
        ways = [way for way in WAYS_DEG if way[0] == 0.0] if self._is_folded(doubt.row) else WAYS_DEG
        return next((way for way in ways if all(self._clear(d, way) for d in doubts)), None)

    def _clear(self, doubt: Doubt, way: tuple[float, float]) -> bool:
        state = self.motion.state
        return is_clear(state.obstacles(but=doubt.row), state.here_deg, doubt, way)

    def _say(self, row: int, way: tuple[float, float], n: int) -> None:
        text = f"positioner {self._id(row)} by {way[0]:g}, {way[1]:g} deg, clear for {n} possible places"
        self.stages.append(text)
        self.motion.progress(text)
        if not self.look_only:
            self.motion.recorder.event("explore", text, self._id(row))

    async def _bring_into_range(self, doubt: Doubt, way: tuple[float, float]) -> None:
        """One that reports to be beyond its stops refuses to move: it is told one of its possible places."""
        row, stops = doubt.row, self._plane.hard_stops_deg
        ends = self.motion.reported_deg[row] + np.array([(0.0, 0.0), way])
        if (ends < stops[:, 0] + 1.0).any() or (ends > stops[:, 1] - 1.0).any():
            await self._tell(row, doubt.places_deg[0])
            await self.motion.read_positions(self._plane.positioner_id[[row]])

    async def _tell(self, row: int, place_deg: Floats) -> None:
        wire_deg = self.motion.maps.path_to_wire(row, place_deg[None])
        await self.motion.client.set_position([self._id(row)], *wire_deg.T)

    async def _move(self, row: int, way: tuple[float, float]) -> bool:
        """Makes the move and looks; False where it did not end as it should."""
        result = await self.motion.nudge(row, way, max(map(abs, way)) / SPEED_DEG_S)
        if result.outcome is Outcome.COLLIDED:
            text = f"collision of positioner {self._id(row)} in a small move: `fiberloom recover`"
            self.left_out[self._id(row)] = text
            self.motion.recorder.event("alarm", text, self._id(row))
            await self.motion.step(Step.COLLIDE, text)
            return False
        await self.motion.look(self.motion.state.unproven)
        await self.motion.step(Step.REST)
        if not result.ok:
            self._leave_out(row, f"its small move ended otherwise: {result}")
        return result.ok

    # the conclusion

    def _concluded(self, doubt: Doubt, way: tuple[float, float]) -> Floats | None:
        """Where it is now, alpha and beta in deg (2,); None: that cannot be told (yet)."""
        image = self.motion.image
        spots_mm = np.zeros((0, 2)) if image is None else self._spots(doubt.row, image)
        if self._is_folded(doubt.row):
            return self._unfolded(doubt, spots_mm)
        place_deg = found_place(self._plane, doubt, way, spots_mm)
        return None if place_deg is None else self._refined(doubt.row, place_deg, spots_mm)

    def _unfolded(self, doubt: Doubt, spots_mm: Floats) -> Floats | None:
        """The direction of an arm that is far enough from its axis to show it."""
        state = self.motion.state
        if len(spots_mm) != 1 or not self.motion.shows_alpha(doubt.row, spots_mm[0]):
            return None
        places = at_spot(self._plane, doubt.row, spots_mm[0])
        near = np.abs(places[:, 1] - state.here_deg[doubt.row, 1]) < 90.0  # beta is as it reports
        return places[near][0] if near.any() else None

    def _refined(self, row: int, place_deg: Floats, spots_mm: Floats) -> Floats | None:
        """As the spot has it, with the elbow on the side that was found.

        None at either end of alpha: the image does not tell 1 deg from 361.
        """
        there_mm = self._plane.forward(place_deg[[0]], place_deg[[1]], index=[row])[0]
        spot_mm = spots_mm[np.argmin(np.hypot(*(spots_mm - there_mm).T))]
        places = at_spot(self._plane, row, spot_mm)
        same = places[np.abs(places[:, 1] - place_deg[1]) < ELBOW_DEG]
        return same[0] if len(same) == 1 else None

    async def _declare(self, row: int, place_deg: Floats) -> None:
        """Tells it where it is, and does the begin check again."""
        motion, number = self.motion, self._id(row)
        reported_deg = motion.reported_deg[row]
        await self._tell(row, place_deg)
        text = "is at {:.2f}, {:.2f} deg, and reported {:.2f}, {:.2f}; told so".format(
            *place_deg, *reported_deg
        )
        motion.recorder.event("found", text, number)
        self.stages.append(f"positioner {number} {text}")
        # its move was seen: what it counts from now on is right
        await motion.searched([number], datum=True)
        if motion.state.mobile[row]:
            self.found.append(number)
            self.left_out.pop(number, None)
        else:
            beginning = motion.state.beginning
            self._leave_out(row, "found, but " + (beginning.text[row] if beginning else "not certain"))
