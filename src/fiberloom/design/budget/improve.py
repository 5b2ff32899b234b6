"""What to improve first: each cause of errors halved, and the derivative by it."""

from __future__ import annotations

import math
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
    blind_slope: float
    """Per cent of the blind error by per cent of the cause: d ln(error)/d ln(cause)."""
    corrected_slope: float
    """The same after the last correction."""


SMALL = 0.99
"""Of a cause, for the derivative."""
HALF = 0.5


def improvements(plane: FocalPlane, units: Units, settings: BudgetSettings) -> list[Improvement]:
    """What wins most after the corrections, halved, comes first, then what wins most blind.

    `plane`: the layout; `units`: drawn for it with the errors of the `settings`.
    """
    now = budget(plane, units, settings)
    little, much = (_less(plane, units, settings, factor) for factor in (SMALL, HALF))
    found = [
        _won(change, now, budget(*barely), budget(*halved), ratio)
        for (change, ratio, barely), (_, _, halved) in zip(little, much, strict=True)
    ]
    return sorted(found, key=lambda one: (-round(one.corrected_won_um, 3), -one.blind_won_um))


def _won(change: str, now: Budget, barely: Budget, halved: Budget, ratio: float) -> Improvement:
    first, last = ((one.total_um[0], one.total_um[-1]) for one in (now, halved))
    slopes = [
        math.log(a / b) / math.log(1.0 / ratio) if min(a, b) > 0.0 else 0.0
        for a, b in ((now.total_um[k], barely.total_um[k]) for k in (0, -1))
    ]
    return Improvement(change, *last, first[0] - last[0], first[1] - last[1], *slopes)


_Changed = tuple[FocalPlane, Units, BudgetSettings]
_Named = tuple[str, float, _Changed]
"""A cause, the share of it that is left, and what has it so."""


def _less(plane: FocalPlane, units: Units, settings: BudgetSettings, factor: float) -> Iterator[_Named]:
    metrology = plane.instrument.metrology
    quieter = metrology.model_copy(update={"noise_rms_um": factor * metrology.noise_rms_um})
    instrument = plane.instrument.model_copy(update={"metrology": quieter})
    yield "noise of the camera", factor, (replace(plane, instrument=instrument), units, settings)
    knots = 1 + math.ceil((settings.knots - 1) / factor)
    finer = replace(settings, knots=knots)
    yield "steps between knots", (settings.knots - 1) / (knots - 1), (plane, units, finer)
    for change, better in _better_units(plane, units, factor):
        yield change, factor, (plane, better, settings)
    if settings.errors.any():
        for change, errors in _better_tables(settings.errors, factor):
            yield change, factor, (plane, units, replace(settings, errors=errors))


def _better_tables(errors: TwinErrors, factor: float) -> Iterator[tuple[str, TwinErrors]]:
    yield "table of the fiducials", replace(errors, fiducial_um=factor * errors.fiducial_um)
    yield "air", replace(errors, air_um=factor * errors.air_um)
    night = replace(errors.temperature, difference_K=factor * errors.temperature.difference_K)
    yield "night against calibration", replace(errors, temperature=night)


def _better_units(plane: FocalPlane, units: Units, factor: float) -> Iterator[tuple[str, Units]]:
    gear, plant, load = units.gear.copy(), units.plant.copy(), units.load.copy()
    gear["delta_rad"] *= factor
    yield "waves of the gears", replace(units, gear=gear)
    plant["seat_rms"] *= factor
    yield "seat of the teeth", replace(units, plant=plant)
    arms = plane.arms + factor * (units.arms - plane.arms)
    yield "table of the arms", replace(units, arms=arms, beta_longer_mm=factor * units.beta_longer_mm)
    if units.fibre_offset_mm:
        offsets = {name: factor * mm for name, mm in units.fibre_offset_mm.items()}
        yield "table of the fibres", replace(units, fibre_offset_mm=offsets)
    if units.loaded:
        load["moment_x"] *= factor
        load["moment_y"] *= factor
        yield "moments of the arms", replace(units, load=load)
