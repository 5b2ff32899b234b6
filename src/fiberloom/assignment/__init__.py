"""Assignment: which positioner takes which target, and where the others wait."""

from .assign import Assignment, assign

__all__ = ["Assignment", "assign"]
