"""Cobras (PFS): geometry, stops and motor maps from places that a camera sees."""

from fiberloom.drive.pfs.calibration.doubtful import (
    arriving,
    doubtful,
    left_out,
    most_scatter,
    standing_deg,
)
from fiberloom.drive.pfs.calibration.maps import MapFit, Moves, fit_maps
from fiberloom.drive.pfs.calibration.measure import (
    CobraCalibration,
    CobraSweep,
    CobraSweepSettings,
    calibrate_cobras,
)
from fiberloom.drive.pfs.calibration.pulses import FAST_STEP_DEG, SLOW_STEP_DEG, maps_at, pulses_for

__all__ = [
    "FAST_STEP_DEG",
    "SLOW_STEP_DEG",
    "CobraCalibration",
    "CobraSweep",
    "CobraSweepSettings",
    "MapFit",
    "Moves",
    "arriving",
    "calibrate_cobras",
    "doubtful",
    "fit_maps",
    "left_out",
    "maps_at",
    "most_scatter",
    "pulses_for",
    "standing_deg",
]
