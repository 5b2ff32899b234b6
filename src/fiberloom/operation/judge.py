"""What can be said of a positioner after a move, and how it is told apart.

The measurement decides, not the positioner's own claim: firmware that failed to start a trajectory is
known to report arrival (docs/operation.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.bus.outcome import Outcome
from fiberloom.health.status import FibreStatus
from fiberloom.typing import Flags, Floats

ASTRAY_MM = 0.5
"""A blind move misses by tens of micrometres; half a millimetre is no error of calibration."""

STILL = 0.05
"""Less than this share of the way asked for is standing still."""


@dataclass(frozen=True)
class Evidence:
    """All that is known of the positioners after a move; positions of metrology fibres in mm."""

    outcomes: list[Outcome]
    seen: Flags
    measured_mm: Floats
    before_mm: Floats
    reported_mm: Floats
    goal_mm: Floats


def judge(evidence: Evidence) -> list[FibreStatus | None]:
    """Fault of each positioner, None for the healthy ones (also those that were interrupted)."""
    apart = np.hypot(*(evidence.measured_mm - evidence.reported_mm).T)
    asked = np.hypot(*(evidence.goal_mm - evidence.before_mm).T)
    moved = np.hypot(*(evidence.measured_mm - evidence.before_mm).T)
    still = moved < STILL * asked
    return [
        _judge_one(outcome, bool(evidence.seen[i]), bool(apart[i] > ASTRAY_MM), bool(still[i]))
        for i, outcome in enumerate(evidence.outcomes)
    ]


def _judge_one(outcome: Outcome, seen: bool, apart: bool, still: bool) -> FibreStatus | None:
    if outcome in (Outcome.REFUSED, Outcome.TIMED_OUT, Outcome.DISCONNECTED):
        return FibreStatus.DEAD
    if not seen:
        return FibreStatus.DARK
    if apart:
        return FibreStatus.LYING if still else FibreStatus.ASTRAY
    if outcome is Outcome.COLLIDED and still:
        return FibreStatus.DEAD  # the motor is blocked where it stands
    return None
