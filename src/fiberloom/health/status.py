"""What can be said of a positioner after one move."""

from __future__ import annotations

from enum import StrEnum


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
