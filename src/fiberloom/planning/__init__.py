"""Collision-free motion of all positioners from where they are to where they must be.

`plan` and `plan_corrections` make a `Plan`; `verify` proves it safe, by other code. See
docs/planning.md.
"""

from .configuration import read_configuration, write_configuration
from .fields import random_configuration, random_pair
from .planner import PlanSettings, plan, plan_corrections
from .trajectories import Plan, Robot, read_plans
from .verification import Verification, Violation, verify

__all__ = [
    "Plan",
    "PlanSettings",
    "Robot",
    "Verification",
    "Violation",
    "plan",
    "plan_corrections",
    "random_configuration",
    "random_pair",
    "read_configuration",
    "read_plans",
    "verify",
    "write_configuration",
]
