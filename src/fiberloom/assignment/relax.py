"""Configurations decided elsewhere, in which arms are nearer than our own buffer."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.assignment.assign import Assignment, AssignSettings, assign
from fiberloom.assignment.placement import silent
from fiberloom.instruments import FocalPlane
from fiberloom.targets import TargetList
from fiberloom.targets.target_list import FREE

STEPS = 4
"""In which the collision buffer gives way; few, since each is a whole assignment."""


def assign_relaxed(
    plane: FocalPlane,
    targets: TargetList,
    *,
    seed: int = 0,
    start_deg: ArrayLike | None = None,
    settings: AssignSettings | None = None,
) -> tuple[FocalPlane, Assignment]:
    """Assign; where targets that demand a positioner do not fit, shrink the collision buffer a little.

    The buffer gives way in steps, by `bodies.collision_shrink_mm` at most (SDSS-V's telescope
    configurations keep 1.92 mm of 2.0 mm), and only as far as it brings more of the demanded
    targets in. Returns the plane with the buffer that holds, for planning and verification.

    `plane`: the positioners; `targets`: in mm; `seed`, `start_deg` (N, 2) and `settings`: as of `assign`.
    """
    settings = settings or AssignSettings()
    quiet = replace(settings, progress=silent)
    best = plane, assign(plane, targets, seed=seed, start_deg=start_deg, settings=settings)
    left = _left_out(best[1], targets)
    bodies = plane.instrument.bodies
    for nearer in relaxed_planes(plane):
        if left == 0:
            break
        buffer_mm = nearer.collision_buffer_mm
        settings.progress(f"with a collision buffer of {buffer_mm:g} mm")
        tried = assign(nearer, targets, seed=seed, start_deg=start_deg, settings=quiet)
        if _left_out(tried, targets) < left:
            best, left = (nearer, tried), _left_out(tried, targets)
            best[1].notes.append(
                f"collision buffer {buffer_mm:g} mm instead of {bodies.collision_buffer_mm:g} mm: "
                "arms of the demanded configuration are so near"
            )
    return best


def relaxed_planes(plane: FocalPlane) -> Iterator[FocalPlane]:
    """The plane with ever smaller buffers, as far as the instrument allows."""
    bodies = plane.instrument.bodies
    steps = STEPS if bodies.collision_shrink_mm > 0.0 else 0
    for step in range(1, steps + 1):
        shrink_mm = bodies.collision_shrink_mm * step / STEPS
        yield plane.with_collision_buffer(bodies.collision_buffer_mm - shrink_mm)


def _left_out(assignment: Assignment, targets: TargetList) -> int:
    """How many targets that demand a positioner did not get it."""
    missing = np.array(list(assignment.unassigned), dtype=np.int64)
    return int((targets.positioner_id[missing] != FREE).sum())
