"""Collision-free motion of all positioners from where they are to where they must be.

`plan` and `plan_corrections` make a `Plan`; `verify` proves it safe, by other code. `untangle`
finds a way out of a collision. See docs/planning.md.
"""

from typing import TYPE_CHECKING

from fiberloom.lazy import on_use

if TYPE_CHECKING:
    from fiberloom.planning.bound import bound_s
    from fiberloom.planning.configuration import read_configuration, write_configuration
    from fiberloom.planning.fields import random_configuration, random_pair
    from fiberloom.planning.late import LatePair, LateVerification, verify_late
    from fiberloom.planning.planner import PlanSettings, plan, plan_corrections
    from fiberloom.planning.supply.proof import SupplyVerification, verify_supply
    from fiberloom.planning.supply.waves import plan_in_waves
    from fiberloom.planning.trajectories import Approach, Plan, Trajectory, read_plans
    from fiberloom.planning.untangling import Stage, Untangled, UntangleSettings, untangle
    from fiberloom.planning.verification import MotionLimits, Verification, Violation, verify

__all__ = [
    "Approach",
    "LatePair",
    "LateVerification",
    "MotionLimits",
    "Plan",
    "PlanSettings",
    "Stage",
    "SupplyVerification",
    "Trajectory",
    "UntangleSettings",
    "Untangled",
    "Verification",
    "Violation",
    "bound_s",
    "plan",
    "plan_corrections",
    "plan_in_waves",
    "random_configuration",
    "random_pair",
    "read_configuration",
    "read_plans",
    "untangle",
    "verify",
    "verify_late",
    "verify_supply",
    "write_configuration",
]

__getattr__ = on_use(__name__)
