"""Duties for a plant without firmware: Eq. 18, and a little controller for tests."""

import numpy as np

TICK_S = 5e-4


def field(strength, angle):
    """Eq. 18: phases A, B, C for a field of this strength and angle; (..., 3)."""
    shifts = np.array([2, -2, 0]) * np.pi / 3
    return 0.5 * strength * (1 + np.cos(np.asarray(angle)[..., None] + shifts))


class Servo:
    """Eq. 20 and 21 with the plant's nominal values: enough of a controller to track a path."""

    def __init__(self, nominal, k_p=2e-5):
        self.size = float(nominal["inertia_motor"] + nominal["inertia_gear"]) / 3.5e-9
        self.k_p = k_p * self.size
        self.nominal = nominal
        constant = nominal["flux_linkage"] / nominal["coil_resistance"]
        self.full_Nm = 1.5 * constant * np.sqrt(0.75) * nominal["supply"]
        self.drag = 1.5 * constant * nominal["flux_linkage"]
        self.drag += nominal["viscous_motor"] + nominal["viscous_gear"]

    def duty(self, theta, want, speed, acceleration):
        n = self.nominal
        torque = self.k_p * (want - theta) + self.drag * speed
        torque += (n["coulomb_motor"] + n["coulomb_gear"]) * np.sign(speed)
        torque += (n["inertia_motor"] + n["inertia_gear"]) * acceleration
        u = float(np.clip(torque / self.full_Nm, -1, 1))
        return field(abs(u), theta + np.copysign(np.pi / 2, u))


def ramps(speeds_rpm, dwell_s, acceleration=840.0):
    """Angle, speed and acceleration at every tick of a path through these speeds, rad and s."""
    speed, path = 0.0, []
    for target in [*(2 * np.pi / 60 * np.array(speeds_rpm)), 0.0]:
        ticks = max(int(abs(target - speed) / acceleration / TICK_S), 1)
        path += [
            (speed + (target - speed) * k / ticks, (target - speed) / ticks / TICK_S)
            for k in range(1, ticks + 1)
        ]
        path += [(target, 0.0)] * int(dwell_s / TICK_S)
        speed = target
    w, a = np.array(path).T
    return np.cumsum(w) * TICK_S, w, a
