"""The same terms at other attitudes of the telescope and in other nights, by formula and on the twin."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiberloom.design.budget.attitude import sagged
from fiberloom.design.budget.monte_carlo import grown_um, quiet_units
from fiberloom.design.budget.terms import BudgetSettings, gravity_um, temperature_um
from fiberloom.instruments import FocalPlane
from fiberloom.twin import Units
from fiberloom.units import UM_PER_MM

ZENITH_DEG = (15.0, 30.0, 45.0, 60.0, 75.0, 90.0)
WARMER_K = (-30.0, -20.0, -10.0, 10.0)
"""Nights against the calibration."""


@dataclass(frozen=True)
class Attitude:
    """Gravity at one zenith distance, um rms over places and rotators."""

    zenith_deg: float
    blind_um: float
    blind_um_twin: float
    turned_um: float
    """After an image: what the rotator's turn until the exposure changes."""
    turned_um_twin: float


def attitudes(
    plane: FocalPlane, units: Units, settings: BudgetSettings, configurations: int
) -> list[Attitude]:
    """From near the zenith to the horizon; none where nothing pulls at the arms.

    `plane`, `units`: N positioners; `settings`: by how much the rotator turns; `configurations`: random ones
    of the twin.
    """
    if not units.loaded:
        return []
    turn = 2.0 * math.sin(math.radians(0.5 * settings.turn_deg))
    found = []
    for zenith_deg in ZENITH_DEG:
        sag_um = gravity_um(plane, units, zenith_deg)
        twin = sagged(plane, units, zenith_deg, settings.turn_deg, configurations)
        found.append(Attitude(zenith_deg, sag_um, twin.blind_um, turn * sag_um, twin.turned_um))
    return found


@dataclass(frozen=True)
class Night:
    """Growth at one temperature, um."""

    warmer_K: float
    """Than the calibration was."""
    arms_um: float
    """Of the arms against the plate: rms of the science fibre, blind; an image takes it off."""
    arms_um_twin: float
    plate_edge_um: float
    """Of the plate at its outermost positioner: the camera's scale and the guider take it off."""


def nights(
    plane: FocalPlane,
    units: Units,
    settings: BudgetSettings,
    configurations: int,
    warmer_K: Sequence[float] = WARMER_K,
) -> list[Night]:
    """Growth in nights that are so much warmer; none where the errors have no temperature.

    `plane`, `units`: N positioners; `settings`: errors; `configurations`: random ones of the twin;
    `warmer_K`: than the calibration was.
    """
    temperature = settings.errors.temperature
    if not temperature.on:
        return []
    quiet = quiet_units(plane, units)
    middle_mm = plane.centres_mm.mean(axis=0)
    edge_um = UM_PER_MM * float(np.linalg.norm(plane.centres_mm - middle_mm, axis=1).max())
    found = []
    for warmer in warmer_K:
        night = temperature.switched(1.0, temperature.calibrated_C + warmer)
        errors = replace(settings.errors, temperature=night)
        asked = replace(settings, errors=errors)
        formula_um = temperature_um(plane, errors, units.seed)
        twin_um = grown_um(plane, quiet, units.seed, asked, configurations)
        found.append(Night(warmer, formula_um, twin_um, night.plate_growth(units.seed) * edge_um))
    return found
