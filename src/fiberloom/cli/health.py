"""`fiberloom health`: the state of every positioner by the stores of past runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import typer

from fiberloom.cli.options import JsonOptions, PlaneOptions


@dataclass(frozen=True, kw_only=True)
class HealthOptions(PlaneOptions, JsonOptions):
    """Of `fiberloom health`."""

    where: Annotated[str, typer.Argument(help="Store, database URL, or a folder with stores below it.")] = (
        "runs"
    )


def health(options: HealthOptions) -> int:
    """List the positioners that past runs show to be degraded, suspect or disabled, with what to do.

    Exit code 1 where a positioner is not healthy.
    """
    from fiberloom.store.find import stores_below

    options.check_plane()
    stores_below(options.where)
    from fiberloom.health.past_runs import health_report

    report = health_report(options.where, options.plane())
    if options.as_json:
        options.print_json(report)
    else:
        _print(report)
    return 1 if report["findings"] else 0


def _print(report: dict[str, Any]) -> None:
    """Prints one line about all positioners, and a table of those that are not healthy, worst first."""
    from rich.table import Table

    from fiberloom.health.monitor import State
    from fiberloom.report.tables import table_console

    console = table_console()
    counts = ", ".join(f"{n} {state}" for state, n in report["states"].items() if n)
    console.print(f"{report['moves']} moves in {report['runs']} runs: {counts}")
    if not report["findings"]:
        return
    table = Table()
    for name in ("positioner", "state", "ailment", "axis", "evidence", "what to do"):
        table.add_column(name, overflow="fold")
    order = {str(state): k for k, state in enumerate(reversed(State))}
    for row in sorted(report["findings"], key=lambda row: order[row["state"]]):
        cells = (row[k] for k in ("positioner_id", "state", "ailment", "axis", "evidence", "advice"))
        table.add_row(*map(str, cells))
    console.print(table)
