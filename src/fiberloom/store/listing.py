"""What stores hold, run by run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fiberloom.errors import InputError
from fiberloom.store.database import Store
from fiberloom.store.find import stores_below
from fiberloom.store.place import STORE


def runs_below(where: str) -> list[dict[str, Any]]:
    """One row for each run of a store, or of all stores below a folder, as `fiberloom runs` shows it."""
    return [row for store in stores_below(where) for row in _runs_of(store)]


def shortened(store: str, where: str) -> str:
    """The path of a store below `where`, without what all have in common: the way there, the usual name."""
    path, folder = Path(store), Path(where)
    if path == folder or not path.is_relative_to(folder):
        return store
    below = path.relative_to(folder)
    return str(below.parent if below.name == STORE and below.parent != Path() else below)


def store_with(run: int, where: str) -> str:
    """The store that a run is in: the one that is named, that of a folder, or the only one below it.

    Raises InputError where none below `where` has a run of this number, or several have.
    """
    beside = Path(where) / STORE
    if "://" not in where and beside.is_file() and _has(str(beside), run):
        return str(beside)
    found = [store for store in stores_below(where) if _has(store, run)]
    if not found:
        raise InputError(f"{where}: no run {run}; `fiberloom runs {where}` lists them")
    if len(found) > 1:
        raise InputError(
            f"{where}: run {run} is in {len(found)} stores; name one of them: {', '.join(found[:5])}"
            + (", ..." if len(found) > 5 else "")
        )
    return found[0]


def _has(path: str, run: int) -> bool:
    with Store.read(path) as store:
        return any(info.id == run for info in store.runs())


def _runs_of(path: str) -> list[dict[str, Any]]:
    with Store.read(path) as store:
        return [
            {
                "store": path,
                "run": run.id,
                "folder": run.folder,
                "utc": run.utc_start.isoformat(timespec="seconds"),
                "status": run.status,
                "moves": run.n_moves,
                "measurements": run.n_measurements,
                "calibrations": ", ".join(f"{k} {n}" for k, n in store.calibrated(run.id).items()),
                "seed": run.seed,
                "instrument": run.instrument,
                "note": run.note,
            }
            for run in store.runs()
        ]
