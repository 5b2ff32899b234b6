"""Referencing a field: before the first move, each positioner without a datum on record gets one.

What the camera proves is declared; what it cannot prove is searched, where the neighbours are clear:

1. One that is seen elsewhere than it reports, by what whole motor turns explain, is told those turns.
2. Those that are seen where they report, within what the begin check allows, are told that they are there.
   They may be off by a turn or two, which is not seen of a folded arm.
3. So they unfold, by a verified plan, to places where a turn of either motor shows. There the camera counts
   the turns; those that are off are told so. One of the first step whose turns are not proved there searches
   its datum. Before any search all fold again; without one they stay, for the next plan begins anywhere.
4. One that the image does not show searches its datum, as `fiberloom home` does. It is folded but for some
   motor turns, if it says that its position was restored; else it may be anywhere, and its whole reach has to
   be free. So does one that is seen where no turns explain it. And so do all where the layout itself is not
   known yet: an image says no number of turns for certain then. They unfold nevertheless, which shows what
   does not follow.

What none of this reaches stays an obstacle, as the begin check has it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Measurement
from fiberloom.operation.field_state import DID_NOT_FOLLOW
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.move import Goals, Move, Recorder
from fiberloom.operation.reference.declare import PowerUp, declare, declare_seen_right, powered_up
from fiberloom.operation.reference.turns import CountedTurns, TurnCounter, told_apart_mm
from fiberloom.operation.safety.begin import NAMED, Standing
from fiberloom.operation.safety.seen import SCATTER_MM
from fiberloom.operation.session.clearing import FOLDED_DEG
from fiberloom.operation.session.home import Homing
from fiberloom.planning.placing import place_by_worth
from fiberloom.typing import Flags, Floats, Ints

KIND = "referenced"
"""Of the events that say how."""

ALPHAS, BETAS_DEG = 24, np.arange(60.0, 125.0, 10.0)
"""Places that are tried for an unfolded arm: so many directions, and where a turn of either motor shows."""

WAY_MM_DEG = 3e-4
"""What a place is worth less for each degree of the way to it: most turns show after some seconds."""

OTHER_DEG = 30.0
"""Of alpha, by which a further place differs: what arms and zeros err by has turned with the arm."""

POSES = 3
"""Unfolded places, at most, in which turns are counted."""

TRIES = 3
"""Begin checks after which positioners are told motor turns before anything moves."""

NEW_DEG = 2.0
"""So far from where its turns were counted, on one axis, a place tells more of them."""

EXPLAINED_MM = 3.0 * SCATTER_MM
"""So near to a number of turns one has to be seen, to be told them before it moves."""

NOT_SEARCHED = frozenset({Standing.SWAPPED, Standing.SILENT, Standing.OFFLINE})
"""Standings that no search mends."""


@dataclass
class Referenced:
    """How the positioners without a datum were referenced; numbers of positioners."""

    as_reported: list[int] = field(default_factory=list)
    """Seen where they report, and told so."""
    turned: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Told to be whole motor turns of alpha and beta from where they reported."""
    searched: list[int] = field(default_factory=list)
    """Have found their datum at the hard stops."""
    left: dict[int, str] = field(default_factory=dict)
    """Why one was not referenced: it is an obstacle."""
    not_counted: list[int] = field(default_factory=list)
    """Of those as reported: seen well enough to move, not to count their turns."""

    def __bool__(self) -> bool:
        """Whether one had no datum on record."""
        return bool(self.as_reported or self.turned or self.searched or self.left)

    def as_dict(self) -> dict[str, int]:
        """How many, for summary.json."""
        return {
            "seen where they report": len(self.as_reported),
            "turns counted by the camera": len(self.turned),
            "datum searched": len(self.searched),
            "not referenced": len(self.left),
        }


async def reference(motion: FieldMotion) -> Referenced:
    """References the field of `motion`, after its begin check and before its first move.

    Returns how, empty where the datum of every positioner is on record. The moves that it takes are no moves
    of the observation or calibration: they are in the events. Raises UnsafePlanError where the verifier
    refuses a plan.
    """
    if motion.hardware.drive is not None:
        return Referenced()  # whole motor turns are a matter of SDSS-V's counters
    power_up = await powered_up(motion)
    if not power_up.lost.any():
        return Referenced()
    motion.progress(f"referencing: {int(power_up.lost.sum())} positioners have no datum on record")
    with _apart(motion):
        done = await _Referencing(motion, power_up).run()
    if motion.image is not None:
        motion.recorder.start(motion.state.here_deg, motion.state.wire_deg, motion.image)
    motion.progress("referenced: " + ", ".join(f"{n} {how}" for how, n in done.as_dict().items() if n))
    return done


class _EventsOnly:
    """Keeps events; measurements with counters that are not referenced yet are none."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self.event = recorder.event

    def move(self, move: Move) -> None:
        """An event: how far."""
        n = sum(robot.moves for robot in move.plan.robots)
        self.event(KIND, f"{n} positioners moved for it, in {move.motion_s:.1f} s", None)

    def start(self, here_deg: Floats, wire_deg: Floats, image: Measurement) -> None:
        """Nothing: where all begin is measured when they are referenced."""

    def left(self, here_deg: Floats, wire_deg: Floats, answered: Flags, why: str) -> None:
        """Where each was left after a stop: as the recorder itself."""
        self._recorder.left(here_deg, wire_deg, answered, why)


@contextmanager
def _apart(motion: FieldMotion) -> Iterator[None]:
    """What is moved meanwhile is no part of the observation or calibration."""
    recorder, images = motion.recorder, motion.images
    motion.recorder = motion.state.recorder = _EventsOnly(recorder)
    motion.images, motion.keeps_faults = 1, True
    try:
        yield
        motion.moves.clear()
        motion.underway = 0
    finally:
        motion.recorder = motion.state.recorder = recorder
        motion.images, motion.keeps_faults = images, False


class _Referencing:
    """Of one field; arrays over its N positioners."""

    def __init__(self, motion: FieldMotion, power_up: PowerUp) -> None:
        self.motion, self.lost, self.restored = motion, power_up.lost, power_up.restored
        self.done = Referenced()
        self.dark = np.zeros_like(self.lost)
        self.guessed = np.zeros_like(self.lost)
        """(N,) told the likeliest turns, which no unfolded arm has proved yet."""
        self.counted_deg: Floats = np.full((len(self.lost), 2), np.inf)
        """(N, 2) where each was when its turns were last counted."""
        self.unfolded = False
        self.layout_known = motion.state.looser_mm == 0.0

    @property
    def _plane(self) -> FocalPlane:
        return self.motion.plane

    def _ids(self, flags: Flags) -> list[int]:
        return [int(p) for p in self._plane.positioner_id[flags]]

    async def run(self) -> Referenced:
        """References all that can be."""
        await self._presume_the_dark()
        for _ in range(TRIES):
            if not await self._tell_those_elsewhere():
                break
        await declare_seen_right(self.motion)
        await self._count_turns()
        if await self._search() or self.dark.any() or not self.unfolded:
            self.motion.presumed[:] = False
            await self.motion.begin_again(by_last_image=not self.motion.has_moved)
        await declare_seen_right(self.motion)
        self._book()
        return self.done

    # by the camera

    async def _tell_those_elsewhere(self) -> bool:
        """Those that are seen elsewhere, by what whole turns explain: they are told the likeliest ones.

        True where there were some. Others may be known in the same image once these are.
        """
        state, image = self.motion.state, self.motion.image
        beginning = state.beginning
        if image is None or beginning is None:
            return False
        named = np.array([s in NAMED - NOT_SEARCHED for s in beginning.standing])
        asked = self.lost & named & ~state.mobile & image.seen
        if not asked.any():
            return False
        reported_deg = self.motion.reported_deg
        counter = TurnCounter(self._plane)
        counter.add(reported_deg, image.xy_mm)
        # of a layout that is not known an image does not prove turns; without any these stay where they are
        turns, miss_mm = counter.nearest(reported_deg, image.xy_mm, some=not self.layout_known)
        rows = np.flatnonzero(asked & (miss_mm < EXPLAINED_MM) & turns.any(axis=1))
        await self._tell_turns(rows, turns[rows])
        self.guessed[rows] = True
        if len(rows):
            await self.motion.begin_again(by_last_image=True)
        return bool(len(rows))

    async def _presume_the_dark(self) -> None:
        """Those that no image shows are taken to be where they report, until they have searched.

        Only those that are folded, and whose positions were restored as power came on: only motor
        turns are in doubt. They do not move before, but the others can pass.
        """
        folded = np.abs(self.motion.reported_deg - self._plane.park_deg).max(axis=1) < FOLDED_DEG
        self.dark = self.restored & folded & self.motion.state.standing(Standing.DARK)
        if self.dark.any():
            self.motion.presumed[self.dark] = True
            await self.motion.begin_again(by_last_image=True)

    async def _tell_turns(self, rows: Ints, turns: Ints) -> None:
        taken = await declare(self.motion, rows, turns)
        for row, (alpha, beta) in zip(rows[taken].tolist(), turns[taken].tolist(), strict=True):
            number = int(self._plane.positioner_id[row])
            before = self.done.turned.get(number, (0, 0))
            self.done.turned[number] = (before[0] + alpha, before[1] + beta)
            text = f"{alpha:+d} motor turns of alpha and {beta:+d} of beta, by the image; told so"
            self.motion.recorder.event(KIND, text, number)

    async def _count_turns(self) -> None:
        """Unfolds those that may move, and counts their motor turns by the image.

        Where no turns can be told it still shows which do not follow, before others search beside them.
        """
        motion = self.motion
        asked = self.lost & motion.state.mobile & ~self.dark
        if not asked.any():
            return
        counter = TurnCounter(self._plane)
        self._look_at(counter)
        for pose in range(POSES if self.layout_known else 1):
            goals_deg = await asyncio.to_thread(self._unfolded, pose)
            await motion.go(Goals.without_targets(self._plane, goals_deg))
            self._look_at(counter)
            counted = counter.counted()
            if counted.proven[asked & motion.state.mobile].all():
                break
        if self.layout_known:
            await self._tell_counted(asked, counted)
        self.unfolded = True
        await motion.begin_again(by_last_image=True)

    async def _fold(self) -> None:
        """All that may move, after turns were counted."""
        home_deg = np.where(self.dark[:, None], self.motion.state.here_deg, self._plane.park_deg)
        await self.motion.go(Goals.without_targets(self._plane, home_deg))

    async def _tell_counted(self, asked: Flags, counted: CountedTurns) -> None:
        off = asked & self.motion.state.mobile & counted.proven & counted.turns.any(axis=1)
        await self._tell_turns(np.flatnonzero(off), counted.turns[off])
        self.guessed &= ~counted.proven
        self.done.not_counted = self._ids(asked & ~counted.proven & ~self.guessed)
        if self.done.not_counted:
            self._say_not_counted(counted)

    def _look_at(self, counter: TurnCounter) -> None:
        state, image = self.motion.state, self.motion.image
        if image is not None:
            # a count that is doubted says nothing, nor the same place again: arms err there by the same
            elsewhere = (np.abs(state.here_deg - self.counted_deg) > NEW_DEG).any(axis=1)
            good = image.seen & state.mobile & elsewhere
            self.counted_deg[good] = state.here_deg[good]
            counter.add(state.here_deg, np.where(good[:, None], image.xy_mm, np.nan))

    def _unfolded(self, pose: int) -> Floats:
        """(N, 2) deg: where a turn of either motor shows, free of collisions; others in each `pose`."""
        alpha = (np.arange(ALPHAS) + (pose + 1.0) / (POSES + 1.0)) * 360.0 / ALPHAS
        grid = np.stack(np.meshgrid(alpha, BETAS_DEG, indexing="ij"), axis=-1).reshape(-1, 2)
        places_deg = np.tile(grid, (len(self._plane), 1, 1))
        state = self.motion.state
        way_deg = np.abs(places_deg - state.here_deg[:, None])
        worth_mm = told_apart_mm(self._plane, places_deg) - WAY_MM_DEG * way_deg.max(axis=2)
        if pose:  # the same place again tells nothing new
            worth_mm -= np.where(way_deg[:, :, 0] < OTHER_DEG, 1.0, 0.0)
        goals_deg = place_by_worth(state.obstacles(), places_deg, worth_mm, pose)
        return np.where((state.mobile & ~self.dark)[:, None], goals_deg, state.here_deg)

    def _say_not_counted(self, counted: CountedTurns) -> None:
        n = len(self.done.not_counted)
        text = f"the turns of {n} positioners are not told by the image: fibres scatter by "
        text += f"{1e3 * counted.scatter_mm:.0f} um about where they report; they are taken as reported"
        self.motion.recorder.event(KIND, text, None)

    # by the hard stops

    async def _home(self, rows: Ints) -> list[int]:
        """Searches the datum of those in `rows`, as `home` does; which were found."""
        homing = Homing(self.motion, rows, counts_turns=self.layout_known)
        await homing.run()
        self.done.searched += sorted(homing.found)
        for number in sorted(homing.found):
            self.motion.recorder.event(KIND, "its datum was searched and found", number)
        self.done.left |= homing.left_out
        return homing.found

    async def _search(self) -> bool:
        """Those that the camera does not prove search their datums, among folded neighbours; whether anything
        has moved for it."""
        if not self._doubted().any():
            return False
        if self.unfolded:
            await self._fold()
        if (asked := self._doubted()).any():  # folding shows who does not follow
            await self._home(np.flatnonzero(asked))
        return True

    def _doubted(self) -> Flags:
        """(N,) those that can search, and that no image proves."""
        state = self.motion.state
        beginning = state.beginning
        standing = beginning.standing if beginning is not None else [None] * len(self._plane)
        able: Flags = np.array([one not in NOT_SEARCHED for one in standing])
        able &= np.array([fault not in DID_NOT_FOLLOW for fault in state.faults])
        tried = np.isin(self._plane.positioner_id, [*self.done.searched, *self.done.left])
        camera_fails = (
            self.dark | self.guessed | ~state.mobile if self.layout_known else np.ones_like(self.dark)
        )
        doubted: Flags = self.lost & able & ~tried & camera_fails
        return doubted

    def _book(self) -> None:
        """Who is left, and who was taken as reported."""
        state = self.motion.state
        searched = set(self.done.searched)
        self.done.turned = {p: turns for p, turns in self.done.turned.items() if p not in searched}
        other = {*self.done.turned, *searched}
        for row in np.flatnonzero(self.lost & ~state.mobile).tolist():
            number = int(self._plane.positioner_id[row])
            if number not in other:
                self.done.left.setdefault(number, state.why.get(row, "not seen where it reports"))
        self.done.left = {p: why for p, why in self.done.left.items() if p not in self._ids(state.mobile)}
        for number, why in self.done.left.items():
            self.motion.recorder.event(KIND, f"not referenced: {why}", number)
        other |= set(self.done.left)
        self.done.as_reported = [p for p in self._ids(self.lost) if p not in other]
