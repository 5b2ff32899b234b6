"""Positioners that are a formula and wear: for the estimators of adaptive calibration.

Gears as the twin draws them (docs/twin.md): slow harmonics, the 36 tooth pairings with their
overtones, and a ripple finer than 200 knots can see; local marks grow with the cycles.
"""

import dataclasses

import numpy as np

from fiberloom.calibration.transmission.maps import Provenance, TransmissionMaps
from fiberloom.units import MM_PER_UM

ORDERS = np.array([1, 2, 3, 36, 72, 108, 204])
SIZES_DEG = np.rad2deg([2.1e-3, 1.1e-3, 6e-4, 4e-4, 1.8e-4, 1.3e-4, 5e-4])
ARRIVAL_DEG = np.array([0.0012, 0.0007])  # Fig. 17 without its camera: 0.2 um at most
WEAR_CYCLES = 40.0


class Wearing:
    """N positioners: true gears, arms near the layout's, a camera."""

    def __init__(self, plane, seed=0, camera_um=0.669, arms_um=1.0, marks=8, sizes=1.0):
        self.rng = np.random.default_rng([seed, 1])
        rng = np.random.default_rng([seed, 0])
        self.plane, n = plane, plane.n
        self.phase = rng.uniform(0, 2 * np.pi, (n, 2, len(ORDERS)))
        self.size = SIZES_DEG * sizes * (1 + 0.2 * np.clip(rng.normal(size=self.phase.shape), -3, 3))
        turn = np.array([360.0, 180.0])[:, None]
        self.at = rng.uniform(0, 1, (n, 2, marks)) * turn
        self.width = rng.uniform(6.0, 30.0, (n, 2, marks))
        self.height = np.clip(rng.normal(0, 0.05, (n, 2, marks)), -0.1, 0.1)
        self.grown = 0.0
        self.broken = np.zeros((n, 2, 3))  # centre, width, height of one tooth
        arms = plane.arms.copy()
        arms[:, :3] += rng.normal(0, arms_um * MM_PER_UM, (n, 3))
        self.true_arms, self.camera_um = arms, camera_um
        self._points = {k: v.copy() for k, v in plane.points.items()}
        self._points["metrology"][:, 0] += rng.normal(0, arms_um * MM_PER_UM, n)
        self.true_plane = dataclasses.replace(plane, arms=arms, points=self._points)

    def wear(self, cycles):
        self.grown = 1.0 - np.exp(-cycles / WEAR_CYCLES)

    def delta_deg(self, theta, rows=slice(None)):
        """(n, 2, M) at output angles."""
        turn = np.deg2rad(theta)[..., None] * ORDERS + self.phase[rows][:, :, None]
        smooth = (self.size[rows][:, :, None] * np.cos(turn)).sum(axis=-1)
        apart = (theta[..., None] - self.at[rows][:, :, None]) / self.width[rows][:, :, None]
        worn = (self.height[rows][:, :, None] * np.exp(-0.5 * apart**2)).sum(axis=-1)
        centre, width, height = np.moveaxis(self.broken[rows][:, :, None], -1, 0)
        inside = np.abs(theta - centre) < 0.5 * width
        return smooth + self.grown * worn + np.where(inside, height, 0.0)

    def output_deg(self, wire, rows=slice(None)):
        """Where the arms come to rest (n, 2, M) without scatter."""
        theta = np.array(wire, dtype=float)
        for _ in range(9):  # a contraction: the slope of delta is below 0.2
            theta += wire - theta - self.delta_deg(theta, rows)
        return theta

    def arrive(self, wire, rows=slice(None)):
        """(n, 2) wire -> where the fibres are, and where the camera sees them, (n, 2) mm."""
        index = np.arange(self.plane.n)[rows]
        theta = self.output_deg(wire[..., None], rows)[..., 0]
        theta = theta + self.rng.normal(size=theta.shape) * ARRIVAL_DEG
        true = self.true_plane.forward(theta[:, 0], theta[:, 1], index=index)
        noise = self.rng.normal(0, self.camera_um * MM_PER_UM / np.sqrt(2), true.shape)
        return true, true + noise

    def calibrated(self, points=200, exact=False):
        """What a bench calibration now would find: knots with the camera's error."""
        n = self.plane.n
        ends = np.array([[0.0, 360.82], [0.0, 180.82]])
        wire = np.linspace(ends[:, 0], ends[:, 1], points, axis=-1)
        wire = np.broadcast_to(wire, (n, 2, points)).copy()
        noise = 0.0 if exact else np.rad2deg(0.47e-3 / np.array([18.0, 14.3]))[:, None]
        output = self.output_deg(wire) + self.rng.normal(size=wire.shape) * noise
        both = np.stack([output, output - 0.1], axis=2)
        wires = np.broadcast_to(wire[:, :, None], both.shape).copy()
        return TransmissionMaps(self.plane.positioner_id, wires, both, Provenance(note="formula"))


def random_goals(plane, rng):
    """Angles (N, 2) that spread the fibres evenly over the patrol areas."""
    l_alpha, l_beta = plane.arms[:, 2], np.hypot(*plane.points["metrology"].T)
    low, high = np.abs(l_alpha - l_beta), l_alpha + l_beta
    reach2 = rng.uniform(low**2, high**2)
    bend = np.arccos((reach2 - l_alpha**2 - l_beta**2) / (2 * l_alpha * l_beta))
    alpha = rng.uniform(0.5, 359.5, plane.n)
    return np.column_stack([alpha, np.rad2deg(np.clip(bend, 0.0, np.pi))])
