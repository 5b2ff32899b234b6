"""The plant beside the reference, tick by tick, in the regimes in which its integrator has to hold."""

import numpy as np
from drives import Servo, field, ramps
from reference import Axis
from units_of import UNITS, plant


def smooth(record):
    """Without PWM steps: with feedback, a step more or less would hide the integrator's error."""
    record = record.copy()
    record["pwm_steps"] = 1e6
    return record


def both(row, axis, duties, output_rad, substeps):
    """Motor angles after every tick, rad: ours, theirs. `duties(theta, tick)` may feed back."""
    params, gear = smooth(UNITS.plant[row, axis]), UNITS.gear[row, axis]
    ours = plant(params, gear, output_rad, substeps=substeps)
    theirs = Axis(params, gear, output_rad)
    logs, tick = ([], []), 0
    while (pair := [duties(a, tick) for a in (ours.state(0)[0], theirs.theta)])[0] is not None:
        logs[0].append(ours.run(pair[0][None, None])[0][0, 0, 0])
        theirs.tick(pair[1])
        logs[1].append(theirs.theta)
        tick += 1
    return np.array(logs[0]), np.array(logs[1])


def closed_loop(row, axis, speeds_rpm, dwell_s, **options):
    want, speed, acceleration = ramps(speeds_rpm, dwell_s, **options)
    servo = Servo(UNITS.plant[(row + 1) % len(UNITS), axis])  # another unit's values: errors remain
    start = []

    def duty(theta, tick):
        if tick == 0:
            start.append(theta)
        if tick == len(want):
            return None
        return servo.duty(theta, start[0] + want[tick], speed[tick], acceleration[tick])

    return duty


def open_loop(strength, angles):
    def duty(theta, tick):
        if tick == 0:
            duty.start = theta
        return field(strength, duty.start + angles[tick]) if tick < len(angles) else None

    return duty


def rms_deg(pair):
    return float(np.rad2deg(np.sqrt(np.mean((pair[0] - pair[1]) ** 2))))
