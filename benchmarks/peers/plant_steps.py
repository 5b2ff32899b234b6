"""How far the plant's steps leave the reference: motor degrees rms, worst axis of seven units, by regime.

    PYTHONPATH=tests/support python -m benchmarks.peers.plant_steps

The rule is 0.1 motor degree in every regime (docs/twin.md). The reference is tests/support/reference.py, an
independent Runge-Kutta that locates contacts and reversals; the last columns are steps of 50 us that are
longer where an axis pushes its gear through a whole tick. Takes about five minutes.
"""

import itertools

from drives import ramps
from regimes import both, closed_loop, open_loop, rms_deg
from units_of import UNITS

STEPS = {
    "100 us": 5,
    "50 us": 10,
    "25 us": 20,
    "50, 100 us": (10, 5),
    "50, 250 us": (10, 2),
    "50, 500 us": (10, 1),
}


def ramped(rpm, strength, acceleration, dwell_s):
    """Open loop along ramps to these speeds, for any axis."""
    angles = ramps(rpm, dwell_s, acceleration=acceleration)[0]
    return lambda row, axis: open_loop(strength, angles)


def fed_back(rpm, dwell_s, acceleration):
    """Closed loop through these speeds, by another unit's values."""
    return lambda row, axis: closed_loop(row, axis, rpm, dwell_s, acceleration=acceleration)


REGIMES = {
    "open loop, full field, ramps": (ramped([1000, -1000], 1.0, 3000.0, 0.05), 2.0),
    "open loop near pull-out": (ramped([900], 0.45, 2000.0, 0.1), 3.0),
    "closed loop, ramps to 2000 rpm": (fed_back([2000, -1800, 200], 0.05, 3000.0), 2.0),
    "closed loop, crawl at 5 rpm": (fed_back([5, -5, 5], 0.25, 1e6), 2.0),
    "closed loop, steps of speed": (fed_back([600, -600, 1500, 300], 0.04, 1e6), 1.0),
}
"""A drive for an axis, by row and number, and the output angle it begins at, rad."""


def worst_deg(regime, steps):
    """Of all axes."""
    drive_for, output_rad = regime
    axes = itertools.product(range(len(UNITS)), (0, 1))
    return max(rms_deg(both(row, axis, drive_for(row, axis), output_rad, steps)) for row, axis in axes)


def main():
    print(f"{'':32s}" + "".join(f"{name:>12s}" for name in STEPS))
    for name, regime in REGIMES.items():
        errors = (worst_deg(regime, steps) for steps in STEPS.values())
        print(f"{name:32s}" + "".join(f"{e:12.3f}" for e in errors), flush=True)


if __name__ == "__main__":
    main()
