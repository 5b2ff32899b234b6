"""What many commands of the command line share: options, the focal plane they name, printing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from fiberloom.errors import InputError

InstrumentOption = Annotated[str, typer.Option(help="Preset name, or a TOML file of your own.")]
LayoutOption = Annotated[
    Path | None, typer.Option(help="Folder with the layout: ours, or SDSS-V calibration files.")
]
SeedOption = Annotated[int, typer.Option(min=0, help="The one seed of everything random.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
PositionersOption = Annotated[
    int | None, typer.Option(min=1, help="Only so many positioners of the preset, from the centre.")
]


def read_plane(instrument: str, layout: Path | None, seed: int, positioners: int | None = None) -> Any:
    """The focal plane of a preset or file, or of a layout."""
    from fiberloom.instruments import generate, load_instrument, read_layout

    model = load_instrument(instrument)
    if layout is None:
        return generate(model, seed, n_positioners=positioners)
    if positioners is not None:
        raise InputError("--positioners goes with a preset; a --layout says itself how many there are")
    return read_layout(layout, model)


def print_report(report: Any, as_json: bool) -> None:
    """For people, or JSON."""
    from fiberloom.report.tables import print_report as print_table

    if as_json:
        typer.echo(json.dumps(report, indent=2, default=str))
    else:
        print_table(report)
