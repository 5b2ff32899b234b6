"""`fiberloom design presets`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from fiberloom.cli.options import JsonOptions


@dataclass(frozen=True, kw_only=True)
class PresetsOptions(JsonOptions):
    """Of `fiberloom design presets`."""

    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0


def presets(options: PresetsOptions) -> int:
    """Reach and coverage of the six presets beside what is published of their instruments.

    Exit code 1 where one of ours is outside what is published.
    """
    from fiberloom.design.published import beside

    found = beside(options.seed)
    options.show(
        [
            {
                "preset": one.published.preset,
                "figure": one.published.figure,
                "published": _told(one.published.low, one.published.high),
                "ours": round(one.ours, 4),
                "agrees": "yes" if one.agrees else "no",
                "source": one.published.source,
            }
            for one in found
        ]
    )
    return int(not all(one.agrees for one in found))


def _told(low: float, high: float) -> str:
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
