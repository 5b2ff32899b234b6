"""`fiberloom runs`: the runs of a store, and how they ended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from fiberloom.cli.options import JsonOptions


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

    options.show(runs_below(options.where))
