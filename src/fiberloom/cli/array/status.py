"""`fiberloom status`: state and owner of an array, exclusions, last places. Asks the store, not the bus."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fiberloom.cli.array.options import BusOptions, store_place
from fiberloom.cli.options import JsonOptions

if TYPE_CHECKING:
    from fiberloom.operation.session.status import StatusReport


@dataclass(frozen=True, kw_only=True)
class StatusOptions(BusOptions, JsonOptions):
    """Of `fiberloom status`."""

    places: Annotated[bool, typer.Option("--places", help="The last place of every positioner too.")] = False


def status(options: StatusOptions) -> None:
    """Show the state of an array: which process owns it, exclusions, where positioners were last."""
    place = store_place(options.store)
    reports = _reports(options, place)
    if options.as_json:
        options.print_json([report.as_dict() for report in reports])
        return
    if not reports:
        typer.echo(f"no array is on record in {place}; `fiberloom park --bus ... --camera ...` begins one")
    for report in reports:
        for table in report.tables():
            options.show(table)


def _reports(options: StatusOptions, place: str) -> list[StatusReport]:
    """Of the array that is named, else of all on record. Nothing is written, and no store is made."""
    from fiberloom.connect import array_address
    from fiberloom.operation.session.status import StatusReport
    from fiberloom.store import Store
    from fiberloom.store.arrays import ArrayBook, arrays_of

    named = None if options.bus is None else array_address(options.bus)
    if "://" not in place and not Path(place).exists():
        return []
    with Store.read(place) as store:
        addresses = arrays_of(store) if named is None else [named]
        return [StatusReport.of(ArrayBook(store, a), options.places) for a in addresses]
