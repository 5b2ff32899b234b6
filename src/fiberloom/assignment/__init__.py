"""Assignment: which positioner takes which target, and where the others wait."""

from fiberloom.assignment.assign import Assignment, assign
from fiberloom.assignment.relax import assign_relaxed

__all__ = ["Assignment", "assign", "assign_relaxed"]
