"""`fiberloom reproduce`: the paper's figures, ours beside theirs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from fiberloom.cli.terminal import waiting
from fiberloom.studies.paper import Settings, chosen, numbers
from fiberloom.studies.paper import reproduce as run_figures
from fiberloom.studies.paper.parts import Part


@dataclass(frozen=True)
class ReproduceRequest:
    """What the command line asked for."""

    figures: tuple[str, ...]
    out: Path
    seed: int = 0
    n_seeds: int = 3
    full: bool = False
    quiet: bool = False


def run_reproduce(request: ReproduceRequest) -> list[dict[str, Any]]:
    """Runs the figures; prints each as it is done; returns their records of results.json."""
    figures = chosen(request.figures)
    console = Console(quiet=request.quiet)
    with waiting(request.quiet) as wait:
        settings = Settings(request.seed, request.n_seeds, request.full, wait.say)
        parts = run_figures(figures, request.out, settings, lambda part: _print(console, part))
    console.print(_closing(parts, request.out))
    return [q.model_dump(mode="json") for part in parts for q in part.quantities]


def _print(console: Console, part: Part) -> None:
    title = f"{part.heading}: {part.title} ({part.seconds:.1f} s, processor {part.cpu_s:.1f} s)"
    table = Table(box=box.SIMPLE, title=title, title_justify="left", title_style="bold")
    for name in ("quantity", "paper", "ours", "unit", "ratio", "kind"):
        table.add_column(name, justify="right" if name in ("paper", "ours", "ratio") else "left")
    for q in part.quantities:
        style = "red" if q.misses else "green" if q.beyond else ""
        row = (q.name, numbers.paper(q), numbers.ours(q), q.unit, numbers.ratio(q), numbers.verdict(q))
        table.add_row(*row, style=style)
    console.print(table)
    if part.smaller:
        console.print(f"  smaller than the paper's: {part.smaller}\n")


def _closing(parts: list[Part], out: Path) -> str:
    missed = sum(q.misses for part in parts for q in part.quantities)
    seconds, cpu_s = sum(part.seconds for part in parts), sum(part.cpu_s for part in parts)
    return (
        f"{len(parts)} figures in {seconds:.0f} s (processor {cpu_s:.0f} s); {missed} predictions miss by "
        f"more than 25 % or a bound\nresults in {out}/: report.html, results.json, results.md, figures/"
    )
