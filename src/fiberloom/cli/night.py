"""`fiberloom night`: a queue of fields, from dusk to dawn."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.array.options import STORE_VARIABLE, array_book, command_line, excluded
from fiberloom.cli.options import DatabaseOptions, JsonOptions, powered, require_file
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from fiberloom.field import Field
    from fiberloom.instruments import FocalPlane
    from fiberloom.night.carry import NightEnd
    from fiberloom.night.queue import QueueArray
    from fiberloom.night.setup import NightSetup
    from fiberloom.store import Store
    from fiberloom.store.nights.book import NightBook
    from fiberloom.store.place import Place

TWIN = "twin:"


@dataclass(frozen=True, kw_only=True)
class NightOptions(DatabaseOptions, JsonOptions):
    """Of `fiberloom night`. None: as the queue says."""

    queue: Annotated[Path, typer.Argument(help="TOML file of the night: its fields, and which array.")]
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the last night of this queue, after a crash or stop.")
    ] = False
    bus: Annotated[str | None, typer.Option(help="Bus, in place of the queue's; default: the twin.")] = None
    camera: Annotated[str | None, typer.Option(help="Camera, in place of the queue's.")] = None
    calibration: Annotated[
        Path | None, typer.Option(help="Transmission maps, in place of the queue's; default: the cache.")
    ] = None
    store: Annotated[
        str | None, typer.Option(help=f"Store of arrays; default: {STORE_VARIABLE}, else the user's data.")
    ] = None
    exclude: Annotated[
        str, typer.Option(help="Positioners left where they are, for this night: numbers with commas.")
    ] = ""
    power: Annotated[
        float | None,
        typer.Option(help="Of the supply for all motors, W, in place of the queue's; plans keep it."),
    ] = None
    out: Annotated[Path, typer.Option(help="Folder of store, runs and reports.")] = Path("runs")

    @property
    def place(self) -> Place:
        """Where the night is kept. InputError where the database is no URL."""
        from fiberloom.store.place import NUMBERED, Place

        self.check_database()
        return Place(self.out, NUMBERED, self.database)


def night(options: NightOptions) -> int:
    """Observe a queue of fields from dusk to dawn, and report the night.

    Exit code 1 where the night ended because a person is needed, or a field failed.
    """
    require_file(options.queue, "write one as examples/night.toml")
    place = options.place
    left_out = excluded(options.exclude)
    from fiberloom.night.queue import read_queue
    from fiberloom.report.folder import prepare_folder

    queue = read_queue(options.queue)
    prepare_folder(options.out)
    from fiberloom.blocking import finish
    from fiberloom.store import Store

    with Store.open(place.record) as store, waiting(options.as_json) as watcher:
        field = _field(options, queue.array)
        field.watcher, field.exclude = watcher, left_out
        setup = _setup(options, field, queue.array, store)
        try:
            ended = finish(_carried(setup, store, options.resume, watcher.say))
        finally:
            _reported(store, setup)
        return _show(options, setup, store, ended)


def _field(options: NightOptions, array: QueueArray) -> Field:
    """The array of the queue, with what was typed in place of what it says."""
    from fiberloom.connect import open_hardware
    from fiberloom.field import Field

    limit_W = array.power_W if options.power is None else options.power
    plane = powered(queue_plane(array), limit_W, array.seed)
    bus, camera = options.bus or array.bus or TWIN, options.camera or array.camera
    if not bus.startswith(TWIN) and camera is None:
        raise InputError("--bus: name the camera too, e.g. --camera alpaca://10.1.10.40:11111/0")
    wrong = {"faults": array.faults, "errors": array.errors}
    source = open_hardware(plane, bus, camera or "noise", seed=array.seed, **wrong)
    return Field(plane, source, array.seed, options.calibration or array.calibration)


def queue_plane(array: QueueArray) -> FocalPlane:
    """The positioners that a queue names."""
    from fiberloom.instruments import generate, load_instrument, read_layout

    model = load_instrument(array.instrument)
    if array.layout is None:
        return generate(model, array.seed, n_positioners=array.positioners)
    return read_layout(array.layout, model)


def _setup(options: NightOptions, field: Field, array: QueueArray, store: Store) -> NightSetup:
    from fiberloom.blocking import finish
    from fiberloom.connect import array_address
    from fiberloom.night.setup import NightSetup
    from fiberloom.operation.known import Learning, known_so_far
    from fiberloom.operation.session.session import KnownArray
    from fiberloom.store.arrays import ArrayBook

    bus = options.bus or array.bus or TWIN
    maps = finish(field.calibrate())
    maps_file = field.maps_file or options.out / "maps.npz"
    known = known_so_far(field.plane, maps, maps_file, Learning(seed=array.seed))
    # a twin inside of this process is an array of this night alone
    inside = bus.startswith(TWIN)
    book = ArrayBook(store, array_address(bus)) if inside else array_book(bus, options.store)
    return NightSetup(
        known,
        KnownArray(field.plane, maps, field.source, book),
        options.queue.resolve(),
        options.out,
        command_line(),
        array.seed,
        field.exclude,
        virtual=inside,
        database=options.database,
    )


async def _carried(
    setup: NightSetup, store: Store, resume: bool, progress: Callable[[str], None]
) -> NightEnd:
    from fiberloom.night.carry import carry_out

    return await carry_out(setup, store, resume, progress)


def _reported(store: Store, setup: NightSetup) -> None:
    """Writes the report, also of a night that was stopped; one that never began has none."""
    from fiberloom.night.report import write_report

    if (book := _mine(store, setup)) is not None:
        folder = setup.folder(book.id)
        folder.mkdir(parents=True, exist_ok=True)
        write_report(book, folder)


def _mine(store: Store, setup: NightSetup) -> NightBook | None:
    """The night that this process has carried out, or begun to."""
    from fiberloom.store.nights.book import NightBook, nights

    ours = os.getpid(), str(setup.queue_file)
    found = [night.id for night in nights(store) if (night.pid, night.queue) == ours]
    return NightBook(store, found[-1]) if found else None


def _show(options: NightOptions, setup: NightSetup, store: Store, ended: NightEnd) -> int:
    from fiberloom.night.figures import night_figures
    from fiberloom.store.nights.book import NightBook

    figures = night_figures(NightBook(store, ended.night))
    if options.as_json:
        options.print_json(figures | {"folder": str(setup.folder(ended.night))})
    else:
        print_night(figures, str(setup.folder(ended.night)))
    failed = [row for row in figures["fields"] if row["state"] == "failed"]
    return 1 if ended.status != "finished" or failed else 0


def print_night(figures: dict[str, Any], folder: str) -> None:
    """Prints a night: a row for each field, and its totals. `folder`: of its report."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console, night, totals = Console(), figures["night"], figures["totals"]
    table = Table(box=box.SIMPLE, title=f"night {night['id']}: {night['name']}", title_justify="left")
    for name in ("field", "state", "visits", "exposures", "on target", "rms, um", "reason"):
        table.add_column(name, justify="left" if name in ("field", "state", "reason") else "right")
    for row in figures["fields"]:
        known = row["assigned"] is not None
        shown = (f"{row['on_target']} of {row['assigned']}", f"{row['rms_um']:.2f}") if known else ("", "")
        counts = str(row["visits"]), str(row["exposures"])
        table.add_row(row["field"], row["state"], *counts, *shown, row["reason"])
    console.print(table)
    for line in _lines(night, totals, figures["alarms"], folder):
        console.print(line, markup=False, soft_wrap=True)


def _lines(
    night: dict[str, Any], totals: dict[str, Any], alarms: list[dict[str, Any]], folder: str
) -> list[str]:
    gap = totals["shutter_to_ready_s"]
    lines = [f"{night['status']}: {night['note']}"]
    if totals["night_s"]:
        share = 100.0 * totals["shutter_open_s"] / totals["night_s"]
        lines.append(
            f"shutter open {totals['shutter_open_s']:.0f} s of {totals['night_s']:.0f} s, {share:.1f} %"
        )
    if gap["n"]:
        lines.append(
            f"shutter closed to fibres on target: median {gap['median']:.1f} s, at most {gap['max']:.1f} s"
        )
    lines.append(
        f"plans: {totals['planned_ahead']} made while the shutter was open, {totals['planned_now']} later"
    )
    lines += [f"{a['severity']}: {a['subject']}: {a['text']} ({a['count']} times)" for a in alarms]
    return [*lines, f"report in {folder}/: night.html, night.json"]


def show_night(number: int, where: str, out: Path | None, as_json: bool) -> None:
    """Prints a night of the past and writes its report anew.

    `number`: of the night; `where`: store, or folder with it; `out`: folder of the report, None: that of the
    night; `as_json`: print all figures instead.
    """
    from fiberloom.night.figures import night_figures
    from fiberloom.night.report import write_report
    from fiberloom.report.folder import prepare_folder
    from fiberloom.store import Store
    from fiberloom.store.nights.book import NightBook, night_of
    from fiberloom.store.place import STORE

    place = where if "://" in where or not Path(where).is_dir() else str(Path(where) / STORE)
    if out is None and "://" in place:
        raise InputError(f"{place}: is no file, and has no folder; name one with --out")
    with Store.read(place) as store:
        book = NightBook(store, night_of(store, number).id)
        folder = prepare_folder(out or Path(place).parent / f"night-{number:04d}")
        write_report(book, folder)
        figures = night_figures(book)
    if as_json:
        JsonOptions.print_json(figures | {"folder": str(folder)})
    else:
        print_night(figures, str(folder))
