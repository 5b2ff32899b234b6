"""The result files of a run made anew from its store."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.health.status import FibreStatus
from fiberloom.metrology import Measurement
from fiberloom.operation.exposures import FOLDER
from fiberloom.operation.move import Move
from fiberloom.operation.past.parts import (
    ABOUT,
    ASSIGNMENT,
    FIBERMAP,
    LAYOUT,
    PLACES,
    TARGETS,
    assignment_of,
    fibermap_of,
    plan_of,
    plane_of,
    pointed_of,
    targets_of,
)
from fiberloom.operation.results import Observation
from fiberloom.operation.results.fibermap import FIBERMAP as FITS
from fiberloom.report.folder import prepare_folder, set_aside
from fiberloom.store import RunInfo, Store
from fiberloom.store.database import Columns
from fiberloom.store.parts import RunPart
from fiberloom.store.place import BESIDE
from fiberloom.store.run import FINISHED

NO_DIRECTIONS = "the run did not come to its end, or is of a version that did not keep where fibres looked"
NO_IMAGES = "they are made of camera images, which the store does not keep"


@dataclass(frozen=True)
class Rebuilt:
    """What was made of a run in a store."""

    run: RunInfo
    folder: Path
    summary: dict[str, Any]
    left_out: dict[str, str] = field(default_factory=dict)
    """What could not be made, and why."""
    where_fibres_looked: str = ""
    """In which files RA and Dec under each fibre are; empty: a list in mm."""


def rebuild(store: Store, run_id: int, out: Path | None = None) -> Rebuilt:
    """Writes the result files of a run.

    Parameters
    ----------
    store : Store
        That the run is in.
    run_id : int
        Its number.
    out : Path, optional
        Folder for the files; that of the run when left out. Results of another run that are there are
        moved into `run-N` below it.

    Returns
    -------
    Rebuilt
        The folder, the summary, and what could not be made.

    Raises
    ------
    InputError
        No such run, one that is no observation or made no move, one of a version that kept too little, or
        a folder that cannot be written.
    """
    info = info_of_run(store, run_id)
    seen, exposures = observation_of(store, info)
    folder = prepare_folder(own_folder(store, info) if out is None else out)
    if not _is_of(folder / "summary.json", seen.about, missing=out is None):
        set_aside(folder, run_id)
    seen.save(folder)
    left_out = {f"{FOLDER}/": NO_IMAGES + _where(store, info)} if exposures else {}
    if (folder / FOLDER).exists():
        left_out = {}
    looked = _write_where(store, run_id, folder)
    if not looked and "sky" in seen.about:
        left_out[FITS] = NO_DIRECTIONS
    return Rebuilt(info, folder, seen.summary(), left_out, looked)


def _write_where(store: Store, run_id: int, folder: Path) -> str:
    """Writes where every fibre looked; in which files, in words."""
    part = store.parts(run_id)[0].get(FIBERMAP)
    if part is None:
        return ""
    found = fibermap_of(part)
    files = " and ".join(found.write(folder))
    n = int(np.isfinite(np.asarray(found.table["FIBRE_RA"])).sum())
    return f"RA and Dec under {n} fibres, ICRS at {found.table.meta['MIDUTC']} UTC: {files}"


def _where(store: Store, info: RunInfo) -> str:
    """Where the images of the run itself are, if they are there."""
    if "://" in store.name or not (images := own_folder(store, info) / FOLDER).exists():
        return ""
    return f"; those of the run are in {images}"


def info_of_run(store: Store, run_id: int) -> RunInfo:
    """A run by its number; InputError where the store has none."""
    for info in store.runs():
        if info.id == run_id:
            return info
    raise InputError(f"{store.name}: no run {run_id}; 'fiberloom runs' lists them")


def own_folder(store: Store, info: RunInfo) -> Path:
    """Where a run has written its files, or would have. InputError where its store is no file."""
    if "://" in store.name:
        raise InputError(f"{store.name}: is no file, and has no folder; name one with --out")
    base = Path(store.name).parent / (info.folder or BESIDE)
    aside = base / f"run-{info.id}"
    if (info.folder or BESIDE) != BESIDE:
        return base
    newest = info.id == max(run.id for run in store.runs())
    return base if newest and not aside.exists() else aside


def _is_of(summary: Path, about: Mapping[str, Any], *, missing: bool) -> bool:
    """Is a summary that of the same run? `missing`: the answer where there is none."""
    if not summary.exists():
        return missing
    try:
        found = json.loads(summary.read_text(encoding="utf-8"))
        return all(found[key] == about[key] for key in ("run", "utc", "config_hash"))
    except (OSError, ValueError, KeyError, TypeError):
        return False


def observation_of(store: Store, info: RunInfo) -> tuple[Observation, bool]:
    """The observation of a run, as far as it came, and whether it may have kept exposures."""
    parts, moved = store.parts(info.id)
    _require(store, info, parts)
    plane, about = plane_of(parts[LAYOUT]), parts[ABOUT].head
    if plane.config_hash() != info.config_hash:
        raise InputError(
            f"{store.name}: the layout of run {info.id}, of version {info.version}, is not read as it was "
            "written; show it with that version"
        )
    observation = Observation(
        plane,
        targets_of(parts[TARGETS]),
        assignment_of(parts[ASSIGNMENT]),
        _moves(store, info, moved),
        collisions_verified=about.get("collisions_verified", 0),
        contacts_true=about.get("contacts_true"),
        stopped=about.get("stopped", f"the run was {info.status}"),
        about=about["about"],
        wall_s=about.get("wall_s", 0.0),
    )
    if not observation.moves:
        raise InputError(f"{store.name}: run {info.id} ({info.status}) made no move: it has no results")
    return observation, about.get("exposures", info.status != FINISHED)


def _require(store: Store, info: RunInfo, parts: Mapping[str, RunPart]) -> None:
    if {LAYOUT, TARGETS, ASSIGNMENT, ABOUT} <= set(parts):
        return
    if info.folder is None:
        raise InputError(
            f"{store.name}: run {info.id} was recorded by version {info.version}, which did not keep layout, "
            "assignment and trajectories: its files cannot be made from the store"
        )
    raise InputError(
        f"{store.name}: run {info.id} is no observation ({info.command_line}): only the files of "
        "`fiberloom observe` are made from the store"
    )


def _moves(store: Store, info: RunInfo, moved: Mapping[int, RunPart]) -> list[Move]:
    table, columns = store.moves(info.id), store.measurements(info.id)
    rows = {int(number): row for row, number in enumerate(table["id"])}
    return [
        _move(part, {k: v[rows[move]] for k, v in table.items()}, _of_move(columns, move))
        for move, part in sorted(moved.items())
    ]


def _of_move(columns: Columns, move: int) -> Columns:
    mine = columns["move_id"] == move
    return {name: column[mine] for name, column in columns.items()}


def _move(part: RunPart, row: Mapping[str, Any], measured: Columns) -> Move:
    image = Measurement(
        measured["x_mm"],
        measured["y_mm"],
        measured["seen"].astype(bool),
        float(row["time_s"]),
        ambiguous=part.arrays.get("ambiguous"),
        images=part.head.get("images", 1),
    )
    return Move(
        number=int(row["number"]),
        label=str(row["kind"]),
        plan=plan_of(part),
        commanded_deg=np.column_stack([measured["alpha_deg"], measured["beta_deg"]]),
        wire_deg=np.column_stack([measured["wire_alpha_deg"], measured["wire_beta_deg"]]),
        measurement=image,
        measured_error_um=measured["error_um"],
        **{name: part.arrays.get(name) for name in PLACES},
        pointed=pointed_of(part),
        status=[FibreStatus(status) for status in measured["status"].tolist()],
        interrupted=part.head["interrupted"],
        comparison=part.head["comparison"],
    )
