"""What stores hold, run by run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fiberloom.store.database import Store
from fiberloom.store.find import stores_below

USUAL = "store.sqlite"
"""Name of a store that needs not be told."""


def runs_below(where: str) -> list[dict[str, Any]]:
    """One row for each run of a store, or of all stores below a folder, as `fiberloom runs` shows it."""
    return [row for store in stores_below(where) for row in _runs_of(store)]


def shortened(store: str, where: str) -> str:
    """The path of a store below `where`, without what all have in common: the way there, the usual name."""
    path, folder = Path(store), Path(where)
    if path == folder or not path.is_relative_to(folder):
        return store
    below = path.relative_to(folder)
    return str(below.parent if below.name == USUAL and below.parent != Path() else below)


def _runs_of(path: str) -> list[dict[str, Any]]:
    with Store.open(path, create=False) as store:
        return [
            {
                "store": path,
                "run": run.id,
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
