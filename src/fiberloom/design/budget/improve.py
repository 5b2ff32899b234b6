"""What to improve first: each cause of errors halved, and what that wins."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from fiberloom.design.budget.terms import Budget, BudgetSettings, budget
from fiberloom.instruments import FocalPlane
from fiberloom.twin import Units
from fiberloom.twin.errors.sizes import TwinErrors


@dataclass(frozen=True)
class Improvement:
    """One cause, halved."""

    change: str
    blind_um: float
    """Of the blind move, with it."""
    corrected_um: float
    """After the last correction, with it."""
    blind_won_um: float
    corrected_won_um: float


def improvements(plane: FocalPlane, units: Units, settings: BudgetSettings) -> list[Improvement]:
    """What wins most after the corrections comes first, then what wins most blind.

    `plane`: the layout; `units`: drawn for it with the errors of the `settings`.
    """
    now = budget(plane, units, settings)
    found = [_won(change, now, budget(*better)) for change, better in _halved(plane, units, settings)]
    return sorted(found, key=lambda one: (-round(one.corrected_won_um, 3), -one.blind_won_um))


def _won(change: str, now: Budget, then: Budget) -> Improvement:
    won = [a - b for a, b in zip(now.total_um, then.total_um, strict=True)]
    return Improvement(change, then.total_um[0], then.total_um[-1], won[0], won[-1])


_Changed = tuple[FocalPlane, Units, BudgetSettings]


def _halved(plane: FocalPlane, units: Units, settings: BudgetSettings) -> Iterator[tuple[str, _Changed]]:
    metrology = plane.instrument.metrology
    quieter = metrology.model_copy(update={"noise_rms_um": 0.5 * metrology.noise_rms_um})
    instrument = plane.instrument.model_copy(update={"metrology": quieter})
    yield "noise of the camera", (replace(plane, instrument=instrument), units, settings)
    yield "steps between knots", (plane, units, replace(settings, knots=2 * settings.knots - 1))
    for change, better in _better_units(plane, units):
        yield change, (plane, better, settings)
    if settings.errors.any():
        for change, errors in _better_tables(settings.errors):
            yield change, (plane, units, replace(settings, errors=errors))


def _better_tables(errors: TwinErrors) -> Iterator[tuple[str, TwinErrors]]:
    yield "table of the fiducials", replace(errors, fiducial_um=0.5 * errors.fiducial_um)
    yield "air", replace(errors, air_um=0.5 * errors.air_um)
    night = replace(errors.temperature, difference_K=0.5 * errors.temperature.difference_K)
    yield "night against calibration", replace(errors, temperature=night)


def _better_units(plane: FocalPlane, units: Units) -> Iterator[tuple[str, Units]]:
    gear, plant, load = units.gear.copy(), units.plant.copy(), units.load.copy()
    gear["delta_rad"] *= 0.5
    yield "waves of the gears", replace(units, gear=gear)
    plant["seat_rms"] *= 0.5
    yield "seat of the teeth", replace(units, plant=plant)
    arms = plane.arms + 0.5 * (units.arms - plane.arms)
    yield "table of the arms", replace(units, arms=arms, beta_longer_mm=0.5 * units.beta_longer_mm)
    if units.fibre_offset_mm:
        offsets = {name: 0.5 * mm for name, mm in units.fibre_offset_mm.items()}
        yield "table of the fibres", replace(units, fibre_offset_mm=offsets)
    if units.loaded:
        load["moment_x"] *= 0.5
        load["moment_y"] *= 0.5
        yield "moments of the arms", replace(units, load=load)
