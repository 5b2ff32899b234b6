"""What the result files are made of and measurements do not hold: layout, targets, assignment, plans, truth.

Written while the run goes on: what was measured can be shown whatever happens to the run.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fiberloom.assignment import Assignment
from fiberloom.instruments import FocalPlane, Instrument
from fiberloom.instruments.axis import Ranges
from fiberloom.instruments.handicaps import Handicaps
from fiberloom.operation.move import Move
from fiberloom.operation.results.fibermap import FibreMap
from fiberloom.operation.results.observed import ObservedField
from fiberloom.planning import Approach, Plan, Trajectory
from fiberloom.planning.trajectories import KEYS
from fiberloom.sky.guiding import FieldOffset
from fiberloom.store import Run
from fiberloom.store.parts import RunPart, pack
from fiberloom.targets import TargetList
from fiberloom.typing import Array

LAYOUT, TARGETS, ASSIGNMENT, ABOUT = "layout", "targets", "assignment", "about"
FIBERMAP = "fibermap"
"""Names of parts of a whole run."""

PLACES = (
    *("metrology_goal_mm", "target_mm", "star_mm", "short_mm"),
    *("true_mm", "true_metrology_mm", "true_image_mm", "true_ends_mm"),
)
"""Where fibres were to be in a move, and what a twin knows of where they were."""

_POINT, _HANDICAP, _RANGE, _DOTS = "point ", "handicap ", "range ", "dots"
_PLANE = ("positioner_id", "hole", "arms", "fiducials", "guide_cameras", "offline", "offline_position_deg")
_LIST = ("target_id", "x_mm", "y_mm", "priority", "fibre", "positioner_id")
_ASSIGNED = ("target", "fibre", "alpha_deg", "beta_deg", "approach_deg", "clearance_mm")


def record_begin(
    run: Run, plane: FocalPlane, targets: TargetList, assignment: Assignment, about: dict[str, Any]
) -> None:
    """Writes what is known before anything moves.

    `run`: of the store; `plane`: layout by which the field is planned; `assignment`: of its positioners to
    `targets`; `about`: entries of summary.json.
    """
    run.record_part(LAYOUT, packed_layout(plane))
    run.record_part(TARGETS, pack({}, _arrays(targets, _LIST)))
    why = {"unassigned": list(assignment.unassigned.items()), "notes": assignment.notes}
    lead = {} if assignment.lead_mm is None else {"lead_mm": assignment.lead_mm}
    run.record_part(ASSIGNMENT, pack(why, _arrays(assignment, _ASSIGNED) | lead))
    run.record_part(ABOUT, pack({"about": about}))


def packed_layout(plane: FocalPlane) -> bytes:
    """A layout as a part; `plane_of` reads it."""
    points = {_POINT + name: xy_mm for name, xy_mm in plane.points.items()}
    handicaps = {} if plane.handicaps is None else plane.handicaps.arrays
    kept = {_HANDICAP + name: values for name, values in handicaps.items()}
    if plane.ranges is not None:
        kept |= {_RANGE + name: values for name, values in plane.ranges.arrays.items()}
    if plane.dots_mm is not None:
        kept |= {_DOTS: plane.dots_mm}
    instrument = {"instrument": plane.instrument.model_dump(mode="json")}
    return pack(instrument, points | kept | _arrays(plane, _PLANE))


def record_end(run: Run, **figures: Any) -> None:
    """Writes what is known when nothing moves any more: `about`, `collisions_verified`, `contacts_true`,
    `stopped`, `wall_s`, and `exposures`, whether there are any.
    """
    run.record_part(ABOUT, pack(figures))


def record_fibermap(run: Run, observed: ObservedField) -> None:
    """Writes where every fibre looked, RA and Dec among it, of a list on the sky whose fibres have moved."""
    if observed.targets.on_sky is None or not observed.moves:
        return
    made = FibreMap.of(observed)
    head = {"meta": dict(made.table.meta), "confsummary": made.confsummary}
    run.record_part(
        FIBERMAP, pack(head, {name: np.asarray(made.table[name]) for name in made.table.colnames})
    )


def fibermap_of(part: RunPart) -> FibreMap:
    """Where every fibre looked, of a part."""
    from astropy.table import Table

    return FibreMap(Table(part.arrays, meta=part.head["meta"]), part.head["confsummary"])


def _arrays(of: object, names: Any) -> dict[str, Array]:
    return {name: getattr(of, name) for name in names}


def plane_of(part: RunPart) -> FocalPlane:
    """The layout of a part."""
    points = {name.removeprefix(_POINT): xy for name, xy in part.arrays.items() if name.startswith(_POINT)}
    kept = {n.removeprefix(_HANDICAP): xy for n, xy in part.arrays.items() if n.startswith(_HANDICAP)}
    ranges = {n.removeprefix(_RANGE): xy for n, xy in part.arrays.items() if n.startswith(_RANGE)}
    return FocalPlane(
        instrument=Instrument.model_validate(part.head["instrument"]),
        points=points,
        handicaps=Handicaps(**kept) if kept else None,
        ranges=Ranges(**ranges) if ranges else None,
        dots_mm=part.arrays.get(_DOTS),
        **{name: part.arrays[name] for name in _PLANE},
    )


def targets_of(part: RunPart) -> TargetList:
    """The target list of a part."""
    arrays: dict[str, Any] = {name: part.arrays[name] for name in _LIST}
    return TargetList(**arrays)


def assignment_of(part: RunPart) -> Assignment:
    """The assignment of a part."""
    unassigned = {int(row): why for row, why in part.head["unassigned"]}
    return Assignment(unassigned=unassigned, notes=part.head["notes"], **part.arrays)


def packed_move(move: Move) -> bytes:
    """What a move has beside its measurements: plan, truth, what the image left open."""
    plan = move.plan
    known = {name: getattr(move, name) for name in PLACES} | {"ambiguous": move.measurement.ambiguous}
    head = {
        "instrument": plan.instrument,
        "collision_buffer_mm": plan.collision_buffer_mm,
        "refused": list(plan.refused.items()),
        "approaches": [[positioner, own.to_dict()] for positioner, own in plan.approaches.items()],
        "cpu_s": plan.cpu_s,
        "interrupted": move.interrupted,
        "comparison": move.comparison,
        "images": move.measurement.images,
    }
    if move.pointed is not None:
        head["pointed"] = [*move.pointed.offset_mm.tolist(), move.pointed.rotation_deg, move.pointed.scale]
    points = {key: np.concatenate([getattr(r, key) for r in plan.robots]) for key in KEYS}
    points["positioner_id"] = np.array([r.positioner_id for r in plan.robots], dtype=np.int64)
    points["n_points"] = np.array([len(r.time_s) for r in plan.robots], dtype=np.int64)
    return pack(head, points | {name: values for name, values in known.items() if values is not None})


def pointed_of(part: RunPart) -> FieldOffset | None:
    """What guide stars have told before a move, of its part."""
    told = part.head.get("pointed")
    return None if told is None else FieldOffset(np.array(told[:2]), told[2], told[3])


def plan_of(part: RunPart) -> Plan:
    """The plan of a move's part."""
    head, arrays = part.head, part.arrays
    ends = np.cumsum(arrays["n_points"])[:-1]
    time_s, alpha, beta = (np.split(arrays[key], ends) for key in KEYS)
    robots = zip(arrays["positioner_id"].tolist(), time_s, alpha, beta, strict=True)
    own = {positioner: Approach.from_dict(told) for positioner, told in head.get("approaches", [])}
    return Plan(
        head["instrument"],
        head["collision_buffer_mm"],
        tuple(Trajectory(i, t, a, b, own.get(i)) for i, t, a, b in robots),
        {int(positioner): why for positioner, why in head["refused"]},
        head["cpu_s"],
    )
