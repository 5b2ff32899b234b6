"""Rows of Table 1 in processes of their own, kept on disk.

What one has held goes back with it, one that fails leaves the others, and one that is there by the same code
is not made again.
"""

from __future__ import annotations

import json
import multiprocessing
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from fiberloom.errors import one_line
from fiberloom.studies.paper.focal_plane.table01_field import InstrumentRun, observe
from fiberloom.studies.paper.focal_plane.table01_rows import TABLE_1, Row
from fiberloom.version import code_digest
from fiberloom.wholefile import whole


@dataclass(frozen=True)
class RowRuns:
    """Where rows are made and kept."""

    folder: Path
    fresh: bool = False
    """Make those anew that are there."""

    def made(self, row: Row, seed: int, n_units: int | None) -> InstrumentRun | str:
        """The run of a `row` by `seed` with `n_units` (None: all), or in words why there is none."""
        file = self.folder / f"table1-{row.key}-{seed}-{n_units or 'all'}.json"
        kept = None if self.fresh else _read(file)
        if kept is not None:
            return kept
        found = _in_a_process(row, seed, n_units)
        if isinstance(found, InstrumentRun):
            with whole(file, folders=True) as part:
                part.write_text(json.dumps({"code": code_digest()} | _plain(found)), encoding="utf-8")
        return found


def _plain(run: InstrumentRun) -> dict[str, object]:
    further = None if run.further_um is None else run.further_um.tolist()
    return vars(run) | {"error_um": [e.tolist() for e in run.error_um], "further_um": further}


def _read(file: Path) -> InstrumentRun | None:
    """A run that was kept by this code; None where there is none, or the file is damaged."""
    try:
        kept = json.loads(file.read_text(encoding="utf-8"))
        if kept.pop("code") != code_digest():
            return None
        further = kept.pop("further_um")
        errors_um = [np.array(e) for e in kept.pop("error_um")]
        return InstrumentRun(
            error_um=errors_um, further_um=None if further is None else np.array(further), **kept
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _in_a_process(row: Row, seed: int, n_units: int | None) -> InstrumentRun | str:
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe(duplex=False)
    process = spawn.Process(target=_observe, args=(theirs, row.key, seed, n_units), daemon=True)
    process.start()
    theirs.close()
    try:
        found: InstrumentRun | str = ours.recv()
    except EOFError:
        process.join()
        found = f"its process ended with code {process.exitcode}; -9 is lack of memory most of the time"
    finally:
        if process.is_alive():
            process.join(1.0)
            process.terminate()
        process.join()
    return found


def _observe(told: Connection, key: str, seed: int, n_units: int | None) -> None:
    """In its own process."""
    row = next(row for row in TABLE_1 if row.key == key)
    try:
        told.send(observe(row, seed, n_units))
    except KeyboardInterrupt:
        return
    except Exception as error:  # the other rows go on
        told.send(f"{type(error).__name__}: {one_line(error)}")
