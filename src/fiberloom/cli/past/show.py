"""`fiberloom show`: an observation of the past, and its result files made anew from the store."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fiberloom.cli.options import JsonOptions

if TYPE_CHECKING:
    from fiberloom.operation.past.rebuild import Rebuilt


@dataclass(frozen=True, kw_only=True)
class ShowOptions(JsonOptions):
    """Of `fiberloom show`."""

    run: Annotated[int, typer.Argument(min=1, help="Number of the run, as `fiberloom runs` lists it.")]
    where: Annotated[
        str, typer.Argument(help="Store, database URL, or a folder with the store in it or below it.")
    ] = "runs"
    night: Annotated[bool, typer.Option("--night", help="The number is that of a night, not of a run.")] = (
        False
    )
    out: Annotated[
        Path | None, typer.Option(help="Folder for the files; default: that of the run itself.")
    ] = None


def show(options: ShowOptions) -> None:
    """Show an observation or a night of the past, and make its result files anew from the store.

    What cannot be made, and why, is told: images and their pages are not in the store.
    """
    from fiberloom.store.find import stores_below

    stores_below(options.where)
    if options.night:
        from fiberloom.cli.night import show_night

        show_night(options.run, options.where, options.out, options.as_json)
        return
    from fiberloom.operation.past.rebuild import rebuild
    from fiberloom.store import Store
    from fiberloom.store.listing import store_with

    with Store.read(store_with(options.run, options.where)) as store:
        made = rebuild(store, options.run, options.out)
    if options.as_json:
        report = {"status": made.run.status, "folder": str(made.folder), "not_rebuilt": made.left_out}
        report |= {"where_fibres_looked": made.where_fibres_looked}
        options.print_json(made.summary | report)
    else:
        _print(made)


def _print(made: Rebuilt) -> None:
    from rich.console import Console

    from fiberloom.cli.observe import print_observation, say

    console = Console()
    run = made.run
    console.print(f"run {run.id}, {run.status}, begun {run.utc_start:%Y-%m-%d %H:%M:%S} UTC")
    say(console, f"`{run.command_line}`" + (f"; {run.note}" if run.note else ""))
    print_observation(made.summary | {"folder": str(made.folder)})
    if made.where_fibres_looked:
        say(console, made.where_fibres_looked)
    for name, why in made.left_out.items():
        say(console, f"not made: {name} ({why})")
