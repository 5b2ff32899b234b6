"""Assignment: which positioner takes which target, and where the others wait."""

from .assign import Assignment, assign
from .relax import assign_relaxed

__all__ = ["Assignment", "assign", "assign_relaxed"]
