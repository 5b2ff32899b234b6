"""`fiberloom design check`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Annotated

import typer

from fiberloom.cli.design.coverage import DesignOptions
from fiberloom.cli.options import require_instrument


@dataclass(frozen=True, kw_only=True)
class CheckOptions(DesignOptions):
    """Of `fiberloom design check`."""

    within: Annotated[
        float | None, typer.Option(help="Time in which an axis must make its whole range, s.")
    ] = None
    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0


def check(options: CheckOptions) -> int:
    """What is wrong with a design, all of it at once, with numbers and what would help.

    Parked arms, ranges that leave holes, the camera's view and noise, gears, springs. Notes are worth
    knowing; exit code 1 where something is wrong.
    """
    require_instrument(options.file)
    from fiberloom.design.check import check as findings_of
    from fiberloom.instruments import load_instrument

    instrument = load_instrument(options.file)
    found = findings_of(instrument, options.seed, options.within)
    wrong = sum(one.wrong for one in found)
    if options.as_json:
        options.print_json({"wrong": wrong, "findings": [asdict(one) for one in found]})
    else:
        for one in found:
            typer.echo(str(one))
        typer.echo(f"{instrument.name}: {f'{wrong} wrong' if wrong else 'passes'}")
    return int(wrong > 0)
