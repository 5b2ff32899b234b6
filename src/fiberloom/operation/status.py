"""What can be said of a positioner after a move, and how it is told apart.

The measurement decides, not the positioner's own claim: firmware that failed to start a trajectory is
known to report arrival (see docs/operation.md).
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from fiberloom.bus.client import Outcome

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Status(StrEnum):
    """State of one positioner after one move."""

    ON_TARGET = "on_target"  # within the requirement, as measured
    OFF_TARGET = "off_target"  # moved as told, but not within the requirement
    PARKED = "parked"  # has no target
    DARK = "dark"  # its fibre was not seen: never moved on somebody else's spot
    LYING = "lying"  # reports arrival, but the camera sees that it did not move
    DEAD = "dead"  # did not move, or did not answer
    COLLIDED = "collided"  # stopped on a collision
    ASTRAY = "astray"  # moved, but is nowhere near where it was told to go
    OFFLINE = "offline"  # switched off before the observation


FAULTS = frozenset({Status.DARK, Status.LYING, Status.DEAD, Status.COLLIDED, Status.ASTRAY})

# A healthy blind move misses by tens of micrometres; half a millimetre is not an error of calibration.
ASTRAY_MM = 0.5


def judge(
    outcomes: list[Outcome],
    seen: Flags,
    measured_mm: Floats,
    before_mm: Floats,
    expected_mm: Floats,
) -> list[Status | None]:
    """Fault of each positioner after a move, None for the healthy ones. Positions (N, 2) in mm."""
    miss = np.hypot(*(measured_mm - expected_mm).T)
    asked = np.hypot(*(expected_mm - before_mm).T)
    moved = np.hypot(*(measured_mm - before_mm).T)
    return [
        _judge_one(outcomes[i], bool(seen[i]), miss[i], asked[i], moved[i])
        for i in range(len(outcomes))
    ]


def _judge_one(
    outcome: Outcome, seen: bool, miss_mm: float, asked_mm: float, moved_mm: float
) -> Status | None:
    if outcome is Outcome.COLLIDED:
        return Status.COLLIDED
    if outcome is not Outcome.DONE:
        return Status.DEAD
    if not seen:
        return Status.DARK
    if miss_mm <= ASTRAY_MM:
        return None
    stood_still = moved_mm < 0.05 * asked_mm
    return Status.LYING if stood_still else Status.ASTRAY
