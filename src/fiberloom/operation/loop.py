"""The loop: blind move, image, corrections, decision (Kronig 2020, Section 4.1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fiberloom.assignment import Assignment
from fiberloom.instruments.model import Operation
from fiberloom.operation.correction import CorrectionLoop, whole_steps
from fiberloom.operation.motion import RECOVERIES, FieldMotion
from fiberloom.operation.move import Goals, Move
from fiberloom.operation.stopping import StopRule
from fiberloom.planning import plan_corrections
from fiberloom.typing import Flags, Floats


@dataclass(frozen=True)
class LoopSettings:
    """How the loop is run; `moves` counts the blind move, and is the most that a stop rule allows."""

    moves: int = 3
    stop: StopRule = field(default_factory=StopRule)
    filtered: bool = True
    compare_linear: bool = False
    seed: int = 0
    recoveries: int = RECOVERIES

    @classmethod
    def of(cls, operation: Operation, moves: int | None = None, **others: Any) -> LoopSettings:
        """The instrument's rule and its corrections; with `moves`: exactly so many moves."""
        if moves is not None:
            return cls(moves=moves, **others)
        return cls(moves=1 + operation.corrections_max, stop=StopRule.of(operation), **others)


class Loop:
    """Takes a field from where its positioners are to the goals of an assignment, ever nearer."""

    def __init__(
        self,
        motion: FieldMotion,
        assignment: Assignment,
        settings: LoopSettings,
        map_sigma_deg: Callable[[Floats], Floats] | None = None,
    ) -> None:
        """`map_sigma_deg` tells how far the maps may be off at wire positions (N, 2), where known."""
        self.motion, self.settings, self.map_sigma_deg = motion, settings, map_sigma_deg
        self.plane, self.maps = motion.plane, motion.maps
        self.goals = Goals.of(assignment)
        self.stopped = ""
        """Why the loop made no further correction."""
        self._arrived = np.zeros(len(self.plane), dtype=bool)

    @property
    def moves(self) -> list[Move]:
        """All moves so far."""
        return self.motion.moves

    @property
    def goal_deg(self) -> Floats:
        """Ideal angles (N, 2) of the assignment."""
        return self.goals.angles_deg

    @property
    def correctable(self) -> Flags:
        """Positioners with a target that are worth another move."""
        return self.motion.state.healthy & self.goals.has_target

    async def run(self) -> list[Move]:
        """Blind move with recovery, then the corrections."""
        await self.blind_move()
        corrections = CorrectionLoop(
            self.plane, self.goal_deg, filtered=self.settings.filtered, sigma_deg=self._expected_deg()
        )
        for number in range(2, self.settings.moves + 1):
            if self.settings.stop.satisfied(self._open_um()):
                break
            await self.correct(corrections, number)
        self.stopped = self._why_stopped()
        if self.settings.compare_linear:
            await self.linear_move()
        return self.moves

    def _open_um(self) -> Floats:
        """Last measured distances (n,) of the fibres with a target that are seen and healthy and
        that the stop rule has not let go."""
        error_um = self.moves[-1].measured_error_um
        self._arrived |= self.settings.stop.arrived(error_um)
        return error_um[self.correctable & np.isfinite(error_um) & ~self._arrived]

    def _why_stopped(self) -> str:
        stop, open_um = self.settings.stop, self._open_um()
        why = stop.explain(open_um)
        if stop.satisfied(open_um):
            return why
        return ", ".join(filter(None, [f"all {self.settings.moves} moves made", why]))

    async def blind_move(self) -> None:
        """Go to the goals by the maps; go round positioners that turn out not to move."""
        await self.motion.go(self.goals, self.settings.seed, self.settings.recoveries)

    def _expected_deg(self) -> Floats | None:
        """How far the blind move may miss (N, 2), where operation has taught the maps."""
        if self.map_sigma_deg is None:
            return None
        return self.map_sigma_deg(self.maps.to_wire(self.goal_deg))

    async def correct(self, corrections: CorrectionLoop, number: int) -> None:
        """Weigh the last image and move every healthy positioner with a target by what it says.

        A positioner that the stop rule has let go stays; a correction is made of whole steps.
        """
        image, here_deg = self.moves[-1].measurement, self.motion.state.here_deg
        wanted_deg = corrections.update(
            here_deg, image.xy_mm, self.correctable & image.seen, image.covariance_mm2
        )
        step_deg = np.array([axis.step_deg for axis in self.plane.instrument.axes])
        goal_deg = whole_steps(here_deg, wanted_deg, step_deg)
        goal_deg = np.where(self._arrived[:, None], here_deg, goal_deg)
        await self._small_move(number, f"correction {number - 1}", goal_deg)

    async def linear_move(self) -> None:
        """What a blind move by a linear gear ratio gives, for comparison (Fig. 26).

        The same approach to the same angles; only the motor angles are those of the linear ratio.
        """
        linear = self.maps.linear()
        # where the linear ratio has to aim, in the angles of the maps by which the field is known
        aim_deg = self.maps.to_output(linear.to_wire(self.goal_deg))
        await self._small_move(len(self.moves) + 1, "linear ratio", aim_deg, comparison=True)

    async def _small_move(
        self, number: int, label: str, wanted_deg: Floats, comparison: bool = False
    ) -> None:
        self.motion.progress(label)
        state = self.motion.state
        planned = plan_corrections(
            state.obstacles(),
            state.here_deg,
            np.where(self.correctable[:, None], wanted_deg, state.here_deg),
            approach_deg=self.goals.approach_deg,
        )
        await self.motion.move(number, label, planned, self.goals, comparison)
