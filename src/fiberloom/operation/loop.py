"""The loop: blind move, image, corrections, decision (Kronig 2020, Section 4.1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fiberloom.assignment import Assignment
from fiberloom.instruments.model import Operation
from fiberloom.operation.correction import CorrectionLoop, Corrections, SeenAims, whole_steps
from fiberloom.operation.motion import RECOVERIES, FieldMotion
from fiberloom.operation.move import Goals, Move
from fiberloom.operation.safety.writing import beside
from fiberloom.operation.series.guided import Guided, Guiding
from fiberloom.operation.series.steps import SeriesStep
from fiberloom.operation.stopping import StopRule
from fiberloom.typing import Flags, Floats

NOISIER = 1.5
"""Times the noise that the camera tells, beyond which the record says so."""


@dataclass(frozen=True)
class LoopSettings:
    """How the loop is run."""

    moves: int = 3
    """Blind move and corrections together, at most; exactly so many with a fixed stop rule."""
    stop: StopRule = field(default_factory=StopRule)
    filtered: bool = True
    """Corrections by the Kalman filter, else by Eq. 25."""
    compare_linear: bool = False
    """At the end a blind move by a linear gear ratio, for comparison."""
    seed: int = 0
    """Of the planner."""
    recoveries: int = RECOVERIES
    """How often a blind move that was stopped is planned anew."""
    images: int = 1
    """After each move, at most: as many as the noise of the camera asks for."""

    @classmethod
    def of(cls, operation: Operation, moves: int | None = None, **others: Any) -> LoopSettings:
        """The stop rule of an instrument and its number of corrections; with `moves`: exactly so many."""
        if moves is not None:
            return cls(moves=moves, **others)
        return cls(moves=1 + operation.corrections_max, stop=StopRule.of(operation), **others)


class Loop:
    """Moves a field to the goals of an assignment: the blind move, then corrections."""

    def __init__(
        self,
        motion: FieldMotion,
        assignment: Assignment,
        settings: LoopSettings,
        map_sigma_deg: Callable[[Floats], Floats] | None = None,
        steps: Sequence[SeriesStep] = (),
        guiding: Guiding | None = None,
    ) -> None:
        """`motion`: of the field; `assignment`: the goals; `settings`: number of moves and stop rule;
        `steps`: where the targets are, exposure by exposure of a series; `guiding`: by guide stars.

        `map_sigma_deg`: gives standard errors (N, 2) of the maps at wire positions (N, 2) in deg; None
        where they are not known.
        """
        self.motion, self.settings, self.map_sigma_deg = motion, settings, map_sigma_deg
        self.plane, self.maps = motion.plane, motion.maps
        self.goals = Goals.of(assignment)
        self.steps, self.guiding = steps, guiding
        self.placed: list[Move] = []
        """The move after which each exposure begins."""
        self.stopped = ""
        """Why the loop made no further correction."""
        self._arrived = np.zeros(len(self.plane), dtype=bool)
        self._noise_told = False

    @property
    def moves(self) -> list[Move]:
        """All moves so far."""
        return self.motion.moves

    @property
    def goal_deg(self) -> Floats:
        """(N, 2) alpha and beta of the assignment."""
        return self.goals.angles_deg

    @property
    def correctable(self) -> Flags:
        """(N,) positioners with a target that are healthy and not blocked."""
        return self.motion.state.healthy & self.goals.has_target

    async def run(self) -> list[Move]:
        """Blind move with recovery, then the corrections; all moves made.

        Raises UnsafePlanError where the verifier refuses a plan.
        """
        self.motion.images = self.settings.images
        if self.guiding is not None:
            self.goals = self.guiding.truly(self.goals, 0)
        await self.blind_move()
        corrections = self._corrections()
        moved = await self._guided(corrections, self.goals, 0)
        await self._corrected(corrections, self.settings.moves - 1, moved)
        self.stopped = self._why_stopped()
        for number, step in enumerate(self.steps):
            if number > 0:
                await self._reposition(corrections, step, number)
            await self._placed(corrections, step)
        if self.settings.compare_linear:
            await self.linear_move()
        return self.moves

    async def _corrected(self, corrections: Corrections, most: int, moved: bool) -> None:
        """Corrections until the stop rule has enough, or so many were made; one at least to goals that have
        `moved` since the image."""
        for done in range(most):
            self._note_arrived(last=done == most - 1)
            if not (moved and done == 0) and self.settings.stop.satisfied(self._open_um()):
                break
            await self.correct(corrections, f"correction {1 + done}")

    async def further(self, corrections: int) -> None:
        """Makes so many `corrections` more, whatever the stop rule says; after `run`."""
        how, first = self._corrections(), len(self.moves)
        for number in range(first, first + corrections):
            self._note_arrived(last=number == first + corrections - 1)
            await self.correct(how, f"correction {number}")

    async def _reposition(self, corrections: Corrections, step: SeriesStep, number: int) -> None:
        """Moves the fibres to where their targets have gone before exposure `number`."""
        goals = self.goals.gone(step.target_mm, step.angles_deg, step.short_mm)
        await self._guided(corrections, goals, number)
        self._arrived[:] = False
        await self.correct(corrections, step.label)

    async def _guided(self, corrections: Corrections, goals: Goals, number: int) -> bool:
        """Looks at the guide stars of exposure `number`; takes the `goals` where they say, and tells whether
        that has moved them."""
        found = None if self.guiding is None else await self._look_at_stars(number)
        if self.guiding is not None and found is not None:
            goals = self.guiding.aimed(goals, found)
        self.goals = goals
        corrections.follow(goals.angles_deg)
        return found is not None and found.applied is not None

    async def _look_at_stars(self, number: int) -> Guided:
        assert self.guiding is not None
        self.motion.progress("looking at guide stars")
        found = await beside(self.guiding.look, number)
        if self.settings.moves < 2 and len(self.steps) < 2:
            found = self.guiding.left_alone("no correction is to be made")
        self._tell_guiding(found)
        return found

    def _tell_guiding(self, found: Guided) -> None:
        """Into the record; to the operator where nothing is applied."""
        self.motion.recorder.event("guiding", found.text)
        if found.why_not:
            self.motion.progress(found.text)

    async def _placed(self, corrections: Corrections, step: SeriesStep) -> None:
        """Corrects those that are not as near as the step asks for, so many times at most as a field is."""
        for done in range(self.settings.moves):
            self._arrived = ~(self.moves[-1].measured_error_um > step.limit_um)
            if not (self.correctable & ~self._arrived & ~self._out_of_reach).any():
                break
            await self.correct(corrections, f"correction {1 + done}")
        self.placed.append(self.moves[-1])

    def _corrections(self) -> Corrections:
        """How an image becomes the next command, with this drive."""
        model = self.motion.drive.model
        if model.seen_is_believed:
            return SeenAims(self.plane, self.goal_deg)
        return CorrectionLoop(
            self.plane,
            self.goal_deg,
            fibre=self.goals.fibre,
            filtered=self.settings.filtered,
            noise=model.noise,
            sigma_deg=self._expected_deg(),
        )

    def _note_arrived(self, last: bool = False) -> None:
        """Which positioners are not moved again: by what their drive knows, else by the stop rule.

        `last`: no further correction will be made.
        """
        known = self.motion.drive.arrived(self.goal_deg, last)
        if known is not None:
            self._arrived = known
        else:
            self._arrived |= self.settings.stop.arrived(self.moves[-1].measured_error_um)

    def _open_um(self) -> Floats:
        """(n,) distances in the last image, of the fibres with a target that are seen and healthy and
        that the stop rule moves again."""
        error_um = self.moves[-1].measured_error_um
        return error_um[self.correctable & np.isfinite(error_um) & ~self._arrived & ~self._out_of_reach]

    @property
    def _out_of_reach(self) -> Flags:
        """(N,) whose targets have gone out of reach: no correction brings them there."""
        short_mm = self.goals.short_mm
        if short_mm is None:
            return np.zeros(len(self.plane), dtype=bool)
        return np.asarray((short_mm != 0.0).any(axis=1))

    def _why_stopped(self) -> str:
        self._note_arrived()
        stop, open_um = self.settings.stop, self._open_um()
        why = stop.explain(open_um)
        if stop.satisfied(open_um):
            return why
        return ", ".join(filter(None, [f"all {self.settings.moves} moves made", self._cut_short(), why]))

    def _cut_short(self) -> str:
        """How many moves did not come to their end, those that were made anew included."""
        cut = sum(move.interrupted for move in self.moves)
        return f"{cut} of {len(self.moves)} cut short" if cut else ""

    async def blind_move(self) -> None:
        """Moves to the goals by the maps, and round positioners that turn out not to move."""
        await self.motion.go(self.goals, self.settings.seed, self.settings.recoveries)

    def _expected_deg(self) -> Floats | None:
        """(N, 2) standard errors of the maps at the goals, where moves have taught them."""
        if self.map_sigma_deg is None:
            return None
        return self.map_sigma_deg(self.maps.to_wire(self.goal_deg))

    async def correct(self, corrections: Corrections, label: str) -> None:
        """Moves every healthy positioner with a target by what the last image shows.

        `corrections`: the state of the filter; `label`: of the move. A positioner
        that the stop rule does not move again stays, and so does one that would come no nearer; a correction
        is made of whole steps.
        """
        image, here_deg = self.moves[-1].measurement, self.motion.state.here_deg
        wanted_deg = corrections.update(here_deg, image.xy_mm, self.correctable & image.seen, image.noise_mm2)
        self._tell_noise(corrections)
        goal_deg = whole_steps(here_deg, wanted_deg, np.array(self.motion.drive.model.step_deg))
        goal_deg = np.where((self._arrived | corrections.rests)[:, None], here_deg, goal_deg)
        short_mm = 0.0 if self.goals.short_mm is None else self.goals.short_mm
        self.goals = replace(self.goals, metrology_mm=corrections.metrology_goal_mm + short_mm)
        await self._small_move(self.moves[-1].number + 1, label, goal_deg)

    def _tell_noise(self, corrections: Corrections) -> None:
        """Once, where images scatter much more than the camera tells."""
        times = np.sqrt(corrections.camera_factor)
        if times > NOISIER and not self._noise_told:
            self._noise_told = True
            text = f"images scatter {times:.1f} times as much as the camera tells; corrections weigh them so"
            self.motion.recorder.event("camera_noise", text)

    async def linear_move(self) -> None:
        """Makes a blind move by a linear gear ratio, for comparison (Fig. 26).

        The same approach to the same angles; only the motor angles are those of the linear ratio.
        """
        linear = self.maps.linear()
        # the angles by the maps at which the linear ratio arrives
        aim_deg = self.maps.to_output(linear.to_wire(self.goal_deg))
        await self._small_move(len(self.moves) + 1, "linear ratio", aim_deg, comparison=True)

    async def _small_move(
        self, number: int, label: str, wanted_deg: Floats, comparison: bool = False
    ) -> None:
        self.motion.progress(label)
        wanted = self.motion.wanted(self.goals, wanted_deg, self.correctable, small=True)
        programme = await self.motion.drive.prepare(wanted)
        await self.motion.move(number, label, programme, self.goals, comparison)
