"""Assignment: which positioner takes which target, and where the others wait."""

from fiberloom.assignment.assign import Assignment, AssignSettings, assign
from fiberloom.assignment.relax import assign_relaxed

__all__ = ["AssignSettings", "Assignment", "assign", "assign_relaxed"]
