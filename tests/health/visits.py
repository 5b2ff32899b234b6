"""A plane in operation, as arithmetic: fields, corrections, camera, and what may go wrong."""

from dataclasses import dataclass

import numpy as np

from fiberloom.health.monitor import ObservedMove
from fiberloom.instruments import FocalPlane

RIPPLE_DEG = 0.025
"""What a map of 200 points does not know, rms: 8 to 10 um at SDSS-V's arms."""


@dataclass
class Trouble:
    """What ails one positioner from `start` on; sizes in deg, mm, or shares."""

    kind: str
    row: int = 0
    axis: int = 0
    start: int = 60
    size: float = 0.0


class Visits:
    """Goes from field to field with two corrections each, all positioners at once."""

    def __init__(self, plane: FocalPlane, seed: int, troubles: tuple[Trouble, ...] = ()) -> None:
        self.plane, self.rng, self.troubles = plane, np.random.default_rng(seed), list(troubles)
        n = len(plane)
        self.phase = self.rng.uniform(0, 2 * np.pi, (n, 2))
        self.believed = self.rng.uniform([10.0, 20.0], [350.0, 160.0], (n, 2))
        self.lost = np.zeros((n, 2))  # true minus what map and motor say
        self.habit = self.rng.normal(0.0, 0.1, (n, 2))
        self.move = 0

    def run(self, fields: int):
        """Passages: blind move and two corrections for each field."""
        n = len(self.plane)
        for _ in range(fields):
            self._datum()
            goal = self.rng.uniform([10.0, 16.0], [350.0, 164.0], (n, 2))
            yield self._go(goal)
            for way_deg in (0.04, 0.004):
                yield self._go(self.believed + self.rng.normal(0.0, way_deg, (n, 2)))

    def _datum(self):
        """Between fields a host that trusts its camera takes positioners for where they are seen."""
        astray = np.abs(self.lost).max(axis=1) > 1.0
        self.believed[astray] += self.lost[astray]
        self.lost[astray] = 0.0

    def _go(self, to_deg):
        before, way = self.believed.copy(), to_deg - self.believed
        self.believed = to_deg
        self.move += 1
        for t in self.active():
            if t.kind == "scale":
                self.lost[t.row, t.axis] += (t.size - 1.0) * way[t.row, t.axis]
            if t.kind == "stuck" or (t.kind == "non_moves" and self.rng.random() < t.size):
                self.lost[t.row, t.axis] -= way[t.row, t.axis]
            if t.kind == "slipped" and t.start == self.move:
                self.lost[t.row, t.axis] += t.size
        seen = self._seen()
        asked = np.ones(len(self.plane), dtype=bool)
        return ObservedMove(before, self.believed.copy(), seen, asked, asked, effort=self._effort())

    def active(self):
        """Troubles that have begun."""
        return [t for t in self.troubles if self.move >= t.start]

    def _seen(self):
        n = len(self.plane)
        ripple = np.sqrt(2) * np.sin(204 * np.radians(self.believed) + self.phase)
        true = self.believed + self.lost + RIPPLE_DEG * ripple
        scatter_um = np.full(n, 0.2)
        plane, long = self.plane, np.zeros(n)
        for t in self.active():
            at = self.believed[t.row, t.axis]
            if t.kind == "tooth" and 80.0 < at < 88.0:
                true[t.row, t.axis] += t.size
            if t.kind == "scatter":
                scatter_um[t.row] = t.size
            if t.kind == "loose_arm":
                long[t.row] = t.size
            if t.kind == "jittery_arm":
                long[t.row] = t.size * self.rng.normal()
        xy = plane.forward(*true.T)
        arms = plane.arms
        elbow_deg = true[:, 0:1] * np.pi / 180 + arms[:, 3:4]
        elbow = plane.centres_mm + arms[:, 2:3] * np.hstack([np.cos(elbow_deg), np.sin(elbow_deg)])
        along = (xy - elbow) / np.hypot(*(xy - elbow).T)[:, None]
        noise_mm = 1e-3 * np.hypot(0.669, scatter_um)[:, None] / np.sqrt(2)
        xy = xy + long[:, None] * along + noise_mm * self.rng.standard_normal((n, 2))
        for t in self.active():
            if t.kind == "dark":
                xy[t.row] = np.nan
        return xy

    def _effort(self):
        weather = 0.2 * np.sin(self.move / 500)
        effort = weather + self.habit + self.rng.normal(0.0, 0.04, self.habit.shape)
        for t in self.active():
            if t.kind == "friction":
                effort[t.row, t.axis] += t.size
        return effort
