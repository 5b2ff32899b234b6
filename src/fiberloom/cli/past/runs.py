"""`fiberloom runs`: the runs of a store, and how they ended."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from fiberloom.cli.options import JsonOptions
from fiberloom.store.place import BESIDE


@dataclass(frozen=True, kw_only=True)
class RunsOptions(JsonOptions):
    """Of `fiberloom runs`."""

    where: Annotated[str, typer.Argument(help="Store, database URL, or a folder with stores below it.")] = (
        "runs"
    )


def runs(options: RunsOptions) -> None:
    """List past runs, and how they ended."""
    from fiberloom.store.find import stores_below

    stores_below(options.where)
    from fiberloom.store.listing import runs_below

    rows = runs_below(options.where)
    if options.as_json:
        options.print_json(rows)
    else:
        _print(rows, options.where)


def _print(rows: list[dict[str, Any]], where: str) -> None:
    """What tells runs apart, within 80 columns: where they are kept comes last and may take a second line."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE, padding=(0, 1, 0, 0))
    for name in ("run", "begun (UTC)", "status", "moves", "seed", "instrument"):
        table.add_column(name, no_wrap=True, justify="right" if name in ("run", "moves", "seed") else "left")
    table.add_column("kept in", overflow="fold")
    for row in rows:
        told = [_place(row, where), row["calibrations"], row["note"]]
        cells = [row["run"], row["utc"][:19].replace("T", " "), row["status"], row["moves"], row["seed"]]
        table.add_row(*map(str, cells), row["instrument"], "; ".join(filter(None, told)))
    Console().print(table)


def _place(row: dict[str, Any], where: str) -> str:
    """The folder of a run that has its own, else its store."""
    from fiberloom.store.listing import shortened

    store = Path(row["store"])
    own = row["folder"] not in (None, BESIDE) and "://" not in row["store"]
    return shortened(str(store.with_name(row["folder"]) if own else store), where)
