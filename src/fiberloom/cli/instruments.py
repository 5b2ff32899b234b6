"""`fiberloom instruments`: the presets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import typer

from fiberloom.cli.options import JsonOptions, require_instrument
from fiberloom.errors import InputError


@dataclass(frozen=True, kw_only=True)
class InstrumentsOptions(JsonOptions):
    """Of `fiberloom instruments`."""

    name: Annotated[str | None, typer.Argument(help="Show one preset, or a file, in full.")] = None
    toml: Annotated[
        bool, typer.Option("--toml", help="Print its TOML file, with comments: to be changed and used.")
    ] = False


def instruments(options: InstrumentsOptions) -> None:
    """List the presets, or show one."""
    if options.name is None:
        if options.toml:
            raise InputError("--toml: name a preset, as in: fiberloom instruments sdssv --toml")
        options.show(_all())
        return
    if options.toml and options.as_json:
        raise InputError("--toml and --json: choose one of the two")
    require_instrument(options.name)
    from fiberloom.instruments.load import instrument_text, load_instrument

    if options.toml:
        typer.echo(instrument_text(options.name), nl=False)
        return
    options.show(load_instrument(options.name).model_dump(mode="json"))


def _all() -> list[dict[str, Any]]:
    from fiberloom.instruments import instrument_names, load_instrument
    from fiberloom.report.tables import overview

    return [
        overview(i) | {"twin_drives_it": "no" if i.drive.protocol == "none" else "yes"}
        for i in map(load_instrument, instrument_names())
    ]
