"""Which positioners can search their datum at the same time, and where the others have to be meanwhile.

A search of beta turns the arm to the hard stop, stretched; most of the way from its folded place a plan has
made before. It sweeps the places of neighbours. So each one that searches (a searcher) turns its folded arm
to a side to which the way is free, and neighbours bend away. When it moves, and how fast, is not known: the
bodies at rest keep clear of all that a searcher sweeps, and the discs within which two searchers may be are
disjoint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fiberloom._core import geometry
from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan, Trajectory, verify
from fiberloom.planning.bodies import CollisionBodies
from fiberloom.timing import part
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad

MARGIN_MM = 0.5
"""Beyond touching: approach, maps and the sampling of the sweep together."""

FOLDED_DEG = 2.0
"""So near its place when parked, a positioner counts as folded."""

STEP_DEG = 2.0
"""Between samples of a sweep; the tip moves 0.6 mm."""

SIDES_DEG = tuple(np.arange(0.0, 360.0, 30.0))
"""Angles of alpha that are tried for a searcher, from its folded place on."""

_ALPHAS_DEG, _BETAS_DEG = np.arange(0.0, 360.0, 15.0), np.arange(170.0, 15.0, -10.0)
"""ArrayPlaces that are tried for neighbours, the most folded first."""


@dataclass(frozen=True)
class SearchSweep:
    """What one searcher sweeps."""

    segments_mm: Floats
    """(S, 4) centre lines of its beta arm on the way."""
    centre_mm: Floats
    """(2,) of a disc that it does not leave."""
    radius_mm: float

    @cached_property
    def disc(self) -> tuple[float, float, float]:
        """That disc as plain numbers, mm: x, y, radius."""
        x, y = self.centre_mm.tolist()
        return x, y, float(self.radius_mm)

    def near(self, x_mm: float, y_mm: float, radius_mm: float) -> bool:
        """Whether another disc comes within the margin."""
        x, y, radius = self.disc
        return math.hypot(x - x_mm, y - y_mm) <= radius + radius_mm + MARGIN_MM


@dataclass
class Round:
    """Searchers of one time, and where every positioner is meanwhile."""

    searchers: list[int]
    """Rows."""
    goals_deg: Floats
    """(N, 2) for all; of the searchers where they begin."""
    sweeps: dict[int, SearchSweep]


class Clearing:
    """Makes rounds for one focal plane."""

    def __init__(self, plane: FocalPlane, here_deg: Floats, mobile: Flags, somewhere: Flags) -> None:
        """`plane`: N positioners; `here_deg` (N, 2): where each is; `mobile` (N,): which can be sent
        elsewhere; `somewhere` (N,): which may be anywhere within reach."""
        self.plane, self.here_deg, self.mobile, self.somewhere = plane, here_deg, mobile, somewhere
        bodies = CollisionBodies.of(plane)
        discs = np.column_stack([np.tile(plane.centres_mm[somewhere], 2), plane.body_reach_mm[somewhere]])
        self.obstacles = np.vstack([bodies.obstacles[:, :5], discs])
        self._segment, self._radius_mm = bodies.segment_mm, float(bodies.radii_mm.max())
        grid = np.stack(np.meshgrid(_BETAS_DEG, _ALPHAS_DEG, indexing="ij"), axis=-1).reshape(-1, 2)
        self._places_deg = grid[:, ::-1].copy()

    def arms_mm(self, rows: Ints, angles_deg: Floats) -> Floats:
        """Centre lines (n, 4) of beta arms: `rows` (n,) at angles (n, 2)."""
        return geometry.beta_segment(
            np.ascontiguousarray(self.plane.arms[rows]),
            *self._segment,
            deg_to_rad(np.ascontiguousarray(angles_deg)),
        )

    def of_beta(self, row: int, alpha_deg: float) -> SearchSweep:
        """The search of beta with alpha at rest: all of the travel, whatever it reports."""
        stop_deg, folded_deg = self.plane.hard_stops_deg[1, 0], self.plane.park_deg[row, 1] + 2.0 * STEP_DEG
        beta_deg = np.arange(stop_deg, folded_deg + STEP_DEG, STEP_DEG)
        angles_deg = np.column_stack([np.full(len(beta_deg), alpha_deg), beta_deg])
        segments = self.arms_mm(np.full(len(beta_deg), row), angles_deg)
        length_mm = max(map(abs, self._segment))
        return SearchSweep(segments, segments[0, :2], length_mm + self._radius_mm)

    def of_alpha(self, row: int) -> SearchSweep:
        """The search of alpha with beta as it is: a whole turn of the arm."""
        alpha_deg = np.arange(0.0, 360.0, STEP_DEG)
        angles_deg = np.column_stack([alpha_deg, np.full(len(alpha_deg), self.here_deg[row, 1])])
        segments = self.arms_mm(np.full(len(alpha_deg), row), angles_deg)
        far_mm = np.hypot(*(segments.reshape(-1, 2) - self.plane.centres_mm[row]).T).max()
        return SearchSweep(segments, self.plane.centres_mm[row], float(far_mm) + self._radius_mm)

    def of_both(self, row: int) -> SearchSweep:
        """Of a positioner of which nothing is certain: its whole reach."""
        centre = self.plane.centres_mm[row]
        reach_mm = float(self.plane.body_reach_mm[row])
        angle = np.deg2rad(np.arange(0.0, 360.0, STEP_DEG))
        rim = centre + (reach_mm - self._radius_mm) * np.column_stack([np.cos(angle), np.sin(angle)])
        return SearchSweep(np.column_stack([np.tile(centre, (len(rim), 1)), rim]), centre, reach_mm)

    # rounds

    @part("clearing")
    def beta_round(self, waiting: list[int]) -> Round:
        """As many of the waiting rows as can search beta at once; none where none can."""
        found = Round([], np.where(self.mobile[:, None], self.plane.park_deg, self.here_deg), {})
        for row in waiting:
            for side_deg in SIDES_DEG:
                alpha_deg = (self.plane.park_deg[row, 0] + side_deg) % 360.0
                if self._join(found, row, self.of_beta(row, alpha_deg), alpha_deg):
                    break
        return found

    def whole_round(self, waiting: list[int]) -> Round:
        """As many of the waiting rows as can search both axes at once, from where they are."""
        found = Round([], np.where(self.mobile[:, None], self.plane.park_deg, self.here_deg), {})
        for row in waiting:
            self._join(found, row, self.of_both(row), None)
        return found

    def alpha_round(self, waiting: list[int]) -> Round:
        """As many of the waiting rows as can search alpha at once, folded as they are."""
        found = Round([], self.here_deg.copy(), {})
        for row in waiting:
            sweep = self.of_alpha(row)
            if self._apart(found, row, sweep) and not self.in_the_way(
                row, sweep, found.goals_deg, found.sweeps
            ):
                self._add(found, row, sweep, None)
        return found

    def _join(self, found: Round, row: int, sweep: SearchSweep, alpha_deg: float | None) -> bool:
        """Adds a searcher if the bodies in its way can be elsewhere."""
        if not self._apart(found, row, sweep) or self._meets_obstacle(sweep):
            return False
        goals_deg = found.goals_deg.copy()
        if alpha_deg is not None:
            goals_deg[row, 0] = alpha_deg
        sweeps = {**found.sweeps, row: sweep}
        for other in self.in_the_way(row, sweep, goals_deg, sweeps):
            place_deg = self._elsewhere(other, goals_deg, sweeps) if self.mobile[other] else None
            if place_deg is None:
                return False
            goals_deg[other] = place_deg
        found.goals_deg = goals_deg
        self._add(found, row, sweep, alpha_deg)
        return True

    def _add(self, found: Round, row: int, sweep: SearchSweep, alpha_deg: float | None) -> None:
        found.searchers.append(row)
        found.sweeps[row] = sweep
        if alpha_deg is not None:
            found.goals_deg[row, 0] = alpha_deg

    def _apart(self, found: Round, row: int, sweep: SearchSweep) -> bool:
        """No searcher of the round can be where this one may be."""
        disc = sweep.disc
        return not any(other.near(*disc) for other in found.sweeps.values())

    def _meets_obstacle(self, sweep: SearchSweep, but: int | None = None) -> bool:
        if not len(self.obstacles):
            return False
        near = np.hypot(*(self.obstacles[:, :2] - sweep.centre_mm).T) < 3.0 * sweep.radius_mm + 20.0
        return bool((self._gaps(sweep.segments_mm, self.obstacles[near, :4]) < self.obstacles[near, 4]
                     + self._radius_mm + MARGIN_MM).any())  # fmt: skip

    def _gaps(self, first: Floats, second: Floats) -> Floats:
        """(S, n) distances of centre lines in mm."""
        pairs = np.repeat(first, len(second), axis=0), np.tile(second, (len(first), 1))
        return geometry.segment_distance(*map(np.ascontiguousarray, pairs)).reshape(len(first), len(second))

    def in_the_way(
        self, row: int, sweep: SearchSweep, goals_deg: Floats, sweeps: dict[int, SearchSweep]
    ) -> list[int]:
        """Rows, but searchers, whose bodies are in what a searcher sweeps.

        `row`: the searcher, and its `sweep`; `goals_deg`: (N, 2) where all are; `sweeps`: of all searchers.
        """
        near = np.hypot(*(self.plane.centres_mm - sweep.centre_mm).T) < (
            sweep.radius_mm + self.plane.body_reach_mm + MARGIN_MM
        )
        others = np.array([i for i in np.flatnonzero(near) if i != row and i not in sweeps], dtype=np.int64)
        if not len(others):
            return []
        gaps = self._gaps(sweep.segments_mm, self.arms_mm(others, goals_deg[others])).min(axis=0)
        return [int(i) for i in others[gaps < 2.0 * self._radius_mm + MARGIN_MM]]

    def blocked(self, row: int, sweep: SearchSweep, sweeps: dict[int, SearchSweep]) -> bool:
        """Whether anything is in the way of a searcher now, as positioners are."""
        return self._meets_obstacle(sweep) or bool(self.in_the_way(row, sweep, self.here_deg, sweeps))

    def _elsewhere(self, row: int, goals_deg: Floats, sweeps: dict[int, SearchSweep]) -> Floats | None:
        """A place for one that is in the way; None where there is none."""
        arms = self.arms_mm(np.full(len(self._places_deg), row), self._places_deg)
        reach_mm = float(self.plane.body_reach_mm[row])
        gap_mm = 2.0 * self._radius_mm + MARGIN_MM
        free = np.ones(len(arms), dtype=bool)
        x, y = self.plane.centres_mm[row].tolist()
        for sweep in sweeps.values():
            if sweep.near(x, y, reach_mm):
                free[free] &= self._gaps(arms[free], sweep.segments_mm).min(axis=1) > gap_mm
        near = np.hypot(*(self.plane.centres_mm - self.plane.centres_mm[row]).T) < 2.0 * reach_mm + 1.0
        others = np.array([i for i in np.flatnonzero(near) if i != row and i not in sweeps], dtype=np.int64)
        if len(others) and free.any():
            bodies = self.arms_mm(others, goals_deg[others])
            free[free] &= self._gaps(arms[free], bodies).min(axis=1) > gap_mm
        if len(self.obstacles) and free.any():
            gaps = self._gaps(arms[free], self.obstacles[:, :4]) - self.obstacles[:, 4]
            free[free] &= gaps.min(axis=1) > self._radius_mm + MARGIN_MM
        return self._places_deg[np.flatnonzero(free)[0]] if free.any() else None


def within_reach(plane: FocalPlane, here_deg: Floats, row: int, any_alpha: Flags | None = None) -> Flags:
    """(N,) whose arms are not proven to be out of where the arm of one may be, whatever its angles.

    The verifier's word, with the whole reach of that arm as an obstacle. `plane`: N positioners; `here_deg`
    (N, 2): where each is; `row`: of the one; `any_alpha` (N,): folded ones of which alpha is not known: such
    an arm may be anywhere in the disc that it sweeps about its own axis.
    """
    reach = np.array([[*plane.centres_mm[row], plane.body_reach_mm[row]]])
    still = replace(plane, offline=np.ones(len(plane), dtype=bool), offline_position_deg=here_deg.copy())
    alone = replace(still, fiducials=reach, guide_cameras=plane.guide_cameras[:0])
    near = np.zeros(len(plane), dtype=bool)
    for contact in verify(alone, _at_rest(plane, here_deg)).contacts:
        near[plane.index_of(contact.positioner_id)] |= contact.other == "fiducial 0"
    if any_alpha is not None:
        ends_mm = plane.beta_segments(*here_deg.T).reshape(-1, 2, 2) - plane.centres_mm[:, None]
        disc_mm = np.hypot(*np.moveaxis(ends_mm, -1, 0)).max(axis=1) + plane.collision_buffer_mm
        apart_mm = np.hypot(*(plane.centres_mm - plane.centres_mm[row]).T)
        near |= any_alpha & (apart_mm < disc_mm + plane.body_reach_mm[row])
    near[row] = False
    return near


def _at_rest(plane: FocalPlane, here_deg: Floats) -> Plan:
    robots = (
        Trajectory(int(p), np.zeros(1), a[:1], a[1:])
        for p, a in zip(plane.positioner_id, here_deg, strict=True)
    )
    return Plan(plane.instrument.name, plane.collision_buffer_mm, tuple(robots))
