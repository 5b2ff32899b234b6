"""Steppers without encoders: what MEGARA, MOONS and LAMOST have in common. The frames are theirs."""

from fiberloom.drive.steppers.drive import StepperDrive
from fiberloom.drive.steppers.known import KnownUnits
from fiberloom.drive.steppers.link import Homed, Leg, StepperLink, UnitTold
from fiberloom.drive.steppers.steps import AxisSteps

__all__ = ["AxisSteps", "Homed", "KnownUnits", "Leg", "StepperDrive", "StepperLink", "UnitTold"]
