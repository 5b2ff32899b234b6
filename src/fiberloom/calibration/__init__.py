"""What is measured on a bench, and used on every move: maps, arms, friction, inertia, stiffness."""

from typing import TYPE_CHECKING

from fiberloom.lazy import on_use

if TYPE_CHECKING:
    from fiberloom.calibration.adaptive.calibration import (
        AdaptiveCalibration,
        AdaptiveSettings,
        AdaptiveState,
        Update,
    )
    from fiberloom.calibration.bench.arms import Arms, ArmsData, ArmsSettings, identify_arms, measure_arms
    from fiberloom.calibration.bench.bench import TorqueActuator
    from fiberloom.calibration.bench.coast import (
        Coast,
        CoastData,
        CoastSettings,
        identify_coast,
        measure_coast,
    )
    from fiberloom.calibration.bench.estimate import Estimate
    from fiberloom.calibration.bench.friction import (
        BreakAway,
        Friction,
        FrictionData,
        FrictionSettings,
        break_away,
        identify_friction,
        measure_friction,
    )
    from fiberloom.calibration.bench.inertia import (
        Inertia,
        InertiaData,
        InertiaSettings,
        identify_inertia,
        measure_inertia,
    )
    from fiberloom.calibration.bench.repeatability import (
        Repeatability,
        RepeatabilityData,
        RepeatabilitySettings,
        identify_repeatability,
        measure_repeatability,
    )
    from fiberloom.calibration.bench.stiffness import (
        StiffnessData,
        StiffnessSettings,
        identify_stiffness,
        measure_stiffness,
    )
    from fiberloom.calibration.bench.torque import TorqueScale, data_sheet_scale
    from fiberloom.calibration.bench.torque_scale import (
        TorqueScaleData,
        TorqueScaleSettings,
        identify_torque_scale,
        measure_torque_scale,
        measured_scale,
    )
    from fiberloom.calibration.transmission.cache import cache_path
    from fiberloom.calibration.transmission.evaluate import CalibrationReport, evaluate
    from fiberloom.calibration.transmission.maps import (
        NEGATIVE,
        POSITIVE,
        Provenance,
        TransmissionMaps,
        identity,
        load,
    )
    from fiberloom.calibration.transmission.sweep import (
        Calibration,
        SweepSettings,
        calibrate_transmission,
        measure_sweeps,
        wire_grid,
    )
    from fiberloom.calibration.transmission.sweep_data import SweepData

__all__ = [
    "NEGATIVE",
    "POSITIVE",
    "AdaptiveCalibration",
    "AdaptiveSettings",
    "AdaptiveState",
    "Arms",
    "ArmsData",
    "ArmsSettings",
    "BreakAway",
    "Calibration",
    "CalibrationReport",
    "Coast",
    "CoastData",
    "CoastSettings",
    "Estimate",
    "Friction",
    "FrictionData",
    "FrictionSettings",
    "Inertia",
    "InertiaData",
    "InertiaSettings",
    "Provenance",
    "Repeatability",
    "RepeatabilityData",
    "RepeatabilitySettings",
    "StiffnessData",
    "StiffnessSettings",
    "SweepData",
    "SweepSettings",
    "TorqueActuator",
    "TorqueScale",
    "TorqueScaleData",
    "TorqueScaleSettings",
    "TransmissionMaps",
    "Update",
    "break_away",
    "cache_path",
    "calibrate_transmission",
    "data_sheet_scale",
    "evaluate",
    "identify_arms",
    "identify_coast",
    "identify_friction",
    "identify_inertia",
    "identify_repeatability",
    "identify_stiffness",
    "identify_torque_scale",
    "identity",
    "load",
    "measure_arms",
    "measure_coast",
    "measure_friction",
    "measure_inertia",
    "measure_repeatability",
    "measure_stiffness",
    "measure_sweeps",
    "measure_torque_scale",
    "measured_scale",
    "wire_grid",
]

__getattr__ = on_use(__name__)
