"""Goals made so that approaches touch, for the tests of what the planner does about it."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from fiberloom._core import planning as core
from fiberloom.instruments import FocalPlane, generate, load_instrument
from fiberloom.planning import Plan, Trajectory
from fiberloom.planning.obstacles import plain_parts

SDSSV = load_instrument("sdssv")
USUAL_DEG = 0.82
LEAST_DEG = 1.2 * 0.244
"""The largest backlash of SDSS-V and a fifth."""
RADIUS_MM = 2.0


@cache
def bare(n: int) -> FocalPlane:
    """The n innermost positioners, and nothing else."""
    plane = generate(SDSSV, 0, n_positioners=n)
    return replace(plane, fiducials=np.zeros((0, 3)), guide_cameras=np.zeros((0, 5)))


def apart(plane: FocalPlane, goals_deg: np.ndarray, approach_deg: float, radius_mm: float = RADIUS_MM):
    """For goals (n, 2, 2) of the first two positioners, whether they stay apart on such an approach."""
    goals = np.radians(goals_deg)
    parts = plain_parts(plane.n, plane.beta_segment_mm, radius_mm)
    bodies = core.Bodies(plane.arms, parts, np.zeros((0, 7)))
    rows = [np.full(len(goals), k) for k in (0, 1)]
    first, second = (np.ascontiguousarray(goals[:, k]) for k in (0, 1))
    return core.pairs_clear(bodies, rows[0], first, rows[1], second, np.radians(approach_deg))


@cache
def facing(seed: int, n: int = 60_000) -> np.ndarray:
    """(k, 2, 2) goals of two neighbours that do not touch at rest, by 10 um, but on the usual approach."""
    rng = np.random.default_rng(seed)
    goals = np.stack([rng.uniform(0, 360, (n, 2)), rng.uniform(0, 180, (n, 2))], axis=-1)
    plane = bare(2)
    return goals[apart(plane, goals, 0.0, RADIUS_MM + 0.005) & ~apart(plane, goals, USUAL_DEG)]


def last_falls(made: Plan) -> Iterator[tuple[Trajectory, int, float]]:
    """(trajectory, axis, height in deg) of the last fall of each axis of each positioner that moves, by its
    points alone: from where it has risen last to where it ends."""
    for robot in made.robots:
        for axis in (0, 1) if robot.moves else ():
            angles = robot.points_deg[:, axis]
            rises = np.flatnonzero(np.diff(angles) > 0.0)
            top = angles[rises[-1] + 1] if len(rises) else angles[0]
            yield robot, axis, top - angles[-1]
