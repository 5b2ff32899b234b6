"""`fiberloom exclude add|list|clear`: positioners that must not be moved."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated

import typer

from fiberloom.cli.array.options import BusOptions, excluded, operator
from fiberloom.cli.options import JsonOptions
from fiberloom.errors import InputError

PositionersArgument = Annotated[str, typer.Argument(help="Numbers of positioners, with commas.")]
WhoOption = Annotated[str | None, typer.Option(help="Who says so; default: the user.")]


@dataclass(frozen=True, kw_only=True)
class ExcludeAddOptions(BusOptions):
    """Of `exclude add`."""

    positioners: PositionersArgument
    why: Annotated[str, typer.Option(help="The reason, for the record.")]
    until: Annotated[
        str | None, typer.Option(help="UTC, e.g. 2026-11-30 or 2026-11-30T12:00; default: until cleared.")
    ] = None
    who: WhoOption = None


@dataclass(frozen=True, kw_only=True)
class ExcludeListOptions(BusOptions, JsonOptions):
    """Of `exclude list`."""

    past: Annotated[bool, typer.Option("--past", help="Also those that have ended.")] = False


@dataclass(frozen=True, kw_only=True)
class ExcludeClearOptions(BusOptions):
    """Of `exclude clear`."""

    positioners: PositionersArgument
    who: WhoOption = None


def exclude_add(options: ExcludeAddOptions) -> None:
    """Leave positioners where they are from now on, in every command to the array."""
    ids, until = _numbers(options.positioners), _time(options.until)
    if not options.why.strip():
        raise InputError("--why: a reason is needed; the next operator will ask for it")
    options.book().exclude(ids, options.who or operator(), options.why, until)
    typer.echo(f"excluded: {', '.join(map(str, ids))}; from the next command on")


def exclude_list(options: ExcludeListOptions) -> None:
    """List excluded positioners: since and until when, by whom, why."""
    from fiberloom.operation.session.status import exclusion_rows

    rows = exclusion_rows(options.book().exclusions(past=options.past))
    if rows or options.as_json:
        options.show(rows)
    else:
        typer.echo("no positioner is excluded")


def exclude_clear(options: ExcludeClearOptions) -> None:
    """Let excluded positioners move again."""
    ids = options.book().clear(_numbers(options.positioners), options.who or operator())
    typer.echo(f"no longer excluded: {', '.join(map(str, ids))}")


def _numbers(text: str) -> tuple[int, ...]:
    if ids := excluded(text):
        return ids
    raise InputError("exclude: which positioners? e.g. 12,40")


def _time(text: str | None) -> datetime | None:
    if text is None:
        return None
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(f"--until {text}: write a time as 2026-11-30 or 2026-11-30T12:00 (UTC)") from None
    when = when.replace(tzinfo=UTC) if when.tzinfo is None else when.astimezone(UTC)
    if when <= datetime.now(UTC):
        raise InputError(f"--until {text}: is over already; times are UTC")
    return when
