"""`fiberloom instruments`: the presets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import typer

from fiberloom.cli.options import JsonOptions, require_instrument


@dataclass(frozen=True, kw_only=True)
class InstrumentsOptions(JsonOptions):
    """Of `fiberloom instruments`."""

    name: Annotated[str | None, typer.Argument(help="Show one preset in full.")] = None


def instruments(options: InstrumentsOptions) -> None:
    """List the presets, or show one."""
    if options.name is None:
        options.show(_all())
        return
    require_instrument(options.name)
    from fiberloom.instruments import load_instrument

    options.show(load_instrument(options.name).model_dump(mode="json"))


def _all() -> list[dict[str, Any]]:
    from fiberloom.instruments import instrument_names, load_instrument
    from fiberloom.report.tables import overview
    from fiberloom.twin.hardware import missing_in_twin

    return [
        overview(i) | {"twin_drives_it": "yes" if not missing_in_twin(i) else "no"}
        for i in map(load_instrument, instrument_names())
    ]
