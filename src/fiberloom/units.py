"""Units: the one place where degrees, millimetres and the counts of the wire meet SI."""

from math import pi

DEG = pi / 180.0
"""One degree in rad."""

UM_PER_MM = 1000.0

COUNTS_PER_TURN = 2**30
"""Positions on the wire and in the firmware, per turn of the output."""

COUNTS_PER_DEG = COUNTS_PER_TURN / 360.0

TICK_S = 0.5e-3
"""The firmware's control period and the time unit of trajectories."""

GEAR = 1024
"""Motor turns per output turn, nominal."""

MOTOR_DEG_PER_OUTPUT_DEG = GEAR
