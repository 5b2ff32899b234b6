"""`fiberloom calibrate history` and `undo`: what operation has taught, shown and undone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from fiberloom.cli.options import JsonOptions


@dataclass(frozen=True, kw_only=True)
class HistoryOptions(JsonOptions):
    """Of `calibrate history`."""

    learnt: Annotated[str, typer.Argument(help="Store with what was learnt, as `observe --adapt` names it.")]
    positioner: Annotated[int | None, typer.Option(help="Only the generations that changed this one.")] = None


def history(options: HistoryOptions) -> None:
    """Show what operation has taught the maps, generation by generation."""
    from fiberloom.store.find import existing

    existing(options.learnt)
    from fiberloom.store.generations import learnt_generations

    rows = learnt_generations(options.learnt, options.positioner)
    if not options.as_json:  # the others do not fit a terminal's width
        rows = [{k: v for k, v in row.items() if k not in ("calibration", "seed")} for row in rows]
    options.show(rows)


@dataclass(frozen=True, kw_only=True)
class UndoOptions(JsonOptions):
    """Of `calibrate undo`."""

    learnt: Annotated[str, typer.Argument(help="Store with what was learnt.")]
    to: Annotated[int, typer.Option(min=0, help="Generation to go back to; 0: the calibration itself.")]
    positioner: Annotated[
        list[int] | None, typer.Option(help="Only this one; may be given several times.")
    ] = None


def undo(options: UndoOptions) -> None:
    """Go back to what was known at an earlier generation; nothing is deleted."""
    from fiberloom.store.find import existing

    existing(options.learnt)
    from fiberloom.store.generations import go_back

    options.show(go_back(options.learnt, options.to, options.positioner))
