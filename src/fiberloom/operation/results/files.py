"""The files of an observation: summary.json, fibres.ecsv, trajectories.json, figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fiberloom.health.status import FAULTS, FibreFlag, FibreStatus, grade
from fiberloom.operation.move import Move
from fiberloom.report.focal_plane import FieldPicture, errors_title, plot_errors, plot_focal_plane
from fiberloom.tables import write_columns
from fiberloom.timing import part
from fiberloom.typing import Array, Floats, Ints
from fiberloom.wholefile import write_whole

if TYPE_CHECKING:
    from fiberloom.operation.results.observed import ObservedField

MARKS = ("version", "seed", "instrument", "config_hash", "utc")
"""Entries that every result file has."""

_OF_STATUS = {
    status: int(FibreFlag[status.name]) for status in FibreStatus if status.name in FibreFlag.__members__
}


def fibres_columns(observed: ObservedField) -> dict[str, Array]:
    """One row for every positioner and move, with the columns of docs/files.md."""
    moves = [_fibres_of(observed, move) for move in observed.moves]
    return {name: np.concatenate([move[name] for move in moves]) for name in moves[0]}


def _fibres_of(observed: ObservedField, move: Move) -> dict[str, Array]:
    plane, assignment = observed.plane, observed.assignment
    target, goal = observed.target_mm(move), observed.metrology_goal_mm(move)
    names = np.append(observed.targets.target_id, "")  # index -1: no target
    nothing = np.full((len(plane), 2), np.nan)
    true, true_um = move.true_mm, observed.true_error_um(move)
    seen = move.measurement.seen
    return {
        "positioner_id": plane.positioner_id,
        "fibre": assignment.fibre,
        "target_id": names[assignment.target],
        "move": np.full(len(plane), move.number),
        **_pair("target", target),
        "alpha_deg": assignment.alpha_deg,
        "beta_deg": assignment.beta_deg,
        **_pair("metrology_goal", goal),
        **_pair("measured", np.where(seen[:, None], move.measurement.xy_mm, np.nan)),
        **_pair("true", nothing if true is None else true),
        **(_pair("star", observed.star_mm(move)) if _has_stars(observed) else {}),
        "measured_error_um": move.measured_error_um,
        "true_error_um": nothing[:, 0] if true_um is None else true_um,
        "error_um": observed.error_um(move),
        "status": np.array([status.value for status in move.status]),
        "grade": _grades(observed, move),
        "flags": flags_of(observed, move),
    }


def _has_stars(observed: ObservedField) -> bool:
    """Whether a twin knows its stars to be elsewhere than they are taken to be."""
    return any(move.star_mm is not None for move in observed.moves)


def _pair(name: str, xy_mm: Floats) -> dict[str, Floats]:
    return {f"x_{name}_mm": xy_mm[:, 0], f"y_{name}_mm": xy_mm[:, 1]}


def _grades(observed: ObservedField, move: Move) -> NDArray[np.str_]:
    has = (observed.assignment.target >= 0).tolist()
    errors = observed.error_um(move).tolist()
    return np.array([grade(e, observed.requirement_um, h) for e, h in zip(errors, has, strict=True)])


def flags_of(observed: ObservedField, move: Move) -> Ints:
    """(N,) bits of `FibreFlag`."""
    flags = np.array([_OF_STATUS.get(status, 0) for status in move.status], dtype=np.int64)
    ambiguous = move.measurement.ambiguous
    for flag, where in (
        (FibreFlag.NO_TARGET, observed.assignment.target < 0),
        (FibreFlag.NOT_SEEN, ~move.measurement.seen),
        (FibreFlag.AMBIGUOUS, np.zeros(len(flags), dtype=bool) if ambiguous is None else ambiguous),
        (FibreFlag.OFF_TARGET, observed.error_um(move) > observed.requirement_um),
        (FibreFlag.INTERRUPTED, np.full(len(flags), move.interrupted)),
        (FibreFlag.COMPARISON, np.full(len(flags), move.comparison)),
    ):
        flags |= np.where(where, int(flag), 0)
    return flags


@part("files")
def write_results(observed: ObservedField, summary: Mapping[str, Any], out: Path) -> None:
    """Writes every result file into the folder `out`, which exists."""
    marks = {k: summary[k] for k in MARKS}
    flags = {flag.name: int(flag) for flag in FibreFlag}
    write_columns(out / "fibres.ecsv", fibres_columns(observed), marks | {"flags": flags})
    plans = {"plans": [move.plan.to_dict() for move in observed.moves]} | marks
    write_whole(out / "trajectories.json", json.dumps(plans) + "\n")
    _plot(observed, out)
    # last: where it is, all are
    write_whole(out / "summary.json", json.dumps(summary, indent=2) + "\n")


def _plot(observed: ObservedField, out: Path) -> None:
    plot_focal_plane(out / "focal_plane.png", observed.plane, picture(observed))
    ended = [move for move in observed.moves if not move.interrupted]
    errors = [observed.error_um(m)[observed.counted(m)] for m in ended]
    own = [error for error, m in zip(errors, ended, strict=True) if not m.comparison]
    plot_errors(
        out / "errors.png",
        errors,
        [f"move {m.number} ({m.label})" for m in ended],
        observed.requirement_um,
        errors_title(own, observed.assignment.n_assigned, observed.requirement_um),
    )


def picture(observed: ObservedField) -> FieldPicture:
    """Of `observed`: errors in um by colour."""
    final = observed.final
    error = observed.error_um(final)
    counted = observed.counted(final)
    flagged = np.array([s in FAULTS or s is FibreStatus.BLOCKED for s in final.status])
    within = int(observed.on_target(final).sum())
    title = (
        f"{within} of {observed.assignment.n_assigned} assigned fibres within {observed.requirement_um:g} µm "
        f"after move {final.number}"
        + (f"; {int(flagged.sum())} positioners flagged" if flagged.any() else "")
    )
    return FieldPicture(
        final.commanded_deg, np.where(counted, error, np.nan), flagged, observed.requirement_um, title
    )
