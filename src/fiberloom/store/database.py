"""Opening a store, and reading what is in it."""

from __future__ import annotations

import sqlite3
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import Connection, Engine, Table, func, insert, inspect, select
from sqlalchemy.exc import DatabaseError, IntegrityError, OperationalError, SQLAlchemyError

from fiberloom.errors import InputError, one_line
from fiberloom.store.engines import file_engine, reading_engine, url_engine
from fiberloom.store.find import existing
from fiberloom.store.parts import RunPart, unpack
from fiberloom.store.place import BESIDE
from fiberloom.store.run import Run, RunInfo, info_of, new_run_values
from fiberloom.store.schema import (
    CALIBRATIONS,
    EVENTS,
    MEASUREMENTS,
    MOVES,
    PARTS,
    RUNS,
    SCHEMA,
    SCHEMA_VERSION,
    SUM,
    TABLES,
)
from fiberloom.store.sums import DamagedError, change, checked, put_one
from fiberloom.typing import Array

Columns = dict[str, Array]


_TRIES = 20
_JUST_MADE = ("already exists", "duplicate column")
_MOMENT_S = 0.05
"""While another process makes the tables of the same new store."""


class Store:
    """A database of runs. What is recorded is committed before the call returns."""

    def __init__(self, engine: Engine, name: str) -> None:
        self._engine = engine
        self.name = name

    @classmethod
    def open(cls, path_or_url: str | Path, *, create: bool = True) -> Store:
        """Opens (and if need be makes) a store: the path of an SQLite file, or a database URL.

        Every obstacle is an InputError: no permission, a full disk, a file
        that is something else, tables of another version, and with `create=False` no store there.
        """
        name = str(path_or_url)
        if not create:
            existing(name)
        return cls(url_engine(name) if "://" in name else file_engine(Path(name)), name)._ready(_prepare)

    @classmethod
    def read(cls, path_or_url: str | Path) -> Store:
        """Opens a store only to read it: also on media that cannot be written, and on a full disk.

        What is recorded raises an InputError, as does what `open` objects to. A database of a URL is
        opened as by `open`.
        """
        name = str(path_or_url)
        if "://" in name:
            return cls.open(name, create=False)
        return cls(reading_engine(Path(existing(name))), name)._ready(_look)

    def _ready(self, prepare: Callable[[Connection, str], None]) -> Store:
        try:
            self._prepare(prepare)
        except BaseException:
            self.close()
            raise
        return self

    def _prepare(self, prepare: Callable[[Connection, str], None]) -> None:
        for _ in range(_TRIES):
            try:
                with self._engine.begin() as connection:
                    return prepare(connection, self.name)
            except InputError:
                raise
            except (sqlite3.Error, ValueError, TypeError) as error:
                raise _damaged(self.name, error) from None
            except (IntegrityError, OperationalError) as error:
                # another process makes the tables in the same moment: soon they are there
                if isinstance(error, OperationalError) and not any(w in str(error.orig) for w in _JUST_MADE):
                    raise _readable(self.name, error) from None
                time.sleep(_MOMENT_S)
            except SQLAlchemyError as error:
                raise _readable(self.name, error) from None
        raise InputError(f"store '{self.name}': another process does not finish making its tables; try again")

    def close(self) -> None:
        """Lets go of the database."""
        self._engine.dispose()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @contextmanager
    def transaction(self) -> Iterator[Connection]:
        """One transaction; what the database objects to becomes an InputError."""
        try:
            with self._engine.begin() as connection:
                yield connection
        except SQLAlchemyError as error:
            raise _readable(self.name, error) from None
        except InputError:
            raise
        except (sqlite3.Error, ValueError, TypeError, OverflowError) as error:
            raise _damaged(self.name, error) from None

    def start_run(
        self,
        *,
        command_line: str,
        instrument: str,
        config_hash: str = "",
        seed: int | None = None,
        note: str = "",
        folder: str = BESIDE,
    ) -> Run:
        """Begins a run: a context manager that records how it ended.

        `command_line`: what the operator typed; `instrument` and `config_hash` of the layout; `seed` of
        the twin; `note`: free text; `folder`: of its files, from that of the store; `{run}` in it is its
        number.
        """
        values = new_run_values(command_line, instrument, config_hash, seed, note)
        with self.transaction() as connection:
            run_id = put_one(connection, RUNS, values)
            change(connection, RUNS, RUNS.c.id == run_id, {"folder": folder.format(run=run_id)})
        return Run(self.transaction, run_id)

    def runs(self, recorded_as: str | None = None) -> list[RunInfo]:
        """All runs, oldest first, or those `recorded_as` running, finished, failed or interrupted.

        One whose process is gone shows as interrupted.
        """
        # 0: where it began, and where each was left
        of_run = (MOVES.c.run_id == RUNS.c.id) & (MOVES.c.number > 0)
        moves = select(func.count()).where(of_run).scalar_subquery()
        measured = select(func.count()).where(MEASUREMENTS.c.run_id == RUNS.c.id).scalar_subquery()
        query = select(RUNS.c.id, moves.label("n_moves"), measured.label("n_measurements"))
        if recorded_as is not None:  # a store has many others, whose rows need not be counted
            query = query.where(RUNS.c.status == recorded_as)
        with self.transaction() as connection:
            rows = checked(connection, RUNS)
            counts = {row["id"]: row for row in connection.execute(query).mappings()}
            # another process may have changed a status in between
            chosen = [row for row in rows if recorded_as in (None, row["status"]) and row["id"] in counts]
            return [info_of({**row, **counts[row["id"]]}) for row in chosen]

    def last_run(self) -> Run:
        """The run that began last, to record more of it."""
        with self.transaction() as connection:
            run_id = connection.execute(select(func.max(RUNS.c.id))).scalar()
        if run_id is None:
            raise InputError(f"{self.name}: no run in it")
        return Run(self.transaction, run_id)

    def calibrated(self, run_id: int) -> dict[str, int]:
        """Positioners by kind of calibration that a run made or used."""
        count = func.count(CALIBRATIONS.c.positioner_id.distinct())
        query = select(CALIBRATIONS.c.kind, count).where(CALIBRATIONS.c.run_id == run_id)
        with self.transaction() as connection:
            return {str(kind): int(n) for kind, n in connection.execute(query.group_by(CALIBRATIONS.c.kind))}

    def measurements(self, run_id: int) -> Columns:
        """Columns of a run's measurements in the order in which they were made.

        `move` and `kind` are those of the move; numbers that are not known are NaN, texts empty.
        """
        with self._run(run_id) as connection:
            moves = {row["id"]: row for row in _rows_of(connection, MOVES, run_id)}
            rows = _rows_of(connection, MEASUREMENTS, run_id)
            _check_complete(moves, rows)
            of = [moves[row["move_id"]] for row in rows]
            head = {name: _column([move[key] for move in of]) for name, key in _OF_MOVE.items()}
            return head | _columns(MEASUREMENTS, rows)

    def moves(self, run_id: int) -> Columns:
        """Columns of a run's moves."""
        return self._table(run_id, MOVES)

    def events(self, run_id: int) -> Columns:
        """Columns of a run's events."""
        return self._table(run_id, EVENTS)

    def calibrations(self, run_id: int) -> Columns:
        """Columns of the calibrations that a run made or used."""
        return self._table(run_id, CALIBRATIONS)

    def parts(self, run_id: int) -> tuple[dict[str, RunPart], dict[int, RunPart]]:
        """What else the result files of a run need: of the whole run by name, of its moves by their id."""
        with self._run(run_id) as connection:
            rows = _rows_of(connection, PARTS, run_id)
        whole = {row["name"]: unpack(row["data"]) for row in rows if row["move_id"] is None}
        return whole, {row["move_id"]: unpack(row["data"]) for row in rows if row["move_id"] is not None}

    def parts_named(self, name: str) -> dict[int, RunPart]:
        """The parts of whole runs that have a name, by the run's number."""
        with self.transaction() as connection:
            rows = checked(connection, PARTS, (PARTS.c.name == name) & PARTS.c.move_id.is_(None))
        return {row["run_id"]: unpack(row["data"]) for row in rows}

    def _table(self, run_id: int, table: Table) -> Columns:
        with self._run(run_id) as connection:
            return _columns(table, _rows_of(connection, table, run_id))

    @contextmanager
    def _run(self, run_id: int) -> Iterator[Connection]:
        with self.transaction() as connection:
            if connection.execute(select(RUNS.c.id).where(RUNS.c.id == run_id)).first() is None:
                raise InputError(f"{self.name}: no run {run_id}; 'fiberloom runs' lists them")
            yield connection


_OF_MOVE = {"move": "number", "kind": "kind"}
"""Columns of measurements that are those of the move."""


def _rows_of(connection: Connection, table: Table, run_id: int) -> Sequence[Mapping[Any, Any]]:
    """All rows of a run, compared with their sums."""
    return checked(connection, table, table.c.run_id == run_id)


def _check_complete(moves: Mapping[int, Mapping[Any, Any]], rows: Sequence[Mapping[Any, Any]]) -> None:
    """Raises DamagedError where a move or some of its measurements are gone."""
    there = Counter(row["move_id"] for row in rows)
    if lost := set(there) - set(moves):
        raise DamagedError(f"move {min(lost)} is gone, its measurements are there")
    for number, move in moves.items():
        if move["n_measured"] is not None and move["n_measured"] != there[number]:
            raise DamagedError(f"move {number} has {there[number]} measurements of {move['n_measured']}")


def _columns(table: Table, rows: Sequence[Mapping[Any, Any]]) -> Columns:
    names = [c.name for c in table.columns if c.name not in (SUM, "n_measured")]
    return {name: _column([row[name] for row in rows]) for name in names}


def _column(values: list[Any]) -> Array:
    """None becomes NaN among numbers and empty among texts."""
    known = next((v for v in values if v is not None), None)
    if isinstance(known, str):
        return np.array([v or "" for v in values], dtype=str)
    if known is None or isinstance(known, float) or None in values:
        return np.array([np.nan if v is None else v for v in values], dtype=np.float64)
    return np.array(values)


def _prepare(connection: Connection, name: str) -> None:
    """Makes the tables of a new store; refuses those of another version."""
    TABLES.create_all(connection, tables=[SCHEMA])
    found = connection.execute(select(SCHEMA.c.version)).scalar()
    if found is None:
        TABLES.create_all(connection)
        connection.execute(insert(SCHEMA), {"version": SCHEMA_VERSION})
    else:
        _check_version(found, name)
        if found < SCHEMA_VERSION:
            raise InputError(
                f"store '{name}': its tables are of version {found}, this program writes {SCHEMA_VERSION}; "
                f"bring it up to date with 'fiberloom store upgrade {name}', which keeps a copy"
            )


def _look(connection: Connection, name: str) -> None:
    """Refuses what is no store, or one of a newer version; writes nothing."""
    if not inspect(connection).has_table(SCHEMA.name):
        raise InputError(f"store '{name}': has no tables of fiberloom; name the store of an earlier run")
    _check_version(connection.execute(select(SCHEMA.c.version)).scalar() or 0, name)


def _check_version(found: int, name: str) -> None:
    if found > SCHEMA_VERSION:
        raise InputError(
            f"store '{name}': its tables are of version {found}, this program writes "
            f"{SCHEMA_VERSION}; name another store"
        )


_ADVICE = {
    "readonly": "cannot be written; check the permissions or name another store",
    "unable to open": "cannot be opened; check the path and its permissions",
    "disk is full": "the disk is full; what was recorded before is safe",
    "disk I/O": "the disk does not work as it should; what was recorded before may be damaged",
    "not a database": "is not a database; name another file",
    "malformed": "is damaged; recover what can be read with 'sqlite3 FILE .recover'",
    "locked": "another process holds it; try again when that has ended",
}


def _damaged(name: str, error: Exception) -> InputError:
    return InputError(
        f"store '{name}': is damaged: {one_line(error)}; take a copy of it from before, or what "
        "'sqlite3 FILE .recover' can read"
    )


def _readable(name: str, error: SQLAlchemyError) -> InputError:
    cause = str(error.orig if isinstance(error, DatabaseError) and error.orig else error)
    first = cause.strip().splitlines()[0]
    for sign, advice in _ADVICE.items():
        if sign in first:
            return InputError(f"store '{name}': {advice} ({first})")
    return InputError(f"store '{name}': {first}")
