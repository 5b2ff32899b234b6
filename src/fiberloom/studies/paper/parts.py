"""One figure as it is kept on disk: `DIR/parts/fig16.json` and its pictures in `DIR/figures/`."""

from __future__ import annotations

import datetime
from pathlib import Path

from pydantic import BaseModel, ValidationError

from fiberloom.errors import InputError
from fiberloom.studies.paper.outcome import FigureOutcome, Settings
from fiberloom.studies.paper.quantity import Quantity
from fiberloom.studies.paper.registry import FIGURES, Figure
from fiberloom.version import __version__


class Part(BaseModel):
    """What came out of a figure, and how it was made."""

    key: str
    name: str
    heading: str
    title: str
    quantities: list[Quantity]
    drawings: list[tuple[str, str]]
    """File below the output folder, caption."""
    how: str
    smaller: str
    beyond: list[str]
    table: str = ""
    """Of all of it (Markdown); empty for most."""
    seconds: float
    cpu_s: float
    """Of this process and of those it starts, in this run: what it has kept from one before costs nothing."""
    seeds: list[int]
    full: bool
    version: str
    utc: str


def keep(
    figure: Figure, outcome: FigureOutcome, settings: Settings, out: Path, *, seconds: float, cpu_s: float
) -> Part:
    """Writes the part of one `figure` and its pictures to `out`.

    `outcome`: numbers and pictures; `settings` of the run; `seconds`: wall time in s, and `cpu_s` that
    it took.
    """
    for folder in ("figures", "parts"):
        (out / folder).mkdir(exist_ok=True)
    drawings = []
    for drawn in outcome.drawings:
        file = f"figures/{figure.name}_{drawn.name}.png"
        (out / file).write_bytes(drawn.png)
        drawings.append((file, drawn.caption))
    part = Part(
        key=figure.key,
        name=figure.name,
        heading=figure.heading,
        title=figure.title,
        quantities=outcome.quantities,
        drawings=drawings,
        how=outcome.how,
        smaller=outcome.smaller,
        beyond=outcome.beyond,
        table=outcome.table,
        seconds=round(seconds, 1),
        cpu_s=round(cpu_s, 1),
        seeds=list(settings.seeds),
        full=settings.full,
        version=__version__,
        utc=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    )
    write(out / "parts" / f"{figure.name}.json", part.model_dump_json(indent=2))
    return part


def read_parts(out: Path) -> list[Part]:
    """The parts of a folder, in the order of the figures."""
    found = [out / "parts" / f"{figure.name}.json" for figure in FIGURES]
    return [_read(path) for path in found if path.is_file()]


def _read(path: Path) -> Part:
    try:
        return Part.model_validate_json(path.read_text(encoding="utf-8"))
    except (ValidationError, UnicodeDecodeError):
        raise InputError(f"{path}: not a figure of this version; remove it and run it again") from None


def write(path: Path, text: str) -> None:
    """At once or not at all."""
    part = path.with_name(f".{path.name}.part")
    part.write_text(text + "\n", encoding="utf-8")
    part.replace(path)
