"""All quantities as one Markdown table."""

from __future__ import annotations

from collections.abc import Sequence

from fiberloom.studies.paper import numbers
from fiberloom.studies.paper.parts import Part

_HEAD = (
    "| figure | quantity | paper | ours ± spread over seeds | unit | ratio | kind | note |\n"
    "|---|---|--:|--:|---|--:|---|---|"
)


def table_markdown(parts: Sequence[Part]) -> str:
    """One row per quantity, what is beyond the paper marked so."""
    rows = [_HEAD]
    for part in parts:
        for q in part.quantities:
            name = f"{q.name} (beyond the paper)" if q.beyond else q.name
            cells = (
                part.heading,
                name,
                numbers.paper(q),
                numbers.ours(q),
                numbers.unit(q),
                numbers.ratio(q),
                numbers.verdict(q),
                q.note,
            )
            rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    whole = [f"\n{part.heading}: {part.title}\n\n{part.table}" for part in parts if part.table]
    return "\n".join([*rows, *whole])
