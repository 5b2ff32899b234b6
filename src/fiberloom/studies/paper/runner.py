"""Runs figures one after the other; what is done is on disk before the next one starts.

results.json, results.md and report.html are made of all the parts in the folder after each figure,
so an interrupted run loses the figure it was at, and a later one adds to it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from fiberloom.report.outputs import prepare_folder
from fiberloom.studies.paper.outcome import Settings
from fiberloom.studies.paper.parts import Part, keep, read_parts, write
from fiberloom.studies.paper.registry import Figure
from fiberloom.studies.paper.report import report_html
from fiberloom.studies.paper.table import table_markdown
from fiberloom.timing import cpu_s


def reproduce(
    figures: Sequence[Figure],
    out: Path,
    settings: Settings,
    done: Callable[[Part], None] = lambda part: None,
) -> list[Part]:
    """Runs the `figures` with `settings`, writes `out`, and calls `done` after each. Returns these
    figures' parts.
    """
    prepare_folder(out)
    settings = replace(settings, folder=out / "parts")
    parts = []
    for figure in figures:
        settings.say(f"{figure.heading}: {figure.title}")
        started_s, used_s = time.monotonic(), cpu_s()
        outcome = figure.run(settings)
        took = {"seconds": time.monotonic() - started_s, "cpu_s": cpu_s() - used_s}
        part = keep(figure, outcome, settings, out, **took)
        parts.append(part)
        write_all(out)
        done(part)
    return parts


def write_all(out: Path) -> None:
    """results.json, results.md and report.html of all the parts that are there."""
    parts = read_parts(out)
    records = [q.model_dump(mode="json") for part in parts for q in part.quantities]
    write(out / "results.json", json.dumps(records, indent=1, ensure_ascii=False, allow_nan=False))
    write(out / "results.md", table_markdown(parts))
    write(out / "report.html", report_html(parts, out))
