"""A campaign on Dask workers of this machine: unit-cycles an hour and worker, beside one process. JSON out.

    python benchmarks/campaigns/workers.py [--positioners 16] [--cycles 8] [--workers 1 2] [--out FILE]

The lifetime test of Fig. 21: a cycle of a unit is an automatic calibration and 1220 targets of ten moves.
The first row is this process alone, without a scheduler. Wall time is what users wait, and means something on
a machine without other work; the start of the workers is not in it. The CPU seconds are the caller's: its own
computation in the first row, scheduler and results in the others. All rows are compared to the byte.
"""

import argparse
import json
import os
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.studies.campaign import run
from fiberloom.studies.lifetime import LifetimeSettings
from fiberloom.studies.lifetime_results import lifetime_campaign
from fiberloom.version import __version__


def main() -> None:
    """Run what the command line asks for."""
    asked = arguments()
    study = lifetime_campaign(asked.positioners, 0, LifetimeSettings(cycles=asked.cycles))
    unit_cycles = asked.positioners * asked.cycles
    rows, alone = [], None
    for workers in (0, *asked.workers):
        with workers_of_dask(workers) as scheduler:
            wall_s, cpu_s = time.perf_counter(), own_cpu_s()
            made = run(study, scheduler=scheduler)
            wall_s, cpu_s = time.perf_counter() - wall_s, own_cpu_s() - cpu_s
        alone = alone or made
        rows.append(row(workers, wall_s, unit_cycles) | {"same": same(made, alone), "callers_cpu_s": cpu_s})
    report = {"version": __version__, "load": os.getloadavg()[0], "unit_cycles": unit_cycles, "rows": rows}
    print("\n".join(table(report)))
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    asked.out.write_text(json.dumps(report, indent=1) + "\n")
    if not all(r["same"] for r in rows):
        raise SystemExit("rows differ from those of one process")


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--positioners", type=int, default=16)
    parser.add_argument("--cycles", type=int, default=8)
    parser.add_argument("--workers", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--out", type=Path, default=Path("build/bench/workers.json"))
    return parser.parse_args()


@contextmanager
def workers_of_dask(number: int) -> Iterator[str | None]:
    """The address of a scheduler with so many workers of one thread; None for no worker at all."""
    if number == 0:
        yield None
        return
    from distributed import LocalCluster

    how = {"n_workers": number, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(**how) as cluster:  # type: ignore[no-untyped-call]
        yield cluster.scheduler_address


def own_cpu_s() -> float:
    """CPU seconds of this process so far."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def same(made: dict[str, np.ndarray], alone: dict[str, np.ndarray]) -> bool:
    """Whether two results are the same, to the byte."""
    return {k: v.tobytes() for k, v in made.items()} == {k: v.tobytes() for k, v in alone.items()}


def row(workers: int, wall_s: float, unit_cycles: int) -> dict[str, Any]:
    """What so many workers make in an hour."""
    rate = 3600.0 * unit_cycles / wall_s
    return {"workers": workers, "wall_s": wall_s, "an_hour_and_worker": rate / max(workers, 1)}


def table(report: dict[str, Any]) -> list[str]:
    """Markdown."""
    alone = report["rows"][0]["an_hour_and_worker"]
    out = [
        f"{report['unit_cycles']} unit-cycles of the lifetime test, load {report['load']:.1f}",
        "| workers | wall s | unit-cycles an hour and worker | of one process | caller's CPU s | same rows |",
        "|--:|--:|--:|--:|--:|---|",
    ]
    for r in report["rows"]:
        name, rate = r["workers"] or "none, this process", r["an_hour_and_worker"]
        out.append(
            f"| {name} | {r['wall_s']:.1f} | {rate:.0f} | {rate / alone:.2f} | {r['callers_cpu_s']:.1f} "
            f"| {'yes' if r['same'] else 'NO'} |"
        )
    return out


if __name__ == "__main__":
    main()
