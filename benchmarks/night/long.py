"""`python -m benchmarks.night.long [--fields 12] [--hours 0] [--positioners 500] [--faults 8]`.

A night on the twin with faults that are drawn: how long from shutter closed to fibres on target, what was
planned meanwhile, contacts of arms in the truth of the twin, and whether memory and descriptors stay. Printed
by field, with `--hours` also by hour, then as JSON. With `--hours` the fields come again until dawn.

The twin's clock does not run while an image is taken or a plan is made: each image is counted as 6.5 s, and
what was assigned and planned with the shutter closed by the seconds of this machine.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import resource
import sys
import tempfile
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

import fiberloom as fl
from fiberloom.connect import twin_source
from fiberloom.errors import InputError
from fiberloom.field import Field
from fiberloom.night.carry import NightEnd, carry_out
from fiberloom.night.figures import shutter_to_ready_s
from fiberloom.night.report import write_report
from fiberloom.night.setup import NightSetup
from fiberloom.operation.known import Learning, known_so_far
from fiberloom.operation.past.rebuild import info_of_run, observation_of
from fiberloom.operation.session.session import KnownArray
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.nights.book import NightBook
from fiberloom.store.nights.records import VisitRecord
from fiberloom.targets import random_targets, write_targets

from .killed import images_of

BEGIN = datetime(2026, 11, 25, 18, 0, tzinfo=UTC)
IMAGE_S = 6.5
"""Exposure of 5 s and read-out: what a peer's camera takes [A]."""
KINDS = ("dead", "lying", "dark", "stuck_hall", "mute", "nostart", "refuse", "reboot")
NOT_HIDDEN = ("position: assigning targets", "position: planning: blind")
GAP = ("bus_s", "images", "not_hidden_machine_s")
"""What the time from shutter to ready is made of; images in numbers."""
SETTLED = 0.25
"""Of the night, after which memory is compared."""
MOST_S, MOST_GROWTH_MB = 90.0, 50.0
"""From shutter to ready; of memory since it has settled."""


class Look(NamedTuple):
    """This process as a visit begins: what the one before has left."""

    share: float
    """Of the night."""
    memory_MB: float
    """Resident."""
    opened_MB: float
    """Resident as the last shutter opened, right after positioning."""
    descriptors: int
    contacts: int
    """Of arms so far, in the truth of the twin."""


def resident_MB() -> float:
    """Memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return round(pages * resource.getpagesize() / 1e6, 1)


@dataclass
class Watch:
    """Memory and descriptors of this process as a night goes on."""

    begun_s: float = field(default_factory=time.monotonic)
    looks: list[Look] = field(default_factory=list)
    opened_MB: float = math.nan

    def opens(self) -> None:
        """Notes the memory as a shutter opens."""
        self.opened_MB = resident_MB()

    def look(self, share: float, contacts: int) -> None:
        """Notes them at this `share` of the night, and how many `contacts` there were."""
        descriptors = len(list(Path("/proc/self/fd").iterdir()))
        self.looks.append(Look(round(share, 4), resident_MB(), self.opened_MB, descriptors, contacts))

    def told(self) -> dict[str, Any]:
        """Growth from a quarter of the night, and from its half, to its end; of the medians of eighths."""
        last = self.looks[-1].share
        parts = [self._eighth(begin) for begin in (SETTLED, 0.5, last - 0.125)]
        memory_MB = [median(one.memory_MB for one in part) for part in parts]
        return {
            "memory_MB": memory_MB,
            "memory_growth_MB": round(memory_MB[2] - memory_MB[0], 1),
            "memory_growth_of_second_half_MB": round(memory_MB[2] - memory_MB[1], 1),
            "descriptors": [median(one.descriptors for one in part) for part in parts],
            "contacts": self.looks[-1].contacts,
            "memory_as_a_shutter_opened_MB": max(one.opened_MB for one in self.looks if one.opened_MB > 0),
            "looks": len(self.looks),
            "wall_s": round(time.monotonic() - self.begun_s),
            "cpu_s": round(time.process_time()),
        }

    def _eighth(self, begin: float) -> list[Look]:
        found = [one for one in self.looks if begin <= one.share <= begin + 0.125]
        return found or self.looks[:1]

    def by_hour(self, hours: float) -> list[dict[str, Any]]:
        """The last look in each hour of a night of so many `hours`."""
        last = {math.ceil(one.share * hours) or 1: one for one in self.looks}
        return [{"hour": hour, **one._asdict()} for hour, one in last.items()]


def drawn_faults(seed: int, ids: np.ndarray[Any, Any], number: int, night_s: float) -> str:
    """So many faults for `--faults`, none twice at one positioner, at any time of the night."""
    rng = np.random.default_rng([seed, 0x17])
    victims = rng.choice(ids, size=number, replace=False)
    kinds, begin_s = rng.choice(KINDS, size=number), rng.uniform(0.0, night_s, number)
    return ",".join(f"{k}=#{i}@{t:.1f}" for k, i, t in zip(kinds, victims, begin_s, strict=True))


def write_queue(folder: Path, plane: fl.FocalPlane, asked: argparse.Namespace) -> None:
    """The fields, each with a list of its own; with hours they come again, under other names, until dawn."""
    number = math.ceil(3600.0 * asked.hours / asked.exposure) or asked.fields
    dawn = BEGIN + timedelta(hours=asked.hours or 24)
    lines = [f"begin = {BEGIN:%Y-%m-%dT%H:%M:%SZ}", f"dawn = {dawn:%Y-%m-%dT%H:%M:%SZ}", "attempts = 3"]
    for k in range(asked.fields):
        write_targets(random_targets(plane, 8 * len(plane), asked.seed + k), folder / f"f{k}.csv")
    for k in range(number):
        lines += ["[[field]]", f'id = "f{k}"', f'targets = "f{k % asked.fields}.csv"']
        lines += [f"exposure_s = {asked.exposure}"]
    (folder / "queue.toml").write_text("\n".join(lines) + "\n")


def night_s(asked: argparse.Namespace) -> float:
    """How long it will be, about."""
    return 3600.0 * asked.hours or asked.fields * (asked.exposure + 60.0)


def carried(folder: Path, asked: argparse.Namespace, watch: Watch) -> tuple[NightBook, NightEnd, str]:
    """The night; its record, its end, its faults."""
    plane = fl.FocalPlane.of("sdssv", seed=asked.seed, n=asked.positioners)
    write_queue(folder, plane, asked)
    faults = drawn_faults(asked.seed, plane.positioner_id, asked.faults, night_s(asked))
    array = Field(plane, twin_source(plane, asked.seed, asked.camera, faults), asked.seed)
    maps = array.run.calibrate()
    store = Store.open(folder / "store.sqlite")
    known = known_so_far(plane, maps, array.maps_file or folder / "maps.npz", Learning(seed=asked.seed))
    found: list[Any] = []
    setup = NightSetup(
        known,
        KnownArray(plane, maps, array.source, ArrayBook(store, "twin:long")),
        folder / "queue.toml",
        folder,
        "benchmarks.night.long",
        asked.seed,
        virtual=True,
        begun=found.append,
    )

    def progress(text: str) -> None:
        if found and text.startswith("expose"):
            watch.opens()
        elif found and text.startswith(("field ", "park")):
            share = (found[0].clock.now() - BEGIN).total_seconds() / night_s(asked)
            truth = found[0].hardware.truth
            watch.look(share, truth.contacts())
            print(f"{share:6.1%} {text} {watch.looks[-1]}", file=sys.stderr, flush=True)

    end = asyncio.run(carry_out(setup, store, False, progress))
    return NightBook(store, end.night), end, faults


def by_visit(book: NightBook) -> list[dict[str, Any]]:
    """From the record: of each visit what its fibres came to, and how long that took after the shutter."""
    visits, exposures = book.visits(), book.exposures()
    gap_s = shutter_to_ready_s(visits, book.stages(), exposures)
    exposed = {e.visit_id for e in exposures if e.utc_end is not None}
    rows, closed = [], []
    for v in visits:
        closed.append(v)  # with the visits before it that were not exposed
        row: dict[str, Any] = {"visit": v.id, "field": v.field, "state": v.state, "plan": v.plan_from}
        row |= {"on_target": v.on_target, "truly": _truly(book.store, v.run_id), "assigned": v.assigned}
        row["rms_um"] = v.rms_um
        if v.id in gap_s:
            row |= _gap(book, gap_s[v.id], closed)
        rows.append({k: round(x, 2) if isinstance(x, float) else x for k, x in row.items()})
        closed = [] if v.id in exposed else closed
    return rows


def _truly(store: Store, run_id: int | None) -> int | None:
    """Fibres within the requirement in the truth of the twin; None where the visit made no move."""
    if run_id is None:
        return None
    try:
        seen, _ = observation_of(store, info_of_run(store, run_id))
    except InputError:
        return None
    return int(seen.summary()["n_within_requirement"])


def _gap(book: NightBook, bus_s: float, visits: list[VisitRecord]) -> dict[str, float]:
    """What the shutter has waited for in these visits: s of the bus, images, s of this machine."""
    mine = {v.id for v in visits}
    images = sum(images_of(book.store, v.run_id) for v in visits if v.run_id is not None)
    machine_s = sum(s.wall_s for s in book.stages() if s.visit_id in mine and s.name in NOT_HIDDEN)
    whole_s = bus_s + IMAGE_S * images + machine_s
    return dict(zip((*GAP, "shutter_to_ready_s"), (bus_s, images, machine_s, whole_s), strict=True))


def figures(book: NightBook, end: NightEnd) -> dict[str, Any]:
    """From the record: gaps, plans, what is not hidden."""
    visits, rows = book.visits(), by_visit(book)
    return {
        "status": end.status,
        "why": end.why,
        "visits": len(visits),
        "exposures": sum(e.utc_end is not None for e in book.exposures()),
        "planned_ahead": sum(v.plan_from == "ahead" for v in visits),
        "planned_now": {str(v.plan_from): v.id for v in visits if v.plan_from != "ahead"},
        "by_visit": rows,
        **{name: _spread(rows, name) for name in (*GAP, "shutter_to_ready_s")},
        "alarms": [f"{a.severity} {a.subject}: {a.text} ({a.count})" for a in book.alarms()],
    }


def _spread(rows: list[dict[str, Any]], name: str) -> dict[str, float]:
    found = [row[name] for row in rows if name in row]
    if not found:
        return {}
    return {"median": round(median(found), 2), "max": round(max(found), 2), "n": len(found)}


def table(rows: list[dict[str, Any]]) -> str:
    """The same as lines of text; the first names the columns."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = [names] + [[str(row.get(name, "-")) for name in names] for row in rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(word.rjust(width) for word, width in zip(line, widths, strict=True)) for line in lines
    )


def shown(told: dict[str, Any]) -> str:
    """For the screen: tables by visit and by hour, and the rest as JSON."""
    rest = {k: v for k, v in told.items() if k not in ("by_visit", "by_hour")}
    parts = [table(told["by_visit"])] + ([table(told["by_hour"])] if told["by_hour"] else [])
    return "\n\n".join([*parts, json.dumps(rest, indent=1)])


def main() -> int:
    """Runs it; exit code 1 where the shutter waited longer than 90 s, memory grew by more than 50 MB, or arms
    touched."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name, value in (("fields", 12), ("positioners", 500), ("seed", 0), ("faults", 8)):
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--exposure", type=float, default=900.0, help="s")
    parser.add_argument("--hours", type=float, default=0.0, help="of the twin; 0: each field once")
    parser.add_argument("--camera", default="image", choices=("image", "noise"))
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    folder, watch = Path(tempfile.mkdtemp(prefix="fiberloom-night-")), Watch()
    book, end, faults = carried(folder, asked, watch)
    told: dict[str, Any] = {"asked": {k: str(v) for k, v in vars(asked).items()}, "faults": faults}
    told |= figures(book, end) | watch.told()
    told["by_hour"] = watch.by_hour(asked.hours) if asked.hours else []
    told["report"] = write_report(book, folder).stat().st_size
    print(shown(told))
    if asked.out is not None:
        asked.out.write_text(json.dumps(told, indent=1) + "\n")
    late = told["shutter_to_ready_s"].get("max", math.inf) > MOST_S
    grown = told["memory_growth_MB"] > MOST_GROWTH_MB
    return int(end.status != "finished" or late or grown or told["contacts"] > 0)


if __name__ == "__main__":
    sys.exit(main())
