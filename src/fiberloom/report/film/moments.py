"""Where all arms are at the moments of a film, who is in motion, and how near they come."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan
from fiberloom.planning.bodies import CollisionBodies
from fiberloom.planning.overlaps import Surroundings
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad

NEAR_MM = 0.5
"""Arms that come nearer than this beyond their buffers are marked."""

STEP_S = 0.3
"""Motion from picture to picture: 100 pictures in 30 s."""
FEWEST, MOST = 30, 150
"""Steps of a film that moves at all: short motions are shown slower, long ones faster."""
FINER = 4
"""Moments of the curves in one step of the film."""

_MOMENT_S = 1e-3
_STILL_DEG = 1e-9


@dataclass(frozen=True, eq=False)
class Moments:
    """A plan at T moments. Arrays have the N positioners of the plane in its order."""

    plane: FocalPlane
    plan: Plan
    goal_deg: Floats
    """(N, 2) where they should go, also of who does not arrive."""

    @cached_property
    def time_s(self) -> Floats:
        """(T,) moments of the curves; a picture is every `FINER`th, the first and the last included."""
        duration_s = self.plan.duration_s
        if duration_s <= 0.0:
            return np.zeros(1)
        steps = int(np.clip(np.ceil(duration_s / STEP_S), FEWEST, MOST))
        return np.linspace(0.0, duration_s, steps * FINER + 1)

    @property
    def pictures(self) -> Ints:
        """Moments that are pictures."""
        return np.arange(0, len(self.time_s), FINER)

    @cached_property
    def rows(self) -> Ints:
        """Row in the plane of each trajectory of the plan."""
        return np.atleast_1d(self.plane.index_of([r.positioner_id for r in self.plan.robots]))

    def _at(self, time_s: Floats) -> Floats:
        out = np.tile(self.plane.offline_position_deg, (len(time_s), 1, 1))
        for row, robot in zip(self.rows, self.plan.robots, strict=True):
            if not self.plane.offline[row]:
                out[:, row] = robot.at(time_s)
        return out

    @cached_property
    def angles_deg(self) -> Floats:
        """(T, N, 2)"""
        return self._at(self.time_s)

    @cached_property
    def moving(self) -> Flags:
        """(T, N) which turn an axis at this moment."""
        way = self._at(self.time_s + _MOMENT_S) - self._at(self.time_s - _MOMENT_S)
        return (np.abs(way) > _STILL_DEG).any(axis=2) & ~self.ended

    @cached_property
    def ended(self) -> Flags:
        """(T, N) which have no more motion before them."""
        end_s = np.zeros(self.plane.n)
        end_s[self.rows] = [robot.time_s[-1] for robot in self.plan.robots]
        return np.asarray(self.time_s[:, None] >= end_s, dtype=np.bool_)

    @property
    def arrived(self) -> Flags:
        """(T, N) which are at their goal for good."""
        return self.ended & ~self.refused & ~self.plane.offline

    @cached_property
    def refused(self) -> Flags:
        """(N,) which do not arrive."""
        return np.isin(self.plane.positioner_id, list(self.plan.refused))

    @cached_property
    def bodies(self) -> CollisionBodies:
        """With the collision buffer of the plan; the obstacles are fiducials, guide cameras, keep-outs and
        where offline positioners may be."""
        return CollisionBodies.of(self.plane, self.plan.collision_buffer_mm)

    @cached_property
    def around(self) -> Surroundings:
        """Which of the bodies can touch, and how near they are."""
        return Surroundings(self.plane, self.bodies)

    @cached_property
    def _gaps(self) -> tuple[Floats, Flags, Ints]:
        least_mm = np.full(len(self.time_s), np.inf)
        nearest = np.zeros((len(self.time_s), 2), dtype=np.int64)
        goes = np.zeros(self.plane.n + len(self.bodies.obstacles), dtype=np.bool_)
        goes[self.rows] = [robot.moves for robot in self.plan.robots]
        near = np.zeros((len(self.time_s), self.plane.n + len(self.bodies.obstacles)), dtype=np.bool_)
        for k, here_rad in enumerate(deg_to_rad(self.angles_deg)):
            rows, others, gaps_mm = self.around.gaps_of_pairs_mm(here_rad)
            of_motion_mm = np.where(goes[rows] | goes[others], gaps_mm, np.inf)
            least_mm[k] = of_motion_mm.min(initial=np.inf)
            if len(rows):
                which = of_motion_mm.argmin()
                nearest[k] = rows[which], others[which]
            close = gaps_mm < NEAR_MM
            near[k, rows[close]] = near[k, others[close]] = True
        return least_mm, near, nearest

    @property
    def least_gap_mm(self) -> Floats:
        """(T,) of pairs of which one moves in the plan, beyond the buffers; inf where there are none."""
        return self._gaps[0]

    @property
    def near(self) -> Flags:
        """(T, N + K) arms, then obstacles, that are nearer to another body than `NEAR_MM`."""
        return self._gaps[1]

    def nearest(self, moment: int) -> str:
        """The two with the least gap of this moment, and the gap; empty where there are none."""
        gap_mm = self.least_gap_mm[moment]
        if not np.isfinite(gap_mm):
            return ""
        one, other = (self.around.name(int(body)) for body in self._gaps[2][moment])
        return f"nearest: {one} and {other.removeprefix('positioner ')}, {gap_mm:.3f} mm"
