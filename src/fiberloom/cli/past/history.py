"""`fiberloom history`: one positioner over runs and nights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import typer

from fiberloom.cli.options import JsonOptions
from fiberloom.errors import InputError


@dataclass(frozen=True, kw_only=True)
class PositionerHistoryOptions(JsonOptions):
    """Of `fiberloom history`."""

    positioner: Annotated[int, typer.Argument(min=0, help="Number of the positioner.")]
    where: Annotated[
        str, typer.Argument(help="Store, database URL, or a folder with the stores in it or below it.")
    ] = "runs"
    most: Annotated[int, typer.Option(min=1, max=100_000, help="Of each kind, from each store.")] = 50


def history(options: PositionerHistoryOptions) -> None:
    """Tell what is on record of one positioner: measurements, events, exclusions, alarms."""
    from fiberloom.store import Store
    from fiberloom.store.find import stores_below
    from fiberloom.store.service.history import nights_of, positioner_history

    found: list[dict[str, Any]] = []
    for place in stores_below(options.where):
        with Store.read(str(place)) as store:
            told = positioner_history(store, options.positioner, options.most)
        if any(told.values()):
            found.append({"store": str(place), **told, "nights": nights_of(told["measurements"])})
    if not found:
        raise InputError(f"positioner {options.positioner}: nothing on record in {options.where}")
    if options.as_json:
        options.print_json({"positioner_id": options.positioner, "stores": found})
        return
    for one in found:
        _print(options.positioner, one)


TABLES: dict[str, tuple[str, ...]] = {
    "nights": ("night", "targets", "median_um", "worst_um"),
    "measurements": ("utc", "night", "field", "run", "move", "kind", "target_id", "error_um", "status"),
    "events": ("utc", "run", "kind", "text"),
    "exclusions": ("since", "until", "who", "why", "cleared", "cleared_by"),
    "alarms": ("since", "night_id", "severity", "code", "text", "count", "gone", "acknowledged_by"),
}
"""What is printed of each kind."""


def _print(positioner: int, told: dict[str, Any]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console()
    console.print(f"positioner {positioner} in {told['store']}", markup=False, soft_wrap=True)
    for kind, columns in TABLES.items():
        if not told[kind]:
            continue
        table = Table(box=box.SIMPLE, title=kind, title_justify="left", padding=(0, 1, 0, 0))
        for name in columns:
            table.add_column(name.replace("_um", ", um").replace("_id", ""), overflow="fold")
        for row in told[kind]:
            table.add_row(*(_cell(row[name]) for name in columns))
        console.print(table)


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.2f}"
    text = str(value)
    return text[:19].replace("T", " ") if len(text) > 19 and text[10] == "T" and text[:4].isdigit() else text
