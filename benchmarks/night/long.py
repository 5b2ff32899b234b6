"""`python -m benchmarks.night.long [--fields 12] [--hours 0] [--positioners 500] [--faults 8]`.

A night on the twin with faults that are drawn: how long from shutter closed to fibres on target, what was
planned meanwhile, and whether memory and descriptors stay. With `--hours` the fields come again until dawn.

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
from typing import Any

import numpy as np

import fiberloom as fl
from fiberloom.connect import twin_source
from fiberloom.field import Field
from fiberloom.night.carry import NightEnd, carry_out
from fiberloom.night.figures import shutter_to_ready_s
from fiberloom.night.report import write_report
from fiberloom.night.setup import NightSetup
from fiberloom.operation.known import Learning, known_so_far
from fiberloom.operation.session.session import KnownArray
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.nights.book import NightBook
from fiberloom.targets import random_targets, write_targets

from .killed import images_of

BEGIN = datetime(2026, 11, 25, 18, 0, tzinfo=UTC)
IMAGE_S = 6.5
"""Exposure of 5 s and read-out: what a peer's camera takes [A]."""
KINDS = ("dead", "lying", "dark", "stuck_hall", "mute", "nostart", "refuse", "reboot")
NOT_HIDDEN = ("position: assigning targets", "position: planning: blind")
SETTLED = 0.25
"""Of the night, after which memory is compared."""


@dataclass
class Watch:
    """Memory and descriptors of this process as a night goes on."""

    begun_s: float = field(default_factory=time.monotonic)
    rows: list[tuple[float, float, int]] = field(default_factory=list)
    """Share of the night, resident MB, open descriptors."""

    def look(self, share: float) -> None:
        """Notes both at this `share` of the night."""
        words = Path("/proc/self/statm").read_text().split()
        resident_MB = int(words[1]) * resource.getpagesize() / 1e6
        self.rows.append((round(share, 4), round(resident_MB, 1), len(list(Path("/proc/self/fd").iterdir()))))

    def told(self) -> dict[str, Any]:
        """Growth from a quarter of the night to its end, of the medians of eighths."""
        early = [r for r in self.rows if SETTLED <= r[0] < SETTLED + 0.125] or self.rows[:1]
        late = [r for r in self.rows if r[0] >= self.rows[-1][0] - 0.125]
        return {
            "memory_MB": [median(r[1] for r in part) for part in (early, late)],
            "memory_growth_MB": round(median(r[1] for r in late) - median(r[1] for r in early), 1),
            "descriptors": [median(r[2] for r in part) for part in (early, late)],
            "looks": len(self.rows),
            "wall_s": round(time.monotonic() - self.begun_s),
        }


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
    lines = [f"begin = {BEGIN:%Y-%m-%dT%H:%M:%SZ}", f"dawn = {dawn:%Y-%m-%dT%H:%M:%SZ}", "attempts = 20"]
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
            share = (found[0].clock.now() - BEGIN).total_seconds() / night_s(asked)
            watch.look(share)
            print(f"{share:6.1%} {text} {watch.rows[-1]}", file=sys.stderr, flush=True)

    end = asyncio.run(carry_out(setup, store, False, progress))
    return NightBook(store, end.night), end, faults


def figures(book: NightBook, end: NightEnd) -> dict[str, Any]:
    """From the record: gaps, plans, what is not hidden."""
    visits, stages = book.visits(), book.stages()
    gap_s = shutter_to_ready_s(visits, stages, book.exposures())
    closed_s = {v: sum(s.wall_s for s in stages if s.visit_id == v and s.name in NOT_HIDDEN) for v in gap_s}
    runs = {v.id: v.run_id for v in visits}
    images = {v: images_of(book.store, runs[v]) for v in gap_s if runs[v] is not None}
    whole_s = {v: gap_s[v] + IMAGE_S * images[v] + closed_s[v] for v in images}
    return {
        "status": end.status,
        "why": end.why,
        "visits": len(visits),
        "exposures": sum(e.utc_end is not None for e in book.exposures()),
        "planned_ahead": sum(v.plan_from == "ahead" for v in visits),
        "planned_now": {str(v.plan_from): v.id for v in visits if v.plan_from != "ahead"},
        "on_target": [v.on_target for v in visits],
        "assigned": [v.assigned for v in visits],
        "bus_s": _spread(gap_s.values()),
        "images": _spread(images.values()),
        "not_hidden_machine_s": _spread(closed_s.values()),
        "shutter_to_ready_s": _spread(whole_s.values()),
        "alarms": [f"{a.severity} {a.subject}: {a.text} ({a.count})" for a in book.alarms()],
    }


def _spread(values: Any) -> dict[str, float]:
    found = list(values)
    if not found:
        return {}
    return {"median": round(median(found), 2), "max": round(max(found), 2), "n": len(found)}


def main() -> int:
    """Runs it; exit code 1 where the shutter waited longer than 90 s, or memory grew by more than 50 MB."""
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
    told = {"asked": {k: str(v) for k, v in vars(asked).items()}, "faults": faults}
    told |= figures(book, end) | watch.told()
    told["report"] = write_report(book, folder).stat().st_size
    text = json.dumps(told, indent=1)
    print(text)
    if asked.out is not None:
        asked.out.write_text(text + "\n")
    late = told["shutter_to_ready_s"].get("max", 0.0) > 90.0
    return int(end.status != "finished" or late or told["memory_growth_MB"] > 50.0)


if __name__ == "__main__":
    sys.exit(main())
