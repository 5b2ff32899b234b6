"""Does a pair touch if one of the two is late? By dense samples of all moments, in numpy alone."""

from collections.abc import Iterator

import numpy as np
from fields import _lines, _segments

from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan

TOUCHING_MM = 1e-6


class LateOracle:
    """The arms of a plan at equal steps of time."""

    def __init__(self, plane: FocalPlane, plan: Plan, step_s: float):
        steps = int(np.ceil(plan.duration_s / step_s))
        self.time_s = np.linspace(0.0, plan.duration_s, steps + 1)
        self.radii_mm = 2.0 * plan.collision_buffer_mm
        self.plane, self.plan = plane, plan
        self.lines = [_lines(plane, k, robot.at(self.time_s)) for k, robot in enumerate(plan.robots)]

    def pairs(self) -> Iterator[tuple[int, int]]:
        """Rows of those that move and are near each other: which is late, and the other."""
        moves = [robot.moves for robot in self.plan.robots]
        for i, j in self.plane.neighbour_pairs():
            if moves[i] and moves[j]:
                yield from ((int(i), int(j)), (int(j), int(i)))

    def gaps_mm(self, late: int, other: int, late_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Beyond the buffers, at all moments no later than that; and how late each of them is, s."""
        t, s = np.meshgrid(np.arange(len(self.time_s)), np.arange(len(self.time_s)), indexing="ij")
        lateness_s = self.time_s[s] - self.time_s[t]
        band = (s >= t) & (lateness_s <= late_s + 1e-9)
        gaps = _segments(self.lines[late][t[band]], self.lines[other][s[band]]) - self.radii_mm
        return gaps, lateness_s[band]

    def gap_at_mm(self, late: int, other: int, late_at_s: float, other_at_s: float) -> float:
        """At two moments of the plan, of the one and of the other."""
        both = zip((late, other), (late_at_s, other_at_s), strict=True)
        lines = [_lines(self.plane, k, self.plan.robots[k].at(np.array([when]))) for k, when in both]
        return float(_segments(*lines)[0]) - self.radii_mm

    def bears_s(self, late: int, other: int, late_s: float = np.inf) -> float:
        """The least lateness of all samples that touch; inf: none does."""
        gaps, lateness_s = self.gaps_mm(late, other, late_s)
        return float(lateness_s[gaps < -TOUCHING_MM].min(initial=np.inf))
