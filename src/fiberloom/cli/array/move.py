"""`fiberloom park`, `home`, `recover`, `stop`: commands that move an array, or end its motion."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from fiberloom.cli.array.options import ArrayOptions, BusOptions, excluded, operator
from fiberloom.cli.options import JsonOptions, require_instrument
from fiberloom.cli.terminal import waiting


@dataclass(frozen=True, kw_only=True)
class ParkOptions(ArrayOptions, JsonOptions):
    """Of `fiberloom park`."""


@dataclass(frozen=True, kw_only=True)
class HomeOptions(ArrayOptions, JsonOptions):
    """Of `fiberloom home`."""

    only: Annotated[str, typer.Option(help="Positioners to search, numbers with commas; default: all.")] = ""


@dataclass(frozen=True, kw_only=True)
class RecoverOptions(ArrayOptions, JsonOptions):
    """Of `fiberloom recover`."""

    look: Annotated[bool, typer.Option("--look", help="Say what touches and what would be done.")] = False


@dataclass(frozen=True, kw_only=True)
class StopOptions(BusOptions, JsonOptions):
    """Of `fiberloom stop`."""

    instrument: Annotated[
        str, typer.Option(help="Preset name, or a TOML file of your own: whose stop is sent on a CAN bus.")
    ] = "sdssv"


def park(options: ParkOptions) -> int:
    """Fold every positioner of an array, by a verified plan after the begin check.

    Exit code 1 where a positioner did not do what was asked.
    """
    options.check()
    from fiberloom.blocking import finish

    with waiting(options.as_json) as watcher:
        report = finish(options.session(watcher.say).park())
    return _show(options, report)


def home(options: HomeOptions) -> int:
    """Search the datum of positioners, in an order in which no arms can meet; then fold.

    Exit code 1 where a positioner did not do what was asked, or where steppers have lost steps since the
    last search.
    """
    options.check()
    only = excluded(options.only) or None
    from fiberloom.blocking import finish

    with waiting(options.as_json) as watcher:
        report = finish(options.session(watcher.say).home(only))
    return _show(options, report)


def recover(options: RecoverOptions) -> int:
    """Take arms apart that touch, by a verified way, and find positioners that are not where they report.

    Exit code 1 where a positioner did not do what was asked.
    """
    options.check()
    from fiberloom.blocking import finish

    with waiting(options.as_json) as watcher:
        report = finish(options.session(watcher.say).recover(options.look))
    return _show(options, report)


def _show(options: JsonOptions, report: Any) -> int:
    from fiberloom.operation.session.session import as_table

    table = as_table(report)
    if not options.as_json:  # a column of numbers tells no more than their count
        table["datum_found"] = f"{len(report.datum_found)} of {report.n_positioners}"
        if report.command != "home":
            del table["datum_found"]
    options.show(table)
    return 0 if report.ok else 1


def stop(options: StopOptions) -> int:
    """Stop an array, whichever process moves it; exit code 1 where it could not be stopped."""
    address = options.address
    from fiberloom.blocking import finish
    from fiberloom.connect import TWIN, is_shared
    from fiberloom.errors import InputError
    from fiberloom.instruments import load_instrument
    from fiberloom.operation.outside.stops import own_stop
    from fiberloom.operation.session.stopping import Stopper

    if address.startswith(TWIN):
        raise InputError("--bus twin: is inside of the process that moves it: Ctrl-C stops it there")
    who = f"{operator()} on {socket.gethostname()}"
    require_instrument(options.instrument)
    halt = own_stop(address, load_instrument(options.instrument).drive.protocol)
    stopper = Stopper(options.book(), halt, is_shared(address), who)
    report = finish(stopper.stop())
    options.show({"stopped": report.stopped, "by": report.by, "text": report.text})
    return 0 if report.stopped else 1
