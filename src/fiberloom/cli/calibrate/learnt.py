"""`fiberloom calibrate history` and `undo`: generations of the learnt maps, listed and undone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from fiberloom.cli.options import JsonOptions


@dataclass(frozen=True, kw_only=True)
class HistoryOptions(JsonOptions):
    """Of `calibrate history`."""

    learnt: Annotated[str, typer.Argument(help="Store of the learnt maps, as `observe --adapt` names it.")]
    positioner: Annotated[int | None, typer.Option(help="Only the generations that changed this one.")] = None


def history(options: HistoryOptions) -> None:
    """List the generations of the maps that observations have taught."""
    from fiberloom.store.find import existing

    existing(options.learnt)
    from fiberloom.store.generations import learnt_generations

    rows = learnt_generations(options.learnt, options.positioner)
    if not options.as_json:  # the other columns do not fit the width of a terminal
        rows = [{k: v for k, v in row.items() if k not in ("calibration", "seed")} for row in rows]
    options.show(rows)


@dataclass(frozen=True, kw_only=True)
class UndoOptions(JsonOptions):
    """Of `calibrate undo`."""

    learnt: Annotated[str, typer.Argument(help="Store of the learnt maps.")]
    to: Annotated[int, typer.Option(min=0, help="Generation to go back to; 0: the calibration itself.")]
    positioner: Annotated[
        list[int] | None, typer.Option(help="Only this one; may be given several times.")
    ] = None


def undo(options: UndoOptions) -> None:
    """Go back to an earlier generation of the maps; nothing is deleted."""
    from fiberloom.store.find import existing

    existing(options.learnt)
    from fiberloom.store.generations import go_back

    options.show(go_back(options.learnt, options.to, options.positioner))
