"""Stick-slip piezo motors (PFS): motor maps, and the laws that bring cobras to their targets."""

from fiberloom.drive.piezo.iterations import MotorSteps, SpeedScalingLaw
from fiberloom.drive.piezo.learning import LearningLaw, LearningSettings
from fiberloom.drive.piezo.maps import FORWARD, REVERSE, MotorMaps, direction_of, pulse_factor
from fiberloom.drive.piezo.module_file import read_module_maps
from fiberloom.drive.piezo.summary_file import read_summary_maps, write_summary_maps

__all__ = [
    "FORWARD",
    "REVERSE",
    "LearningLaw",
    "LearningSettings",
    "MotorMaps",
    "MotorSteps",
    "SpeedScalingLaw",
    "direction_of",
    "pulse_factor",
    "read_module_maps",
    "read_summary_maps",
    "write_summary_maps",
]
