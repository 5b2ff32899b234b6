"""`fiberloom reproduce`: the paper's figures, ours beside theirs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fiberloom.cli.options import JsonOptions, require_folder
from fiberloom.cli.terminal import waiting

if TYPE_CHECKING:
    from rich.console import Console

    from fiberloom.studies.paper.parts import Part


@dataclass(frozen=True, kw_only=True)
class ReproduceOptions(JsonOptions):
    """Of `fiberloom reproduce`."""

    figures: Annotated[
        list[str] | None, typer.Argument(help="Figures of the paper, e.g. 16 19 eq22; default: all.")
    ] = None
    out: Annotated[Path, typer.Option(help="Folder for report, results and figures.")] = Path(
        "runs/reproduce"
    )
    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds in a row give the spread.")] = 3
    full: Annotated[bool, typer.Option("--full", help="The size of the paper's experiments.")] = False
    fresh: Annotated[
        bool,
        typer.Option(
            "--fresh",
            help="Make rows of Table 1 anew; default: those in DIR that the same code has made are kept.",
        ),
    ] = False


def reproduce(options: ReproduceOptions) -> None:
    """Make the paper's figures and numbers on the twin, ours beside theirs."""
    from fiberloom.studies.paper import chosen

    figures = chosen(tuple(options.figures or ()))
    require_folder(options.out)
    from rich.console import Console

    from fiberloom.studies.paper import Settings
    from fiberloom.studies.paper import reproduce as run_figures

    console = Console(quiet=options.as_json)
    with waiting(options.as_json) as wait:
        settings = Settings(options.seed, options.seeds, options.full, wait.say, fresh=options.fresh)
        parts = run_figures(figures, options.out, settings, lambda part: _print(console, part))
    console.print(_closing(parts, options.out))
    if options.as_json:
        options.print_json([q.model_dump(mode="json") for part in parts for q in part.quantities])


def _print(console: Console, part: Part) -> None:
    from rich import box
    from rich.table import Table

    from fiberloom.studies.paper import numbers

    title = f"{part.heading}: {part.title} ({part.seconds:.1f} s, processor {part.cpu_s:.1f} s)"
    table = Table(box=box.SIMPLE, title=title, title_justify="left", title_style="bold")
    for name in ("quantity", "paper", "ours", "unit", "ratio", "kind"):
        table.add_column(name, justify="right" if name in ("paper", "ours", "ratio") else "left")
    for q in part.quantities:
        style = "red" if q.misses else "green" if q.beyond else ""
        row = (
            q.name,
            numbers.paper(q),
            numbers.ours(q),
            numbers.unit(q),
            numbers.ratio(q),
            numbers.verdict(q),
        )
        table.add_row(*row, style=style)
    console.print(table)
    if part.table:
        console.print(part.table, markup=False, soft_wrap=True)
    if part.smaller:
        console.print(f"  smaller than the paper's: {part.smaller}\n")


def _closing(parts: list[Part], out: Path) -> str:
    from fiberloom.studies.paper import numbers

    quantities = [q for part in parts for q in part.quantities]
    seconds, cpu_s = sum(part.seconds for part in parts), sum(part.cpu_s for part in parts)
    return (
        f"{len(parts)} figures in {seconds:.0f} s (processor {cpu_s:.0f} s): {numbers.headline(quantities)}\n"
        f"no predictions: {numbers.others(quantities) or 'none'}\n"
        f"results in {out}/: report.html, results.json, results.md, figures/"
    )
