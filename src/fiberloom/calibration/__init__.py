"""What is measured on a bench and used on every move: transmission maps."""

from fiberloom.calibration.adaptive import AdaptiveCalibration, AdaptiveSettings, AdaptiveState, Update
from fiberloom.calibration.cache import cache_path
from fiberloom.calibration.evaluate import CalibrationReport, evaluate
from fiberloom.calibration.sweep import (
    Calibration,
    SweepData,
    SweepSettings,
    calibrate_transmission,
    measure_sweeps,
)
from fiberloom.calibration.transmission import (
    NEGATIVE,
    POSITIVE,
    Provenance,
    TransmissionMaps,
    identity,
    load,
)

__all__ = [
    "NEGATIVE",
    "POSITIVE",
    "AdaptiveCalibration",
    "AdaptiveSettings",
    "AdaptiveState",
    "Calibration",
    "CalibrationReport",
    "Provenance",
    "SweepData",
    "SweepSettings",
    "TransmissionMaps",
    "Update",
    "cache_path",
    "calibrate_transmission",
    "evaluate",
    "identity",
    "load",
    "measure_sweeps",
]
