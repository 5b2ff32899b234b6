"""One axis by another method: Runge-Kutta of fourth order in 10 us steps, one mode at a time
(stick, gap, pushing up, pushing down), zeros of the speed and contacts located by bisection.

Shares with the twin the equations of docs/twin.md and nothing else: no code, no state, no time
step, no friction law (the mode decides here, a soft threshold there).
"""

from bisect import bisect_right
from math import cos, sin, sqrt

import numpy as np

from fiberloom._core import twin as core

STEP_S = 10e-6
TICK_S = 5e-4
NODES = 4096


class Gear:
    """T- and B as polylines through their nodes, from the series by numpy."""

    def __init__(self, record, ratio, low_rad, high_rad):
        step = 2 * np.pi / NODES
        theta = step * np.arange(np.floor(low_rad / step) - 2, np.ceil(high_rad / step) + 3)
        waves = np.array(core.HARMONIC_ORDERS)[:, None] * theta
        c, s = np.cos(waves), np.sin(waves)
        delta, backlash = record["delta_rad"], record["backlash_rad"]
        self.output = theta
        self.gear = (ratio * (theta + delta[:, 0] @ c + delta[:, 1] @ s)).tolist()
        b = record["backlash_mean_rad"] + backlash[:, 0] @ c + backlash[:, 1] @ s
        self.backlash = b.tolist()
        self.from_above = (np.array(self.gear) + b).tolist()

    def backlash_at(self, gear):
        return _line(self.gear, self.backlash, gear)

    def gear_in_positive_contact(self, theta):
        return _line(self.from_above, self.gear, theta)

    def gear_at_output(self, output):
        return float(np.interp(output, self.output, self.gear))

    def output_at(self, gear):
        return float(np.interp(gear, self.gear, self.output))


def _line(x, y, at):
    i = min(max(bisect_right(x, at) - 1, 0), len(x) - 2)
    return y[i] + (at - x[i]) * (y[i + 1] - y[i]) / (x[i + 1] - x[i])


class Axis:
    """State: theta, omega of the rotor, gear angle, contact (-1, 0 in the gap, 1)."""

    def __init__(self, params, gear_record, output_rad):
        self.p = {name: float(params[name]) for name in params.dtype.names}
        self.gear_map = Gear(gear_record, self.p["gear_ratio"], output_rad - 1.0, output_rad + 1.0)
        self.gear = self.gear_map.gear_at_output(output_rad)
        self.theta, self.omega, self.contact = self.gear, 0.0, -1
        self.external_Nm = 0.0
        self.constant = self.p["flux_linkage"] / self.p["coil_resistance"]
        self.pull = (0.0, 0.0)

    # -- torques

    def voltage(self, duty):
        """Eq. 15 to 17, coil by coil: the torque at standstill as S sin(theta) + C cos(theta)."""
        steps = self.p["pwm_steps"]
        a, b, c = (np.rint(np.clip(np.float32(d), 0, 1) * steps) / steps for d in duty)
        u = self.p["supply"] * np.array([b - a, c - b, a - c])
        shift = np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3])
        self.pull = (
            -self.constant * float(u @ np.sin(shift)),
            self.constant * float(u @ np.cos(shift)),
        )

    def drive(self, theta):
        p = self.p
        cog = p["cogging_2"] * sin(2 * theta + p["cogging_2_phase"])
        cog += p["cogging_4"] * sin(4 * theta + p["cogging_4_phase"])
        return self.pull[0] * sin(theta) + self.pull[1] * cos(theta) - cog

    def load(self, gear):
        p = self.p
        spring = p["spring_rate"] * (p["spring_free"] - gear / p["gear_ratio"])
        return (spring + self.external_Nm) / p["gear_ratio"]

    def friction(self, direction, pushing):
        p = self.p
        if not pushing:
            return p["coulomb_motor"]
        gear = self.gear_of(self.theta) if pushing else self.gear
        return p["coulomb_motor"] + max(p["coulomb_gear"] - direction * self.load(gear), 0.0)

    def gear_of(self, theta):
        return self.gear_map.gear_in_positive_contact(theta) if self.contact > 0 else theta

    # -- one mode

    def acceleration(self, theta, omega, direction, pushing):
        p = self.p
        inertia = p["inertia_motor"] + (p["inertia_gear"] if pushing else 0.0)
        drag = 1.5 * self.constant * p["flux_linkage"] + p["viscous_motor"]
        drag += p["viscous_gear"] if pushing else 0.0
        rub = direction * self.friction(direction, pushing)
        return (self.drive(theta) - drag * omega - rub) / inertia

    def runge_kutta(self, h, direction, pushing):
        a, t, w = self.acceleration, self.theta, self.omega
        k1 = a(t, w, direction, pushing)
        k2 = a(t + h / 2 * w, w + h / 2 * k1, direction, pushing)
        k3 = a(t + h / 2 * w + h * h / 4 * k1, w + h / 2 * k2, direction, pushing)
        k4 = a(t + h * w + h * h / 2 * k2, w + h * k3, direction, pushing)
        return t + h * w + h * h / 6 * (k1 + k2 + k3), w + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def ended(self, theta, omega, direction, limit):
        return omega * direction < 0.0 or (limit is not None and (theta - limit) * direction > 0.0)

    def move(self, left, direction):
        """Follows one mode for at most a step; returns the time it took."""
        pushing = self.contact == direction
        if not pushing:
            self.contact = 0
        limit = None if pushing else self.gear + (self.backlash() if direction > 0 else 0.0)
        h = min(STEP_S, left)
        theta, omega = self.runge_kutta(h, direction, pushing)
        if self.ended(theta, omega, direction, limit):
            h = self.bisect(h, direction, pushing, limit)
            theta, omega = self.runge_kutta(h, direction, pushing)
            self.settle(theta, omega, direction, limit)
        else:
            self.theta, self.omega = theta, omega
        if pushing:
            self.gear = self.gear_of(self.theta)
        return h

    def backlash(self):
        return self.gear_map.backlash_at(self.gear)

    def bisect(self, h, direction, pushing, limit):
        low, high = 0.0, h
        for _ in range(50):
            middle = (low + high) / 2
            if self.ended(*self.runge_kutta(middle, direction, pushing), direction, limit):
                high = middle
            else:
                low = middle
        return high

    def settle(self, theta, omega, direction, limit):
        self.theta = theta
        if omega * direction <= 0.0:
            self.omega = 0.0
            return
        self.theta, self.contact = limit, direction
        p = self.p
        self.omega = omega * p["inertia_motor"] / (p["inertia_motor"] + p["inertia_gear"])

    def wish(self):
        """Where a rotor at rest goes: 0 is stay, for friction takes all."""
        torque = self.drive(self.theta)
        for direction in (1, -1):
            if torque * direction > self.friction(direction, self.contact == direction):
                return direction
        return 0

    def tick(self, duty):
        self.voltage(duty)
        left = TICK_S
        while left > 1e-15:
            direction = int(np.sign(self.omega)) or self.wish()
            if direction == 0:
                return
            left -= self.move(left, direction)


def field_frequency(params):
    """Small oscillations of a free rotor in a full field, rad/s: sqrt(K / J)."""
    stiffness = 1.5 * params["flux_linkage"] / params["coil_resistance"] * sqrt(0.75)
    return sqrt(stiffness * params["supply"] / params["inertia_motor"])
