"""The motor's clock and steps: what a tick of 18 kHz does to the field.

Field angles are whole tenths of a motor degree, so that what is added up stays exact. Sources:
desihub/fpoffline `hwtable.py` (clock, steps, ramps), copies of DESI's `posmodel.py` and `posconstants.py`
(gear, final directions).
"""

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.typing import Floats, Ints

GEAR = (46.0 / 14.0 + 1.0) ** 4
"""Motor turns per output turn: four planetary stages of ring 46 and sun 14."""
TICK_HZ = 18_000
TENTHS_PER_DEG = 10.0 * GEAR
"""Tenths of a motor degree per degree of the arm."""
CREEP_TICKS = 2
"""Ticks for a creep step of 0.1 motor degrees: 150 rpm, 2.668 deg/s of the arm."""
CRUISE_TENTHS = 33
"""Tenths a tick of a cruise: 9900 rpm, 176.1 deg/s of the arm."""
RAMP_TICKS = 12
"""Ticks at each of the 33 speeds of a ramp, 0.1, 0.2 ... 3.3 motor degrees a tick."""
SPIN_TICKS = RAMP_TICKS * CRUISE_TENTHS
SPIN_TENTHS = RAMP_TICKS * CRUISE_TENTHS * (CRUISE_TENTHS + 1) // 2
"""Way of a ramp: 673.2 motor degrees in 22 ms."""
LEAST_CRUISE_TENTHS = 1800
"""Between the ramps; a way with less than that is a creep."""
PAUSE_TICKS = TICK_HZ // 1000
"""Ticks in a millisecond of pause."""
APPROACH_DEG = 3.0
APPROACH_STEPS = round(APPROACH_DEG * TENTHS_PER_DEG)
"""Creep steps of the overshoot that closes the backlash: 10121."""
LAG_DEG = 30.0 / GEAR
"""[D] At the arm: a rotor may be so far behind its field at rest, to either side of it; that acts as play."""
FINAL_DIRECTION = np.array([-1, 1])
"""Last legs of theta and phi."""
MOST_STEPS = 2**20 - 1
"""The wire has 20 bits for the steps of a row, 16 for its pause in ms."""
MOST_PAUSE_MS = 2**16 - 1


def tenths_of(angle_deg: ArrayLike) -> Ints:
    """Output angles in deg as whole tenths of a motor degree, to the nearest."""
    return np.rint(np.asarray(angle_deg, dtype=np.float64) * TENTHS_PER_DEG).astype(np.int64)


def degrees_of(tenths: ArrayLike) -> Floats:
    """Tenths of a motor degree as output angles in deg, of a linear gear."""
    out: Floats = np.asarray(tenths, dtype=np.float64) / TENTHS_PER_DEG
    return out
