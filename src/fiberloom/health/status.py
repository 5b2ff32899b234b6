"""What can be said of a positioner after one move."""

from __future__ import annotations

from enum import IntFlag, StrEnum


class FibreStatus(StrEnum):
    """State of one positioner after one move."""

    ON_TARGET = "on_target"  # within the requirement, as measured
    OFF_TARGET = "off_target"  # moved as told, but not within the requirement
    BLOCKED = "blocked"  # healthy, but a faulty neighbour is in its way
    PARKED = "parked"  # has no target
    DARK = "dark"  # its fibre is not seen: it never moves on the spot of another
    LYING = "lying"  # reports to be where the camera sees it is not, and has not moved
    ASTRAY = "astray"  # reports to be where the camera sees it is not, and has moved
    UNSURE = "unsure"  # where it is was not certain at the begin: it does not move
    DISCONNECTED = "disconnected"  # its link is down: judged when that is back
    DEAD = "dead"  # did not move, or did not answer
    OFFLINE = "offline"  # switched off before the observation


FAULTS = frozenset(
    {
        *(FibreStatus.DARK, FibreStatus.LYING, FibreStatus.ASTRAY, FibreStatus.UNSURE),
        *(FibreStatus.DISCONNECTED, FibreStatus.DEAD),
    }
)


class FibreFlag(IntFlag):
    """Bits of the column `flags` of fibres.ecsv: everything that is known against a fibre after a move."""

    NO_TARGET = 1 << 0
    NOT_SEEN = 1 << 1
    AMBIGUOUS = 1 << 2
    OFF_TARGET = 1 << 3
    BLOCKED = 1 << 4
    LYING = 1 << 5
    ASTRAY = 1 << 6
    UNSURE = 1 << 7
    DISCONNECTED = 1 << 8
    DEAD = 1 << 9
    OFFLINE = 1 << 10
    INTERRUPTED = 1 << 11
    COMPARISON = 1 << 12


class Grade(StrEnum):
    """How near a fibre came to its target, by the best error that is known."""

    GOOD = "good"  # within the requirement
    POOR = "poor"  # within POOR_REQUIREMENTS of it
    BAD = "bad"  # farther out
    UNKNOWN = "unknown"  # has a target, and its distance is not known
    NONE = ""  # has no target


POOR_REQUIREMENTS = 6.0
"""[A] Poor up to 30 um at a requirement of 5 um, where DESI begins to call a fibre poor."""


def grade(error_um: float, requirement_um: float, has_target: bool) -> Grade:
    """Grade of one fibre; `error_um` is NaN where it is not known."""
    if not has_target:
        return Grade.NONE
    if not error_um >= 0.0:
        return Grade.UNKNOWN
    if error_um <= requirement_um:
        return Grade.GOOD
    return Grade.POOR if error_um <= POOR_REQUIREMENTS * requirement_um else Grade.BAD
