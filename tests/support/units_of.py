"""Axes for tests of the plant: nominal ones, and drawn ones."""

import numpy as np

from fiberloom._core import twin as core
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import draw_units
from fiberloom.twin.units import GEAR_DTYPE, PLANT_DTYPE, defaults, plain

PLANE = generate(load_instrument("sdssv"), seed=5, n_positioners=7)
UNITS = draw_units(PLANE, seed=11)
UNITS.plant["seat_rms"] = 0.0  # exact gears: what repeats can be told to the last digit


def nominal(**changes):
    """One default axis."""
    record = defaults(core.PLANT_PARAMS, PLANT_DTYPE)
    for name, value in changes.items():
        record[name] = value
    return record


def gear_of(backlash_deg=140.0):
    """A perfect gear with constant backlash."""
    record = np.zeros((), GEAR_DTYPE)
    record["backlash_mean_rad"] = np.deg2rad(backlash_deg)
    return record


def plant(params, gears, output_rad, **options):
    """A plant of one or more axes."""
    params, gears = np.atleast_1d(params), np.atleast_1d(gears)
    outputs = np.broadcast_to(np.asarray(output_rad, float), params.shape).copy()
    return core.Plant(plain(params), plain(gears), outputs, **options)
