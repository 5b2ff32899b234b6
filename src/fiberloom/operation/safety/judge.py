"""The fault of a positioner after a move, from the image and its reply.

The image decides, not the reply: firmware that failed to start a trajectory is known to report arrival
(docs/operation.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.bus.outcome import Outcome
from fiberloom.health.status import FibreStatus
from fiberloom.instruments.axis import DriveTable
from fiberloom.typing import Flags, Floats

_SAID = DriveTable()


@dataclass(frozen=True)
class Evidence:
    """What is known of N positioners after a move; positions are those of metrology fibres."""

    outcomes: list[Outcome]
    """How the move of each one ended on the bus."""
    seen: Flags
    """(N,) fibres in the image."""
    measured_mm: Floats
    """(N, 2) in the image; NaN where not seen."""
    before_mm: Floats
    """(N, 2) before the move: in the image before it, by the reported angles where it shows nothing."""
    reported_mm: Floats
    """(N, 2) by the reported angles after it."""
    goal_mm: Floats
    """(N, 2) by the commanded angles."""
    heard: Flags | None = None
    """(N,) told their position after it; None: all did."""
    astray_mm: Floats | float = _SAID.astray_mm
    """Beyond this from where it reports, a positioner that has moved is not there; of all, or (N,)."""
    still_mm: float = _SAID.astray_mm
    """The same, of one that has not moved."""
    still_share: float = _SAID.still_share
    """One that moved less than this share of its way did not move."""


def judge(evidence: Evidence) -> list[FibreStatus | None]:
    """Fault of each of the N positioners; None where it is healthy, also where it was interrupted."""
    apart = np.hypot(*(evidence.measured_mm - evidence.reported_mm).T)
    asked = np.hypot(*(evidence.goal_mm - evidence.before_mm).T)
    moved = np.hypot(*(evidence.measured_mm - evidence.before_mm).T)
    still = moved < evidence.still_share * asked
    astray = apart > np.where(still, evidence.still_mm, evidence.astray_mm)
    heard = np.ones(len(still), dtype=bool) if evidence.heard is None else evidence.heard
    outcomes = [_told(outcome, bool(heard[i])) for i, outcome in enumerate(evidence.outcomes)]
    return [
        _judge_one(outcome, bool(evidence.seen[i]), bool(astray[i]), bool(still[i]))
        for i, outcome in enumerate(outcomes)
    ]


def _told(outcome: Outcome, heard: bool) -> Outcome:
    """Missing answers are no evidence against one that answers now: its report and the image are."""
    missing = outcome in (Outcome.TIMED_OUT, Outcome.DISCONNECTED)
    return Outcome.MISPLACED if missing and heard else outcome


def _judge_one(outcome: Outcome, seen: bool, apart: bool, still: bool) -> FibreStatus | None:
    if outcome is Outcome.DISCONNECTED:
        return FibreStatus.DISCONNECTED
    if outcome in (Outcome.REFUSED, Outcome.TIMED_OUT):
        return FibreStatus.DEAD
    if not seen:
        return FibreStatus.DARK
    if apart:
        return FibreStatus.LYING if still else FibreStatus.ASTRAY
    if outcome is Outcome.COLLIDED and still:
        return FibreStatus.DEAD  # the motor is blocked where it is
    return None
