"""A bench without physics: positioners that are a formula, and a camera that sees their fibres."""

import numpy as np

from fiberloom.bus import Outcome, Result, Results
from fiberloom.metrology import Measurement


class Bench:
    """Client and camera of N positioners with known maps.

    T-(theta)/n_bar = theta + delta, T+/n_bar = that + backlash. In the gap the arm stays.
    """

    def __init__(self, plane, noise_rms_um=0.0, seed=0):
        self.plane = plane
        self.rng = np.random.default_rng(seed)
        self.sigma_mm = noise_rms_um * 1e-3 / np.sqrt(2.0)
        n = plane.n
        self.phase = self.rng.uniform(0, 2 * np.pi, (n, 2, 5))
        self.amplitude_deg = np.array([0.06, 0.03, 0.02, 0.01])
        self.orders = np.array([1, 2, 36, 72])
        self.backlash_mean_deg = self.rng.uniform(80, 200, (n, 2)) / 1024
        self.wire = np.zeros((n, 2))
        self.output = self.solve(self.wire, 0.0)
        self.results = {}  # positioner -> outcome of every move from now on
        self.stuck = np.zeros((n, 2), dtype=bool)
        self.dark = np.zeros(n, dtype=bool)
        self.moves = 0
        self.precise = True
        self.time_s = 0.0

    # the truth

    def delta_deg(self, theta):
        turn = np.deg2rad(theta)[..., None] * self.orders + self.phase[..., :4]
        return np.sin(turn) @ self.amplitude_deg

    def backlash_deg(self, theta):
        return self.backlash_mean_deg + 0.04 * np.sin(np.deg2rad(theta) + self.phase[..., 4])

    def wire_of(self, theta, side):
        return theta + self.delta_deg(theta) + side * self.backlash_deg(theta)

    def solve(self, wire, side):
        theta = np.array(wire, dtype=float)
        for _ in range(12):  # a contraction: the slope of delta is below 0.03
            theta += wire - self.wire_of(theta, side)
        return theta

    # the client

    async def set_precise_moves(self, ids, *, on):
        self.precise = on
        return self.done(ids)

    async def set_speed(self, ids, alpha_rpm, beta_rpm):
        return self.done(ids)

    async def sleep(self, duration_s):
        self.time_s += duration_s

    async def goto(self, ids, alpha_deg, beta_deg):
        rows = self.plane.index_of(np.array(ids, dtype=int))
        goal = self.wire.copy()
        goal[rows] = [alpha_deg, beta_deg]
        goal[self.stuck] = self.wire[self.stuck]
        self.wire = goal
        # negative contact pushes from above, positive contact from below
        self.output = np.clip(self.output, self.solve(goal, 1.0), self.solve(goal, 0.0))
        self.moves += 1
        return self.done(ids, (100, 100))

    async def wait_until_done(self, ids, **how):
        self.time_s += 0.3
        return self.done(ids)

    def done(self, ids, values=()):
        return Results({i: Result(i, self.results.get(i, Outcome.DONE), values=values) for i in ids})

    # the camera

    def measure(self, expected_mm=None):
        xy = self.plane.forward(self.output[:, 0], self.output[:, 1])
        xy = xy + self.rng.normal(0.0, self.sigma_mm or 1e-300, xy.shape)
        xy[self.dark] = np.nan
        return Measurement(xy[:, 0], xy[:, 1], ~self.dark, self.time_s)
