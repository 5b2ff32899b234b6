"""Every measured move of an observation teaches the maps (Kronig 2020, Section 4.3).

The observation itself keeps the maps with which it began: its corrections weigh each image already,
and with maps that had learnt from it the image would count twice. What was learnt is used from the
next observation on.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fiberloom.calibration.adaptive.calibration import AdaptiveCalibration
from fiberloom.calibration.adaptive.expansion import ungrown_mm
from fiberloom.health.status import FAULTS, FibreStatus
from fiberloom.metrology import Measurement
from fiberloom.operation.care.warm_arms import WarmArms
from fiberloom.operation.move import Move, Recorder
from fiberloom.typing import Flags, Floats, Ints

Keep = Callable[[AdaptiveCalibration, Ints], None]
"""A function that stores the states of these rows."""

_TELL_NOTHING = FAULTS | {FibreStatus.OFFLINE}


class PassingRecorder:
    """Hands everything on to another recorder."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder

    def move(self, move: Move) -> None:
        """Records the move."""
        self._recorder.move(move)

    def start(self, here_deg: Floats, wire_deg: Floats, image: Measurement) -> None:
        """Records the start; nothing moved, so nothing is learnt."""
        self._recorder.start(here_deg, wire_deg, image)

    def left(self, here_deg: Floats, wire_deg: Floats, answered: Flags, why: str) -> None:
        """Passes on where each was left after a stop.

        `here_deg`, `wire_deg`: (N, 2) angles and wire positions as reported; `answered` (N,): which have;
        `why`: for the operator.
        """
        self._recorder.left(here_deg, wire_deg, answered, why)

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """Records a fault or a remark."""
        self._recorder.event(kind, text, positioner_id)


class GrowthRecorder(PassingRecorder):
    """Looks at each move for how long the arms are."""

    def __init__(self, recorder: Recorder, warmth: WarmArms) -> None:
        super().__init__(recorder)
        self._warmth = warmth

    def move(self, move: Move) -> None:
        """Records the move first."""
        super().move(move)
        counted = np.zeros(len(move.status), dtype=bool)
        counted[informative(move)] = not move.comparison
        self._warmth.look(move.wire_deg, move.measurement.xy_mm, counted)


class LearningRecorder(PassingRecorder):
    """Learns from each move before the next begins."""

    def __init__(
        self, recorder: Recorder, learner: AdaptiveCalibration, keep: Keep, growth: float = 0.0
    ) -> None:
        """`learner`: of arms as they were calibrated; `keep`: stores its states; `growth`: of the arms since,
        by the temperature, a ratio, which is taken off what is measured."""
        super().__init__(recorder)
        self.learner, self._keep, self._growth = learner, keep, growth
        self.n_used = 0
        """Measurements learnt from."""
        self.n_refused = 0
        """Measurements too far from the expected position to learn from."""

    def move(self, move: Move) -> None:
        """Records the move first; then learns from it and stores the states."""
        super().move(move)
        rows = informative(move)
        if len(rows) == 0:
            return
        centres_mm = self.learner.plane.centres_mm[rows]
        xy_mm = ungrown_mm(move.measurement.xy_mm[rows], centres_mm, self._growth)
        done = self.learner.update(move.wire_deg[rows], xy_mm, index=rows)
        self.n_used += int(done.used.sum())
        self.n_refused += int((np.isfinite(done.surprise) & ~done.used).sum())
        self._keep(self.learner, rows)


def informative(move: Move) -> Ints:
    """Rows of positioners that moved, ended with a whole approach, were seen and have no fault."""
    if move.interrupted:
        return np.empty(0, dtype=np.int64)
    moved = np.array([robot.moves for robot in move.plan.robots])
    trusted = np.array([status not in _TELL_NOTHING for status in move.status])
    return np.flatnonzero(moved & trusted & move.measurement.seen)
