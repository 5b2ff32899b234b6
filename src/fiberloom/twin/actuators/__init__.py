"""Motors of other kinds than the BLDC with hall sensors: what they make of what a controller commands."""

from fiberloom.twin.actuators.piezo import PiezoErrors, PiezoMotors, drawn_maps

__all__ = ["PiezoErrors", "PiezoMotors", "drawn_maps"]
