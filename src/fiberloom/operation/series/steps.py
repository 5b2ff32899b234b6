"""A series of exposures on one field: between them the fibres follow their targets.

Each exposure has its fibres placed for its middle. What refraction and rotation have done since is a shift of
some micrometres, a small verified move like a correction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fiberloom.assignment import Assignment
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.operation.move import Move
from fiberloom.operation.series.reach import to_the_end
from fiberloom.sky.drift import drift
from fiberloom.sky.on_sky import OnSky
from fiberloom.targets import TargetList
from fiberloom.typing import Flags, Floats
from fiberloom.units import UM_PER_MM, wrap_deg

MOST_EXPOSURES = 200


@dataclass(frozen=True, eq=False)
class SeriesStep:
    """Where targets are in an exposure, and how near their fibres must come. Arrays over N positioners."""

    label: str
    target_mm: Floats
    """(N, 2) NaN without a target."""
    angles_deg: Floats
    """(N, 2) goals, alpha and beta."""
    short_mm: Floats
    """(N, 2) from the fibres there to the targets that they do not reach; 0 for the others."""
    limit_um: Floats
    """(N,) as measured: what the drift of the exposure leaves of the requirement."""


def check_series(targets: TargetList, exposures: int) -> None:
    """Raises InputError for a number of `exposures` that `targets` cannot be followed through."""
    if not 1 <= exposures <= MOST_EXPOSURES:
        raise InputError(f"exposures = {exposures}: must be 1 to {MOST_EXPOSURES}")
    if exposures > 1 and (targets.on_sky is None or not targets.on_sky.field.exposure_s):
        raise InputError(
            "a series of exposures: needs a list with ra and dec, and a field with exposure_s above 0"
        )


def steps_of(
    plane: FocalPlane, assignment: Assignment, targets: TargetList, exposures: int
) -> list[SeriesStep]:
    """A step for each exposure, the first included; none of a single exposure.

    `plane`: of the `assignment` of N positioners to `targets`; `exposures`: of the whole series.
    """
    sky = targets.on_sky
    if sky is None or exposures < 2:
        return []
    first_mm = sky.places_mm(assignment.target, assignment.fibre)
    steps = []
    for number in range(exposures):
        after_s = number * sky.field.cadence_s
        there_mm = sky.places_mm(assignment.target, assignment.fibre, after_s)
        angles_deg = followed(plane, assignment, there_mm - first_mm)
        limit_um = _limit_um(plane, assignment, sky, after_s)
        reached = to_the_end(plane, assignment, there_mm - first_mm, angles_deg)
        aim = reached.angles_deg, reached.short_mm
        steps.append(SeriesStep(f"re-position {number}", there_mm, *aim, limit_um))
    return steps


def _limit_um(plane: FocalPlane, assignment: Assignment, sky: OnSky, after_s: float) -> Floats:
    """(N,) um: the requirement less drift and twice the noise of the camera, but a third of it at least."""
    has = assignment.target >= 0
    drift_um = np.zeros(plane.n)
    asked = sky.asked(assignment.target, assignment.fibre)
    drift_um[has] = drift(sky.then(after_s), asked, sky.field.exposure_s).guided_um
    requirement_um = plane.instrument.operation.requirement_um
    left_um = requirement_um - drift_um - 2.0 * plane.instrument.metrology.noise_rms_um
    return np.maximum(left_um, requirement_um / 3.0)


def followed(plane: FocalPlane, assignment: Assignment, shift_mm: Floats) -> Floats:
    """Goals whose fibres are shifted: (N, 2) deg; as before where that is out of reach.

    `plane`: of the `assignment` of N positioners; `shift_mm`: (N, 2) mm.
    """
    goal_deg = assignment.goal_deg.copy()
    for fibre in np.unique(assignment.fibre[assignment.target >= 0]).tolist():
        rows = np.flatnonzero((assignment.target >= 0) & (assignment.fibre == fibre))
        before_deg = goal_deg[rows]
        xy_mm = plane.forward(before_deg[:, 0], before_deg[:, 1], fibre, index=rows) + shift_mm[rows]
        found = plane.inverse(xy_mm, fibre, rows, near_deg=before_deg)
        turned_deg = wrap_deg(np.column_stack([found.alpha_deg, found.beta_deg]) - before_deg)
        goal_deg[rows] += np.where(found.reachable[:, None], turned_deg, 0.0)
    return goal_deg


def series_about(
    sky: OnSky, assignment: Assignment, placed: Sequence[Move], first_mm: Floats, counted: Flags
) -> list[dict[str, Any]]:
    """How near the fibres were to their targets in each exposure, with guiding; and had they stayed.

    `sky`: of the list; `assignment`: of N positioners; `placed`: the move after which each exposure began;
    `first_mm` (N, 2): targets of the first exposure; `counted` (N,): healthy positioners with a target.
    """
    off_mm = [_off_mm(move, first_mm) for move in placed]
    rows = []
    for number in range(len(placed)):
        followed = _worst_um(sky, assignment, off_mm[number], number, number)
        stayed = _worst_um(sky, assignment, off_mm[0], 0, number)
        drifts = [
            _worst_um(sky, assignment, np.zeros_like(first_mm), reference, number)
            for reference in (number, 0)
        ]
        worst = [float(np.nanmax(x[counted], initial=0.0)) for x in (followed, stayed, *drifts)]
        names = ("worst_um", "worst_unless_moved_um", "drift_um", "drift_unless_moved_um")
        begin_s = number * sky.field.cadence_s
        about = {"exposure": number + 1, "begin_s": begin_s, "end_s": begin_s + sky.field.exposure_s}
        rows.append(
            about | dict(zip(names, worst, strict=True)) | _reached(placed[number], followed, counted)
        )
    return rows


def _reached(move: Move, worst_um: Floats, counted: Flags) -> dict[str, Any]:
    """Of those that reach their targets, where some do not any more."""
    if move.short_mm is None:
        return {}
    short = counted & (move.short_mm != 0.0).any(axis=1)
    in_reach_um = float(np.nanmax(worst_um[counted & ~short], initial=0.0))
    return {"out_of_reach": int(short.sum()), "worst_in_reach_um": in_reach_um} if short.any() else {}


def _off_mm(move: Move, first_mm: Floats) -> Floats:
    """(N, 2) by which fibres are beside their targets: in truth of a twin, else as measured."""
    if move.true_mm is not None:
        star_mm = move.target_mm if move.star_mm is None else move.star_mm
        return move.true_mm - (first_mm if star_mm is None else star_mm)
    if move.metrology_goal_mm is None:
        return np.full_like(first_mm, np.nan)
    return np.where(move.measurement.seen[:, None], move.measurement.xy_mm - move.metrology_goal_mm, np.nan)


def _worst_um(sky: OnSky, assignment: Assignment, off_mm: Floats, reference: int, number: int) -> Floats:
    """(N,) um between fibres placed for exposure `reference` and guided stars in exposure `number`."""
    target, fibre, field = assignment.target, assignment.fibre, sky.field
    at_s, middle_s = reference * field.cadence_s, number * field.cadence_s
    fibres_mm = sky.places_mm(target, fibre, at_s) + off_mm
    times_s = [middle_s + part * field.exposure_s for part in (-0.5, 0.0, 0.5)]
    stars_mm = np.array([sky.guided_mm(target, fibre, at_s, then) for then in times_s])
    worst: Floats = UM_PER_MM * np.hypot(*np.moveaxis(fibres_mm - stars_mm, -1, 0)).max(axis=0)
    return worst
