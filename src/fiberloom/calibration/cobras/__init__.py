"""Cobras (PFS): geometry, stops and motor maps from places that a camera sees."""

from fiberloom.calibration.cobras.maps import MapFit, Moves, fit_maps
from fiberloom.calibration.cobras.measure import CobraCalibration, CobraSweep, SweepSettings, calibrate_cobras
from fiberloom.calibration.cobras.pulses import FAST_STEP_DEG, SLOW_STEP_DEG, maps_at, pulses_for

__all__ = [
    "FAST_STEP_DEG",
    "SLOW_STEP_DEG",
    "CobraCalibration",
    "CobraSweep",
    "MapFit",
    "Moves",
    "SweepSettings",
    "calibrate_cobras",
    "fit_maps",
    "maps_at",
    "pulses_for",
]
