"""`fiberloom status`: state and owner of an array, exclusions, last places. Asks the store, not the bus."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from fiberloom.cli.array.options import BusOptions, store_place
from fiberloom.cli.options import JsonOptions


@dataclass(frozen=True, kw_only=True)
class StatusOptions(BusOptions, JsonOptions):
    """Of `fiberloom status`."""

    places: Annotated[bool, typer.Option("--places", help="The last place of every positioner too.")] = False


def status(options: StatusOptions) -> None:
    """Show the state of an array: which process owns it, exclusions, where positioners were last."""
    from fiberloom.connect import array_address
    from fiberloom.operation.session.status import StatusReport
    from fiberloom.store import Store
    from fiberloom.store.arrays import ArrayBook, arrays_of

    with Store.open(store_place(options.store)) as store:
        named = None if options.bus is None else array_address(options.bus)
        addresses = arrays_of(store) if named is None else [named]
        reports = [StatusReport.of(ArrayBook(store, a), options.places) for a in addresses]
    if options.as_json:
        options.print_json([report.as_dict() for report in reports])
        return
    if not reports:
        typer.echo("no array is on record; `fiberloom park --bus ... --camera ...` begins one")
    for report in reports:
        for table in report.tables():
            options.show(table)
