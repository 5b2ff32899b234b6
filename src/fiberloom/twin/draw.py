"""Draws units: every positioner its own motor, gear, sensors and firmware parameters.

Sizes are TUNED, not measured, where the paper prints no number: the gear so that at SDSS-V arms
(7.4 and 14.3 mm) a linear ratio leaves about 36 um rms and a 200-point map about 10 um rms in the
focal plane (Kronig 2020, Fig. 19 and 26), inside SDSS-V's acceptance (non-linearity 0.6 deg,
derivative 0.15) and with the backlash of Fig. 10. docs/twin.md tells which number comes from where.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from fiberloom._core import firmware as _firmware
from fiberloom._core import twin as _core
from fiberloom.calibration.commissioning.backlash import BACKLASH_WAVES, wave_parameters
from fiberloom.calibration.commissioning.gains import control_gains
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.arms import L_ALPHA
from fiberloom.instruments.model import AXES, METROLOGY
from fiberloom.timing import part
from fiberloom.twin.errors.sizes import NO_ERRORS, TwinErrors
from fiberloom.twin.errors.switches import GearSpectrum
from fiberloom.twin.gears import (
    BACKLASH_HIGHEST_DEG,
    BACKLASH_LOWEST_DEG,
    Rng,
    draw_gear,
    held,
    other_gears,
    told_of,
)
from fiberloom.twin.motors.sets import MOTOR_SETS, PAPER, with_motor
from fiberloom.twin.units import (
    FIRMWARE_DTYPE,
    GEAR_DTYPE,
    ORDERS,
    PLANT_DTYPE,
    Units,
    defaults,
)
from fiberloom.typing import Floats, Records
from fiberloom.units import GEAR, MM_PER_UM, RAD_PER_DEG

BETA_SHARE = 0.1
"""Torques and inertia of the beta axis over alpha's: the ratio of the stiffnesses is 25/337, of the
motors' diameters 6/12 mm (assumed; the paper prints alpha's only)."""
SCALED = [
    "inertia_motor",
    "inertia_gear",
    "coulomb_motor",
    "coulomb_gear",
    "viscous_motor",
    "viscous_gear",
    "cogging_2",
    "cogging_4",
    "spring_rate",
]
SEAT_RMS_RAD = (16.3e-6, 5.5e-6)
"""Non-repeatability at standstill. TUNED to Kronig 2020, Fig. 17: 160 nm at 7.6 mm and 130 nm at
15 mm with a camera of 101 nm; hall noise and control alone leave a few nm."""
STIFFNESS_NM_PER_RAD = (0.337 / RAD_PER_DEG, 0.025 / RAD_PER_DEG)  # Kronig 2020, Fig. 13

RELATIVE_SD: dict[str, float] = {
    # unit to unit, assumed: tolerances usual for small motors and gears
    "inertia_motor": 0.02,
    "coulomb_motor": 0.10,
    "coulomb_gear": 0.08,
    "viscous_motor": 0.10,
    "viscous_gear": 0.10,
    "flux_linkage": 0.02,
    "coil_resistance": 0.02,
    "supply": 0.005,
    "cogging_2": 0.15,
    "cogging_4": 0.25,
    "spring_rate": 0.05,
    "spring_free": 0.01,
    "stiffness": 0.05,
    "seat_rms": 0.15,
    "hall_amplitude_a": 0.03,
    "hall_amplitude_b": 0.03,
}
ABSOLUTE_SD: dict[str, float] = {"hall_offset_a": 25.0, "hall_offset_b": 25.0, "hall_phase": 0.02}
PHASES = ("cogging_2_phase", "cogging_4_phase")

IDENTIFICATION_SD: dict[str, float] = {
    # relative error of what the firmware knows: a few percent, as friction and inertia repeat
    "torque_per_volt": 0.01,
    "inertia": 0.02,
    "drag": 0.02,
    "coulomb": 0.03,
    "spring_torque": 0.03,
    "spring_rate": 0.03,
    "cogging_torque": 0.05,
    "hall_amplitude_a": 0.002,
    "hall_amplitude_b": 0.002,
}
IDENTIFICATION_ABSOLUTE_SD: dict[str, float] = {
    "cogging_phase": 0.05,
    "hall_offset_a": 1.5,
    "hall_offset_b": 1.5,
    "hall_phase": 0.001,
}
ARM_SD = np.array([1e-3, 1e-3, 1e-3, 5e-5, 5e-5])
"""True arms against the layout: about 1 um in centre and length, 50 urad in the angles' zeros."""

BACKLASH_SD_DEG = 1.0
"""Motor degrees by which the firmware knows the mean and each wave of the backlash wrong, assumed: 0.67 um of
camera noise at 22 mm of lever are 1.8 a point, and a map has 200."""

Knowledge = Literal["identified", "nominal", "true"]
"""What the firmware was told of its unit: with the errors of an identification, nothing but what is common
to all units (as from the factory), or the truth."""


@part("drawing of units")
def draw_units(
    plane: FocalPlane,
    seed: int,
    firmware: Knowledge = "identified",
    errors: TwinErrors = NO_ERRORS,
    gears: GearSpectrum | None = None,
) -> Units:
    """True units for every positioner of the `plane`, by the `seed`.

    A unit depends on the `seed` and its number alone, so a part of a plane has the same units. The
    instrument's `[twin.alpha]` and `[twin.beta]` tables choose a `motor` (`fiberloom.twin.motors.sets`) and
    override nominal plant parameters by name.
    `firmware`: what it was told; `errors`: of arms and fibres against the layout, without them only `ARM_SD`;
    `gears`: the spectrum of their deviations (`fiberloom.twin.gears`), by default that of `errors`; another
    one leaves the rest as it is.
    """
    n = len(plane)
    units = Units(
        plant=np.zeros((n, 2), PLANT_DTYPE),
        gear=np.zeros((n, 2), GEAR_DTYPE),
        firmware=np.zeros((n, 2), FIRMWARE_DTYPE),
        arms=plane.arms.copy(),
        seed=seed,
        number=plane.positioner_id.astype(np.int64),
    )
    # as numbers of Python: fields of a record one by one take five times as long
    nominal = [_by_name(_nominal(plane, axis)) for axis in (0, 1)]
    told = [_by_name(_told(plane, axis)) for axis in (0, 1)]
    for row, number in enumerate(plane.positioner_id):
        rng = np.random.default_rng([seed, int(number)])
        units.arms[row] += ARM_SD * rng.standard_normal(5)
        for axis in (0, 1):
            plant = _scatter(nominal[axis], rng)
            units.plant[row, axis] = tuple(plant.values())
            units.gear[row, axis] = draw_gear(axis, rng)
            # drawn whatever is asked for: the units are the same
            known = _identified(plant, told[axis], rng)
            if firmware == "true":
                known = _perfect(plant, told[axis])
            units.firmware[row, axis] = tuple(known.values())
    if (spectrum := gears or errors.gears) != "stages":
        units.gear[:] = other_gears(units.number, seed, spectrum)
    if firmware == "nominal":
        units.firmware[:] = nominal_firmware(plane)
    else:
        _tell_backlash(units, exactly=firmware == "true")
    return errors.temperature.applied(_misbuilt(plane, units, errors), plane)


def _tell_backlash(units: Units, exactly: bool) -> None:
    """The mean and the waves of the backlash, as maps tell them: wrong by BACKLASH_SD_DEG, or exactly.

    By generators of its own: what else is drawn stays as it was.
    """
    rows = np.searchsorted(ORDERS, list(BACKLASH_WAVES.values()))
    mean_deg = units.gear["backlash_mean_rad"] / RAD_PER_DEG
    waves_deg = units.gear["backlash_rad"][:, :, rows] / RAD_PER_DEG
    if not exactly:
        wrong_deg = BACKLASH_SD_DEG * np.array(
            [[_normals(units.seed, number, axis, len(rows)) for axis in (0, 1)] for number in units.number]
        )
        mean_deg, waves_deg = mean_deg + wrong_deg[:, :, 0, 0], waves_deg + wrong_deg[:, :, 1:]
    _tell(units.firmware, wave_parameters(mean_deg, waves_deg))


def _normals(seed: int, number: int, axis: int, waves: int) -> Floats:
    """(waves + 1, 2) for an axis of a unit."""
    return np.random.default_rng([seed, int(number), axis, 0xB]).normal(size=(waves + 1, 2))


def _misbuilt(plane: FocalPlane, units: Units, errors: TwinErrors) -> Units:
    """The same units with arms and fibres off their tables, and what pulls at them."""
    fibres = [name for name in plane.points if name != METROLOGY]
    each = [errors.drawn_of(int(number), units.seed, fibres) for number in plane.positioner_id]
    units.arms[:, L_ALPHA] += [one.l_alpha_mm for one in each]
    return replace(
        units,
        beta_longer_mm=np.array([one.beta_longer_mm for one in each]),
        fibre_offset_mm={name: np.array([one.fibre_mm[name] for one in each]) for name in fibres},
        load=np.array([errors.loads.drawn_of(int(number), units.seed) for number in plane.positioner_id]),
    )


def _nominal(plane: FocalPlane, axis: int) -> Records:
    record = defaults(_core.PLANT_PARAMS, PLANT_DTYPE)
    if axis == 1:
        for name in SCALED:
            record[name] *= BETA_SHARE
        # a coil of ten times the resistance: torque per volt and back-EMF drag a tenth
        record["coil_resistance"] /= BETA_SHARE
    record["stiffness"] = STIFFNESS_NM_PER_RAD[axis]
    record["seat_rms"] = SEAT_RMS_RAD[axis]
    record["stop_min"], record["stop_max"] = plane.hard_stops_deg[axis] * RAD_PER_DEG
    overrides = dict(plane.instrument.twin.get(AXES[axis], {}))
    where = f"{plane.instrument.name}: twin.{AXES[axis]}"
    record = with_motor(record, axis, overrides.pop("motor", PAPER), where)
    return _override(record, overrides, where)


def _override(record: Records, overrides: Mapping[str, Any], where: str) -> Records:
    for name, value in overrides.items():
        if name not in (PLANT_DTYPE.names or ()):
            raise InputError(f"{where}.{name}: no such plant parameter; see docs/twin.md for the list")
        record[name] = value
    return record


def _by_name(record: Records) -> dict[str, float]:
    """Fields of a record, in their order."""
    return dict(zip(record.dtype.names or (), record.item(), strict=True))


def _scatter(nominal: Mapping[str, float], rng: Rng) -> dict[str, float]:
    plant = dict(nominal)
    for (name, sd), off in zip(RELATIVE_SD.items(), held(rng, len(RELATIVE_SD)), strict=True):
        plant[name] *= 1.0 + sd * off
    for (name, sd), off in zip(ABSOLUTE_SD.items(), held(rng, len(ABSOLUTE_SD)), strict=True):
        plant[name] += sd * off
    for name in PHASES:
        plant[name] = rng.uniform(-np.pi, np.pi)
    return plant


def firmware_truth(plant: Mapping[str, Any]) -> dict[str, float]:
    """Parameters of the firmware after a perfect identification of an axis: SI, hall channels in
    counts.
    """
    torque_constant = float(plant["flux_linkage"] / plant["coil_resistance"])  # Nm per volt and coil
    spring_Nm = float(plant["spring_rate"] / GEAR)
    return {
        "hall_offset_a": plant["hall_offset_a"],
        "hall_offset_b": plant["hall_offset_b"],
        "hall_amplitude_a": plant["hall_amplitude_a"],
        "hall_amplitude_b": plant["hall_amplitude_b"],
        "hall_phase": plant["hall_phase"],
        "u_dc": plant["supply"],
        "torque_per_volt": 1.5 * np.sqrt(0.75) * torque_constant,  # Eq. 19
        "inertia": plant["inertia_motor"] + plant["inertia_gear"],
        "drag": plant["viscous_motor"]
        + plant["viscous_gear"]
        + 1.5 * torque_constant * plant["flux_linkage"],
        "coulomb": plant["coulomb_motor"] + plant["coulomb_gear"],
        "spring_torque": spring_Nm * plant["spring_free"],
        "spring_rate": -spring_Nm / GEAR,
        "cogging_torque": plant["cogging_2"],
        "cogging_phase": plant["cogging_2_phase"],
    }


def _tell(record: Records, known: Mapping[str, ArrayLike]) -> None:
    for name, value in known.items():
        record[name] = value


def nominal_firmware(plane: FocalPlane) -> Records:
    """(2,) what a maker flashes into every unit: the nominal unit's parameters, and no unit's own."""
    both = [_perfect(_by_name(_nominal(plane, axis)), _by_name(_told(plane, axis))) for axis in (0, 1)]
    return np.array([tuple(known.values()) for known in both], FIRMWARE_DTYPE)


def _told(plane: FocalPlane, axis: int) -> Records:
    """Defaults, and what the layout tells every firmware."""
    record = defaults(_firmware.AXIS_PARAMS, FIRMWARE_DTYPE)
    record["position_min"], record["position_max"] = plane.hard_stops_deg[axis]
    record["datum_position"] = plane.hard_stops_deg[axis][0]
    record["host_timeout_ms"] = 1e3 * plane.instrument.care.host_timeout_s
    _tell(record, _rotor_shares(_nominal(plane, axis)))
    return record


def _rotor_shares(nominal: Records) -> dict[str, float]:
    """The rotor's own part of friction and drag: the nominal unit's; no bench tells it from the gear's."""
    truth = firmware_truth(_by_name(nominal))
    return {
        "gap_coulomb_share": float(nominal["coulomb_motor"] / truth["coulomb"]),
        "gap_drag_share": float(1.0 - nominal["viscous_gear"] / truth["drag"]),
    }


def _perfect(plant: Mapping[str, float], told: Mapping[str, float]) -> dict[str, float]:
    return _with_gains({**told, **firmware_truth(plant)})


def _identified(plant: Mapping[str, float], told: Mapping[str, float], rng: Rng) -> dict[str, float]:
    known, truth = dict(told), firmware_truth(plant)
    off = iter(held(rng, 2 * len(truth)))
    for name, value in truth.items():
        error = 1.0 + IDENTIFICATION_SD.get(name, 0.0) * next(off)
        known[name] = value * error + IDENTIFICATION_ABSOLUTE_SD.get(name, 0.0) * next(off)
    return _with_gains(known)


def _with_gains(known: Mapping[str, float]) -> dict[str, float]:
    """By inertia (kg m^2) and drag (Nm s/rad) as the firmware was told them: in single precision."""
    motor = {name: float(np.float32(known[name])) for name in ("inertia", "drag")}
    return {**known, **control_gains(motor)}


def put_in(plane: FocalPlane, camera: str = "noise", errors: TwinErrors = NO_ERRORS) -> dict[str, str]:
    """What was put into the twin, for reports: everything else came out."""
    seen = {
        "noise": f"{plane.instrument.metrology.noise_rms_um:g} um rms, given (Kronig 2020, Fig. 18)",
        "image": "photons, pixels and optics of its images: [camera] and [twin.camera] of the instrument",
    }
    return {
        "camera": seen[camera],
        "gear non-linearity": told_of(errors.gears),
        "backlash": f"{BACKLASH_LOWEST_DEG[0]:g} to {BACKLASH_HIGHEST_DEG[1]:g} motor deg, given (Fig. 10)",
        "non-repeatability of the gear": f"{1e6 * SEAT_RMS_RAD[0]:g} / {1e6 * SEAT_RMS_RAD[1]:g} urad "
        "rms (alpha / beta), tuned to Fig. 17",
        "true arms against the layout": f"{1e3 * ARM_SD[2]:g} um rms in centre and length, given (Fig. 20)",
        **errors.told(plane),
        "firmware parameters": "identified within 1 to 5 % (assumed)",
        "motor, friction, spring, stiffness": "given or derived (Fig. 11 to 14); beta's at "
        f"{BETA_SHARE:g} of alpha's (assumed)",
        **_other_motors(plane),
    }


def _other_motors(plane: FocalPlane) -> dict[str, str]:
    """Where an instrument chose another set than the paper's."""
    chosen = {name: plane.instrument.twin.get(name, {}).get("motor", PAPER) for name in AXES}
    return {
        f"motor of {axis}": f"{name}: {MOTOR_SETS[name].source}"
        for axis, name in chosen.items()
        if name != PAPER
    }


def misplaced(plane: FocalPlane, by_um: float, by_deg: float, seed: int) -> FocalPlane:
    """The layout of a `plane` as it is known before anything was measured.

    Centres and alpha arms are wrong by `by_um`, zeros by `by_deg`, rms, drawn from the `seed`.
    """
    rng = np.random.default_rng([seed, 0x3015])
    sigmas = np.array([*[by_um * MM_PER_UM] * 3, *[by_deg * RAD_PER_DEG] * 2])
    return replace(plane, arms=plane.arms + rng.normal(size=plane.arms.shape) * sigmas)
