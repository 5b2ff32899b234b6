"""The same budget on the twin: maps are swept, moves made, images taken, corrections computed.

Standstill positions of the statistical twin (`fiberloom.twin.statistical`), the project's own evaluation of
sweeps and its own corrections. One term at a time: all others are switched off in the units.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fiberloom.calibration import SweepSettings
from fiberloom.calibration.transmission.evaluate import evaluate
from fiberloom.calibration.transmission.maps import Provenance, TransmissionMaps
from fiberloom.design.budget.attitude import PointedTwin, frame_alone_um, sagged
from fiberloom.design.budget.places import random_goals_deg
from fiberloom.design.budget.terms import BudgetSettings, require_maps
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.arms import ALPHA_OFF, BETA_OFF
from fiberloom.instruments.pointing import ExposurePointing, Pointing
from fiberloom.metrology.noise import CorrectionNoise
from fiberloom.operation.correction import CorrectionLoop
from fiberloom.twin import NoiseCamera, StatisticalTwin, Units, draw_units
from fiberloom.twin.errors.sizes import NO_ERRORS
from fiberloom.twin.statistical import sweeps
from fiberloom.typing import Floats
from fiberloom.units import MM_PER_UM, UM_PER_MM


@dataclass(frozen=True)
class Noises:
    """What a run of the twin has, um rms in two dimensions."""

    sweep_um: float
    """Of the camera while maps are measured."""
    image_um: float
    """Of the camera while fibres are corrected."""


@dataclass(frozen=True)
class Simulated:
    """Errors of the science fibre on the twin."""

    rms_um: Floats
    """(k + 1,) of the blind move and after each correction."""
    rms_error_um: Floats
    """(k + 1,) standard error of that, over the units: fields of the same units are not independent."""
    p95_um: Floats
    """(k + 1,) 95 % of them are within."""


def simulate(
    plane: FocalPlane,
    units: Units,
    settings: BudgetSettings,
    fields: int = 10,
    noises: Noises | None = None,
    on_bench: Units | None = None,
) -> Simulated:
    """`fields` random configurations of all `units` of a `plane`, each with its own targets.

    `settings`: corrections, knots, errors of tables and air; `noises`: of the camera, default the
    instrument's; `on_bench`: the units as they were when their maps were measured, default the same.

    Raises
    ------
    InputError
        An instrument whose motors have no transmission map.
    """
    require_maps(plane.instrument)
    own_um = plane.instrument.metrology.noise_rms_um
    noises = noises or Noises(own_um, own_um)
    rng = np.random.default_rng([units.seed, 0xB0D6])
    twin = PointedTwin(StatisticalTwin(plane, units, seed=units.seed))
    maps = swept(plane, units if on_bench is None else on_bench, settings.knots, noises.sweep_um, rng)
    camera = NoiseCamera(twin, noises.image_um, units.seed, settings.errors)
    square = np.empty((fields, settings.corrections + 1, plane.n))
    for field in range(fields):
        square[field] = _field(twin, maps, camera, noises, settings, rng)
    rms_um = np.sqrt(square.mean(axis=(0, 2)))
    of_unit = square.mean(axis=0)
    return Simulated(
        rms_um=rms_um,
        rms_error_um=of_unit.std(axis=1, ddof=1) / np.sqrt(plane.n) / (2.0 * rms_um),
        p95_um=np.sqrt(np.quantile(square, 0.95, axis=(0, 2))),
    )


def swept(
    plane: FocalPlane, units: Units, knots: int, camera_um: float, rng: np.random.Generator
) -> TransmissionMaps:
    """Maps as a bench finds them, of the `units` of a `plane`; `knots` of each axis and direction, images
    with `camera_um` of noise from `rng`."""
    bench = StatisticalTwin(plane, units, seed=units.seed + 1)
    sigma_mm = MM_PER_UM * camera_um / np.sqrt(2.0)
    sweep = SweepSettings(knots)
    data = sweeps(bench, sweep, lambda true: true + rng.normal(0.0, sigma_mm, true.shape))
    maps, _ = evaluate(plane, data, sweep.seen_at_least, Provenance())
    return maps


def _field(
    twin: PointedTwin,
    maps: TransmissionMaps,
    camera: NoiseCamera,
    noises: Noises,
    settings: BudgetSettings,
    rng: np.random.Generator,
) -> Floats:
    """(corrections + 1, N) um^2 of the science fibres from their targets, in the middle of an exposure."""
    plane = twin.plane
    fibre = plane.instrument.science_fibres[0]
    goal_deg = random_goals_deg(plane, rng)
    target_mm = plane.forward(goal_deg[:, 0], goal_deg[:, 1], fibre)
    noise = replace(CorrectionNoise.of(plane), camera_um=noises.image_um)
    filtered = plane.instrument.operation.correction == "filtered"
    loop = CorrectionLoop(plane, goal_deg, fibre=np.full(plane.n, fibre), noise=noise, filtered=filtered)
    pointing = _pointing(settings, rng)
    wanted_deg, found = goal_deg, []
    for move in range(settings.corrections + 1):
        twin.move(maps.to_wire(wanted_deg))
        twin.pointing = pointing.middle
        found.append(((UM_PER_MM * (twin.fibre_xy(fibre) - target_mm)) ** 2).sum(axis=1))
        if move < settings.corrections:
            twin.pointing = pointing.image
            image = camera.measure()
            seen_mm = np.column_stack([image.x_mm, image.y_mm])
            wanted_deg = loop.update(wanted_deg, seen_mm, np.ones(plane.n, dtype=bool))
    return np.array(found)


def _pointing(settings: BudgetSettings, rng: np.random.Generator) -> ExposurePointing:
    """Of one field: the rotator is anywhere. In the zenith nothing is drawn."""
    rotator_deg = float(rng.uniform(0.0, 360.0)) if settings.zenith_deg else 0.0
    return ExposurePointing(Pointing(settings.zenith_deg, rotator_deg), settings.turn_deg)


# one term at a time


@dataclass(frozen=True)
class Alone:
    """One term with all others off, um rms; None: it has none there, or not alone."""

    blind_um: float | None = None
    corrected_um: float | None = None


_HALL = ("hall_offset_a", "hall_offset_b", "hall_amplitude_a", "hall_amplitude_b", "hall_phase")


def alone_um(plane: FocalPlane, seed: int, settings: BudgetSettings, fields: int) -> dict[str, Alone]:
    """um rms of each term that the twin can have alone, by the names of the budget.

    `plane`: of N positioners whose units are drawn by `seed`; `settings`: knots, errors; `fields`: random
    configurations.
    """
    units = draw_units(plane, seed, errors=settings.errors.at_calibration())
    quiet = quiet_units(plane, units)
    noise_um = plane.instrument.metrology.noise_rms_um
    none = Noises(0.0, 0.0)
    gear = replace(quiet, gear=units.gear)
    seat = replace(quiet, plant=units.plant, firmware=units.firmware)
    arms = replace(quiet, arms=_of_layout_zeros(plane, units), beta_longer_mm=units.beta_longer_mm)
    runs = {
        "gear between knots": (gear, none),
        "camera at knots": (quiet, Noises(noise_um, 0.0)),
        "arms of the table": (arms, none),
    }
    if any(mm.any() for mm in units.fibre_offset_mm.values()):
        runs["fibre"] = (replace(quiet, fibre_offset_mm=units.fibre_offset_mm), none)
    found = {name: Alone(_blind_um(plane, u, settings, fields, n)) for name, (u, n) in runs.items()}
    arrival_um = _blind_um(plane, seat, settings, fields, none, on_bench=quiet)
    found["arrival"] = Alone(arrival_um, arrival_um)
    found["seat at knots"] = Alone(_blind_um(plane, quiet, settings, fields, none, on_bench=seat))
    if settings.errors.temperature.on:
        found["temperature"] = Alone(grown_um(plane, quiet, seed, settings, fields))
    if "fibre" in found:
        found["fibre"] = Alone(found["fibre"].blind_um, found["fibre"].blind_um)
    return found | _of_attitude(plane, units, settings, fields)


def _blind_um(
    plane: FocalPlane,
    units: Units,
    settings: BudgetSettings,
    fields: int,
    noises: Noises,
    on_bench: Units | None = None,
) -> float:
    """um rms of the blind move in the zenith, tables and air apart."""
    blind = replace(settings, corrections=0, errors=NO_ERRORS, zenith_deg=0.0)
    return float(simulate(plane, units, blind, fields, noises, on_bench).rms_um[0])


def grown_um(plane: FocalPlane, quiet: Units, seed: int, settings: BudgetSettings, fields: int) -> float:
    """um rms of the blind move by arms that have grown against the plate, all else known.

    `plane`: of N positioners; `quiet`: units of whom all is known; `seed` of the night that the errors of the
    `settings` draw; `fields`: random configurations.
    """
    cold = draw_units(plane, seed, errors=NO_ERRORS)
    night = settings.errors.temperature.applied(cold, plane)
    no_mm = np.zeros((plane.n, 2))
    offsets = {name: mm - cold.fibre_offset_mm.get(name, no_mm) for name, mm in night.fibre_offset_mm.items()}
    grown = replace(
        quiet,
        arms=plane.arms + night.arms - cold.arms,
        beta_longer_mm=night.beta_longer_mm - cold.beta_longer_mm,
        fibre_offset_mm=offsets,
    )
    return _blind_um(plane, grown, settings, fields, Noises(0.0, 0.0), on_bench=quiet)


def _of_attitude(plane: FocalPlane, units: Units, settings: BudgetSettings, fields: int) -> dict[str, Alone]:
    found = {}
    if settings.errors.fiducial_um > 0.0 and len(plane.fiducials):
        found["frame"] = Alone(corrected_um=frame_alone_um(plane, settings.errors, units.seed))
    if units.loaded and settings.zenith_deg > 0.0:
        sag = sagged(plane, units, settings.zenith_deg, settings.turn_deg, fields)
        found["gravity"] = Alone(sag.blind_um, sag.turned_um)
    return found


def quiet_units(plane: FocalPlane, units: Units) -> Units:
    """The `units` of a `plane`, all of them known, and nothing scatters; the backlash stays."""
    plant, gear, firmware = units.plant.copy(), units.gear.copy(), units.firmware.copy()
    plant["seat_rms"] = 0.0
    gear["delta_rad"] = 0.0
    for name in _HALL:
        firmware[name] = plant[name]
    still = {name: np.zeros_like(mm) for name, mm in units.fibre_offset_mm.items()}
    return replace(
        units,
        plant=plant,
        gear=gear,
        firmware=firmware,
        arms=plane.arms.copy(),
        beta_longer_mm=np.zeros(plane.n),
        fibre_offset_mm=still,
    )


def _of_layout_zeros(plane: FocalPlane, units: Units) -> Floats:
    """True centres and lengths, zeros as in the layout: those are in the maps."""
    arms = units.arms.copy()
    for column in (ALPHA_OFF, BETA_OFF):
        arms[:, column] = plane.arms[:, column]
    return arms
