"""`fiberloom runs`: what was observed, and how it ended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import typer

from fiberloom.cli.options import JsonOptions


@dataclass(frozen=True, kw_only=True)
class RunsOptions(JsonOptions):
    """Of `fiberloom runs`."""

    where: Annotated[str, typer.Argument(help="Store, database URL, or a folder with stores below it.")] = (
        "runs"
    )


def runs(options: RunsOptions) -> None:
    """Show what was observed, and how it ended."""
    from fiberloom.store.find import stores_below

    options.show([row for store in stores_below(options.where) for row in _runs_of(store)])


def _runs_of(path: str) -> list[dict[str, Any]]:
    from fiberloom.store import Store

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
