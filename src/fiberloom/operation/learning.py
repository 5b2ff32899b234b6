"""Every measured move of an observation teaches the maps (Kronig 2020, Section 4.3).

The observation itself goes on with the maps that it began with: its corrections already weigh what
each image says, and would do it twice. What was learnt is used from the next one on.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fiberloom.calibration.adaptive.calibration import AdaptiveCalibration
from fiberloom.health.status import FAULTS, FibreStatus
from fiberloom.metrology import Measurement
from fiberloom.operation.move import Move, Recorder
from fiberloom.typing import Floats, Ints

Keep = Callable[[AdaptiveCalibration, Ints], None]
"""Stores the states of these rows."""

_TELL_NOTHING = FAULTS | {FibreStatus.OFFLINE}


class LearningRecorder:
    """Records as another one does, and learns from each move before the next begins."""

    def __init__(self, recorder: Recorder, learner: AdaptiveCalibration, keep: Keep) -> None:
        self._recorder, self.learner, self._keep = recorder, learner, keep
        self.n_used = 0
        """Measurements learnt from."""
        self.n_refused = 0
        """Measurements that surprised too much."""

    def move(self, move: Move) -> None:
        """First what was measured is safe; then it is learnt from, and that is kept."""
        self._recorder.move(move)
        rows = informative(move)
        if len(rows) == 0:
            return
        xy_mm = move.measurement.xy_mm[rows]
        done = self.learner.update(move.wire_deg[rows], xy_mm, index=rows)
        self.n_used += int(done.used.sum())
        self.n_refused += int((np.isfinite(done.surprise) & ~done.used).sum())
        self._keep(self.learner, rows)

    def start(self, here_deg: Floats, wire_deg: Floats, image: Measurement) -> None:
        """Nothing to learn yet."""
        self._recorder.start(here_deg, wire_deg, image)

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """A flag or a remark."""
        self._recorder.event(kind, text, positioner_id)


def informative(move: Move) -> Ints:
    """Rows of those who moved, came to rest by a whole approach, were seen and are to be trusted."""
    if move.interrupted:
        return np.empty(0, dtype=np.int64)
    moved = np.array([robot.moves for robot in move.plan.robots])
    trusted = np.array([status not in _TELL_NOTHING for status in move.status])
    return np.flatnonzero(moved & trusted & move.measurement.seen)
