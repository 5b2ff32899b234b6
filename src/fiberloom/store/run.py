"""One run as it is being recorded."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import UTC, datetime
from types import TracebackType
from typing import Any

import numpy as np
from sqlalchemy import Connection

from fiberloom.errors import InputError
from fiberloom.store.process import host_name, is_alive, process_start
from fiberloom.store.schema import CALIBRATIONS, EVENTS, MEASUREMENTS, MOVES, PARTS, RUNS, SUM
from fiberloom.store.sums import DamagedError, as_utc, change, put, put_one
from fiberloom.timing import part
from fiberloom.version import __version__

RUNNING, FINISHED, FAILED, INTERRUPTED = "running", "finished", "failed", "interrupted"

MEASURED = frozenset(c.name for c in MEASUREMENTS.columns if c.name not in ("id", "run_id", "move_id", SUM))
"""What can be recorded of a positioner after a move."""

Transaction = Callable[[], AbstractContextManager[Connection]]


START = "start"
"""Kind of the record that a run begins with: the place of every positioner, before anything moved."""

STOPPED = "stopped"
"""Kind of the record where positioners were left after a stop: as reported, without an image."""


CUT_SHORT = "cut short"
"""Kind of the event after a move in which not all have reached their goals."""

OF_MOVE = "move"
"""Name of the part of a move."""


@dataclass(frozen=True)
class RunInfo:
    """A run as `fiberloom runs` shows it."""

    id: int
    utc_start: datetime
    utc_end: datetime | None
    command_line: str
    instrument: str
    config_hash: str
    seed: int | None
    version: str
    status: str
    note: str
    host: str
    folder: str | None
    """Of its files, from that of the store; None: of a version that did not note it."""
    n_moves: int
    """Without the records of where it began and of where each was left."""
    n_measurements: int


def new_run_values(
    command_line: str, instrument: str, config_hash: str, seed: int | None, note: str
) -> dict[str, Any]:
    """The row of a run that starts now, in this process.

    `command_line`: what the operator typed; `instrument` and `config_hash` of the layout; `seed` of the
    twin; `note`: free text.
    """
    return {
        "utc_start": datetime.now(UTC),
        "command_line": command_line,
        "instrument": instrument,
        "config_hash": config_hash,
        "seed": seed,
        "version": __version__,
        "status": RUNNING,
        "note": note,
        "host": host_name(),
        "pid": os.getpid(),
        "process_start": process_start(os.getpid()),
    }


def info_of(row: Mapping[str, Any]) -> RunInfo:
    """The run of a row, with its status as it is now."""
    values = {name: row[name] for name in RunInfo.__dataclass_fields__}
    if values["utc_start"] is None:
        raise DamagedError(f"run {row['id']} has no time at which it began")
    for name in ("utc_start", "utc_end"):
        if values[name] is not None:
            values[name] = as_utc(values[name])
    if row["status"] == RUNNING and not is_alive(row["host"], row["pid"], row["process_start"]):
        values["status"] = INTERRUPTED
    return RunInfo(**values)


class Run:
    """Records one run; as a context manager it books how the run ended.

    Every record call is one transaction, with the operating system when the call returns: a process
    that is killed afterwards loses nothing. (A power cut may take the last ones, never more.)
    """

    def __init__(self, transaction: Transaction, run_id: int) -> None:
        self._transaction = transaction
        self.id = run_id

    def __enter__(self) -> Run:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.end(FINISHED)
            return
        by_hand = issubclass(kind, (KeyboardInterrupt, SystemExit)) or (kind.__name__ == "CancelledError")
        # where the store itself failed, the first error is the one to tell
        with contextlib.suppress(InputError):
            self.end(INTERRUPTED if by_hand else FAILED, f"{kind.__name__}: {error}")

    def end(self, status: str, note: str = "") -> None:
        """Books the end; `note` is kept where there is one to tell."""
        values: dict[str, Any] = {"status": status, "utc_end": datetime.now(UTC)}
        if note:
            values["note"] = note
        with self._transaction() as connection:
            change(connection, RUNS, RUNS.c.id == self.id, values)

    @part("store")
    def record_move(
        self,
        number: int,
        kind: str,
        measured: Mapping[str, Any] | None = None,
        *,
        time_s: float | None = None,
        plan_digest: str = "",
        part: bytes | None = None,
    ) -> int:
        """A move and what was measured after it; returns the move's id.

        `number` from 1 (0: before the first); `kind`: start, blind, correction, ...; `measured` holds
        columns (MEASURED names them), one row per positioner; a column that is one value is the same
        for all. NaN is stored as unknown. `time_s`: on the clock of the bus; `plan_digest`: of the
        trajectories; `part`: what else the result files need of it, as of `store.parts.pack`.
        """
        rows = _rows(measured or {}, {"run_id": self.id})
        move = {
            "run_id": self.id,
            "number": number,
            "kind": kind,
            "utc": datetime.now(UTC),
            "time_s": time_s,
            "plan_digest": plan_digest,
            "n_measured": len(rows),
        }
        with self._transaction() as connection:
            move_id = put_one(connection, MOVES, move)
            put(connection, MEASUREMENTS, [{**row, "move_id": move_id} for row in rows])
            if part is not None:
                values = {"run_id": self.id, "move_id": move_id, "name": OF_MOVE, "data": part}
                put(connection, PARTS, [values])
        return move_id

    @part("store")
    def record_part(self, name: str, data: bytes) -> None:
        """Something of the whole run that its result files need, as of `store.parts.pack`; of two with one
        `name` the later counts.
        """
        with self._transaction() as connection:
            put(connection, PARTS, [{"run_id": self.id, "name": name, "data": data}])

    @part("store")
    def record_event(
        self,
        kind: str,
        text: str,
        *,
        positioner_id: int | None = None,
        time_s: float | None = None,
    ) -> None:
        """Something an operator wants to know later: its `kind`, a `text`, the `positioner_id` where
        there is one, and `time_s` on the clock of the bus.
        """
        values = {
            "run_id": self.id,
            "utc": datetime.now(UTC),
            "time_s": time_s,
            "positioner_id": None if positioner_id is None else int(positioner_id),
            "kind": kind,
            "text": text,
        }
        with self._transaction() as connection:
            put(connection, EVENTS, [values])

    @part("store")
    def record_calibration(
        self, positioner_id: Iterable[int], axis: str, kind: str, file: str, hash: str
    ) -> None:
        """Which calibration file these positioners' axis got or used.

        `positioner_id`: their numbers; `axis`: alpha or beta; `kind`: transmission, arms, ...; `file`
        and its `hash`.
        """
        common = {"run_id": self.id, "axis": axis, "kind": kind, "file": file, "hash": hash}
        rows = [{**common, "utc": datetime.now(UTC), "positioner_id": int(p)} for p in positioner_id]
        if rows:
            with self._transaction() as connection:
                put(connection, CALIBRATIONS, rows)


def _rows(measured: Mapping[str, Any], common: dict[str, Any]) -> list[dict[str, Any]]:
    """Columns to rows of plain Python values."""
    if not measured:
        return []
    unknown = set(measured) - MEASURED
    if unknown:
        raise ValueError(f"measurements have no column {sorted(unknown)}; known: {sorted(MEASURED)}")
    columns = {"seen": True, **measured}
    n = len(np.atleast_1d(columns["positioner_id"]))
    plain = {name: _plain(values, n) for name, values in columns.items()}
    missing = dict.fromkeys(MEASURED - set(plain))
    names = list(plain)
    return [
        {**common, **missing, **dict(zip(names, row, strict=True))}
        for row in zip(*plain.values(), strict=True)
    ]


def _plain(values: Any, n: int) -> list[Any]:
    array = np.broadcast_to(np.asarray(values), (n,))
    if array.dtype.kind == "f":
        return [v if v == v else None for v in array.tolist()]
    if array.dtype.kind == "O":
        return [None if v is None or v != v else str(v) for v in array.tolist()]
    plain: list[Any] = array.tolist()
    return plain
