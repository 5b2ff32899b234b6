"""Who answers, and faults that come from missing answers alone: they are taken back."""

from __future__ import annotations

import numpy as np

from fiberloom.bus.outcome import Outcome
from fiberloom.health.status import FibreStatus
from fiberloom.operation.safety.judge import Evidence, judge
from fiberloom.typing import Flags, Floats, Ints

NOT_STARTED_MOST = 2
"""A START can be lost on the way once; one that does not start so often in a row is at fault."""

FROM_SILENCE = frozenset({FibreStatus.DEAD, FibreStatus.DISCONNECTED})
"""Faults that may come from missing answers."""


class Hearing:
    """Which of N positioners answer. Arrays over them."""

    def __init__(self, n: int) -> None:
        self.heard = np.ones(n, dtype=bool)
        """(N,) told their position when they were last asked."""
        self.held_against = np.zeros(n, dtype=bool)
        """(N,) at fault because they gave no answer, or their link was down."""
        self._unchecked = np.zeros(n, dtype=bool)
        self._not_started = np.zeros(n, dtype=np.int64)
        self._asked = np.zeros(n, dtype=bool)

    def silent_at_the_begin(self, row: int) -> None:
        """Books that this one was not heard when all began: its report has never been checked."""
        self.heard[row], self.held_against[row], self._unchecked[row] = False, True, True

    def hears(self, rows: Ints, answered: Flags) -> None:
        """Books which of these rows (n,) answered (n,), after a move."""
        self._asked[:] = False
        self._asked[rows] = True
        self.heard[rows] = answered

    def taken_back(self, evidence: Evidence, allowed_mm: Floats) -> list[int]:
        """Rows whose fault was a missing answer, and that answer now from where the image has them.

        `evidence`: after a move; `allowed_mm` (N,): how far one may be seen from its report that was
        silent at the begin, by the rule of the begin check.
        """
        apart_mm = np.hypot(*(evidence.measured_mm - evidence.reported_mm).T)
        near = apart_mm < np.where(self._unchecked, allowed_mm, evidence.astray_mm)
        rows = np.flatnonzero(self.held_against & self._asked & self.heard & evidence.seen & near)
        self.held_against[rows], self._unchecked[rows] = False, False
        return [int(row) for row in rows]

    def judged(self, evidence: Evidence) -> list[FibreStatus | None]:
        """Fault of each of the N positioners, as `judge`; one that repeatedly does not start is dead."""
        faults = judge(evidence)
        for i, outcome in enumerate(evidence.outcomes):
            self._not_started[i] = self._not_started[i] + 1 if outcome is Outcome.NOT_STARTED else 0
            if self._not_started[i] >= NOT_STARTED_MOST:
                faults[i] = FibreStatus.DEAD
            if outcome in (Outcome.TIMED_OUT, Outcome.DISCONNECTED) and not self.heard[i]:
                self.held_against[i] = True
        return faults
