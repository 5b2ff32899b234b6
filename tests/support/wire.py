"""Frames for tests of the twin, without the bus room's client."""

import struct

import numpy as np

from fiberloom.bus.identifier import decode, encode
from fiberloom.units import COUNTS_PER_DEG

NEW, POINT, END, START, STOP, STATUS, GOTO, POSITION, COLLISION = 10, 11, 12, 14, 15, 3, 30, 32, 18


def counts(angle_deg):
    return round(float(angle_deg) * COUNTS_PER_DEG)


def goto(twin, number, alpha_deg, beta_deg):
    twin.send([(encode(number, GOTO, 1), struct.pack("<ii", counts(alpha_deg), counts(beta_deg)))])


def upload(twin, number, time_s, alpha_deg, beta_deg):
    """A trajectory with the same times on both axes."""
    n = len(time_s)
    frames = [(encode(number, NEW, 1), struct.pack("<II", n, n))]
    for angles in (alpha_deg, beta_deg):
        frames += [
            (encode(number, POINT, 2), struct.pack("<iI", counts(a), round(t / 5e-4)))
            for a, t in zip(angles, time_s, strict=True)
        ]
    for frame in [*frames, (encode(number, END, 3), b"")]:
        twin.send([frame])
        replies = twin.run(0.0005)
        assert [decode(r.id).code for r in replies] == [0], (frame, replies)


def start(twin):
    twin.send([(encode(0, START, 0), b"")])


def commands(replies):
    """(positioner, command) of each."""
    return [(decode(r.id).positioner, decode(r.id).command) for r in replies]


def ramp_path(speeds_rpm, dwell_s, start_deg, acceleration_rad_s2=840.0, step_s=0.02):
    """Times and wire angles along ramps of motor speed, smooth within the acceleration."""
    time, angle, speed = [0.0], [start_deg], 0.0
    for target in [*speeds_rpm, 0.0]:
        change_s = max(abs(target - speed) * 2 * np.pi / 60 / acceleration_rad_s2, step_s)
        steps = int(np.ceil(change_s / step_s))
        for k in range(1, steps + 1):
            mean = speed + (target - speed) * (k - 0.5) / steps
            time.append(time[-1] + change_s / steps)
            angle.append(angle[-1] + mean * 6 / 1024 * change_s / steps)
        if target != 0.0:
            time.append(time[-1] + dwell_s)
            angle.append(angle[-1] + target * 6 / 1024 * dwell_s)
        speed = target
    return np.array(time), np.array(angle)
