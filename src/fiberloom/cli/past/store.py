"""`fiberloom store`: stores brought up to date, checked, copied."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from fiberloom.cli.options import JsonOptions

StoreArgument = Annotated[str, typer.Argument(help="Store: file, or database URL.")]


@dataclass(frozen=True, kw_only=True)
class StoreOptions(JsonOptions):
    """Of `fiberloom store upgrade` and `check`."""

    where: StoreArgument


@dataclass(frozen=True, kw_only=True)
class StoreCopyOptions(StoreOptions):
    """Of `fiberloom store copy`."""

    to: Annotated[str, typer.Argument(help="New store: file, or database URL.")]


def upgrade(options: StoreOptions) -> None:
    """Bring the tables of an older store up to date; a copy of a file is kept beside it."""
    from fiberloom.store.schema import SCHEMA_VERSION
    from fiberloom.store.upkeep.upgrade import upgrade as upgraded

    found, kept = upgraded(options.where)
    options.show(
        {
            "store": options.where,
            "version": SCHEMA_VERSION,
            "version_before": found,
            "copy": None if kept is None else str(kept),
        }
    )


def check(options: StoreOptions) -> int:
    """Compare every row of a store with its sum; exit code 1 where something is wrong."""
    from fiberloom.store import Store
    from fiberloom.store.upkeep.check import check_store

    with Store.read(options.where) as store:
        found = check_store(store)
    options.show(
        {
            "store": options.where,
            "version": found.version,
            "rows": sum(found.rows.values()),
            "rows_without_sum": found.without_sum,
            "faults": found.faults,
        }
    )
    return 0 if found.ok else 1


def copy(options: StoreCopyOptions) -> None:
    """Copy all rows of a store into a new one: a file into a database, or back."""
    from fiberloom.store import Store
    from fiberloom.store.upkeep.copy import copy_store

    with Store.read(options.where) as source, Store.open(options.to) as target:
        copied = copy_store(source, target)
    options.show({"from": options.where, "to": options.to, "rows": sum(copied.values())})
