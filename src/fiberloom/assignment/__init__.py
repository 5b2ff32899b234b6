"""Assignment: which positioner takes which target, and where the others wait."""

from fiberloom.assignment.assign import Assignment, AssignSettings, assign
from fiberloom.assignment.relax import assign_relaxed
from fiberloom.assignment.swapping import Swapped, SwapSettings, swap_targets

__all__ = [
    "AssignSettings",
    "Assignment",
    "SwapSettings",
    "Swapped",
    "assign",
    "assign_relaxed",
    "swap_targets",
]
