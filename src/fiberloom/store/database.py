"""Opening a store, and reading what is in it."""

from __future__ import annotations

import sqlite3
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import Connection, Engine, create_engine, event, func, insert, inspect, select, update
from sqlalchemy.exc import ArgumentError, DatabaseError, IntegrityError, OperationalError, SQLAlchemyError

from fiberloom.errors import InputError, one_line
from fiberloom.store.run import Run, RunInfo, info_of, new_run_values
from fiberloom.store.schema import (
    SCHEMA_VERSION,
    Base,
    CalibrationRow,
    EventRow,
    MeasurementRow,
    MoveRow,
    RunRow,
    SchemaRow,
)
from fiberloom.store.sums import SUM, DamagedError, check
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
        engine = _url_engine(name) if "://" in name else _file_engine(Path(name), create)
        store = cls(engine, name)
        try:
            store._prepare()
        except BaseException:
            store.close()
            raise
        return store

    def _prepare(self) -> None:
        for _ in range(_TRIES):
            try:
                with self._engine.begin() as connection:
                    return _prepare(connection, self.name)
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
    ) -> Run:
        """Begins a run: a context manager that records how it ended.

        `command_line`: what the operator typed; `instrument` and `config_hash` of the layout; `seed` of
        the twin; `note`: free text.
        """
        values = new_run_values(command_line, instrument, config_hash, seed, note)
        with self.transaction() as connection:
            run_id = connection.execute(insert(RunRow).returning(RunRow.id), values).scalar_one()
        return Run(self.transaction, run_id)

    def runs(self, recorded_as: str | None = None) -> list[RunInfo]:
        """All runs, oldest first, or those `recorded_as` running, finished, failed or interrupted.

        One whose process is gone shows as interrupted.
        """
        moves = select(func.count()).where(MoveRow.run_id == RunRow.id).scalar_subquery()
        measured = select(func.count()).where(MeasurementRow.run_id == RunRow.id).scalar_subquery()
        query = select(RunRow.__table__, moves.label("n_moves"), measured.label("n_measurements"))
        if recorded_as is not None:
            query = query.where(RunRow.status == recorded_as)
        with self.transaction() as connection:
            rows = connection.execute(query.order_by(RunRow.id)).mappings().all()
            return [info_of(dict(row)) for row in rows]

    def last_run(self) -> Run:
        """The run that began last, to record more of it."""
        with self.transaction() as connection:
            run_id = connection.execute(select(func.max(RunRow.id))).scalar()
        if run_id is None:
            raise InputError(f"{self.name}: no run in it")
        return Run(self.transaction, run_id)

    def calibrated(self, run_id: int) -> dict[str, int]:
        """Positioners by kind of calibration that a run made or used."""
        count = func.count(CalibrationRow.positioner_id.distinct())
        query = select(CalibrationRow.kind, count).where(CalibrationRow.run_id == run_id)
        with self.transaction() as connection:
            return {str(kind): int(n) for kind, n in connection.execute(query.group_by(CalibrationRow.kind))}

    def measurements(self, run_id: int) -> Columns:
        """Columns of a run's measurements in the order in which they were made.

        `move` and `kind` are those of the move; numbers that are not known are NaN, texts empty.
        """
        with self._run(run_id) as connection:
            moves = {row["id"]: row for row in _rows_of(connection, MoveRow, run_id)}
            rows = _rows_of(connection, MeasurementRow, run_id)
            _check_complete(moves, rows)
            of = [moves[row["move_id"]] for row in rows]
            head = {name: _column([move[key] for move in of]) for name, key in _OF_MOVE.items()}
            return head | _columns(MeasurementRow, rows)

    def moves(self, run_id: int) -> Columns:
        """Columns of a run's moves."""
        return self._table(run_id, MoveRow)

    def events(self, run_id: int) -> Columns:
        """Columns of a run's events."""
        return self._table(run_id, EventRow)

    def calibrations(self, run_id: int) -> Columns:
        """Columns of the calibrations that a run made or used."""
        return self._table(run_id, CalibrationRow)

    def _table(self, run_id: int, table: type[Base]) -> Columns:
        with self._run(run_id) as connection:
            return _columns(table, _rows_of(connection, table, run_id))

    @contextmanager
    def _run(self, run_id: int) -> Iterator[Connection]:
        with self.transaction() as connection:
            if connection.execute(select(RunRow.id).where(RunRow.id == run_id)).first() is None:
                raise InputError(f"{self.name}: no run {run_id}; 'fiberloom runs' lists them")
            yield connection


_OF_MOVE = {"move": "number", "kind": "kind"}
"""Columns of measurements that are those of the move."""


def _rows_of(connection: Connection, table: type[Base], run_id: int) -> Sequence[Mapping[Any, Any]]:
    """All rows of a run, compared with their sums."""
    columns = table.__table__.columns
    query = select(*columns).where(columns.run_id == run_id).order_by(columns.id)
    rows = connection.execute(query).mappings().all()
    check(table, rows)
    return rows


def _check_complete(moves: Mapping[int, Mapping[Any, Any]], rows: Sequence[Mapping[Any, Any]]) -> None:
    """Raises DamagedError where a move or some of its measurements are gone."""
    there = Counter(row["move_id"] for row in rows)
    if lost := set(there) - set(moves):
        raise DamagedError(f"move {min(lost)} is gone, its measurements are there")
    for number, move in moves.items():
        if move["n_measured"] is not None and move["n_measured"] != there[number]:
            raise DamagedError(f"move {number} has {there[number]} measurements of {move['n_measured']}")


def _columns(table: type[Base], rows: Sequence[Mapping[Any, Any]]) -> Columns:
    names = [c.name for c in table.__table__.columns if c.name not in (SUM, "n_measured")]
    return {name: _column([row[name] for row in rows]) for name in names}


def _column(values: list[Any]) -> Array:
    """None becomes NaN among numbers and empty among texts."""
    known = next((v for v in values if v is not None), None)
    if isinstance(known, str):
        return np.array([v or "" for v in values], dtype=str)
    if known is None or isinstance(known, float) or None in values:
        return np.array([np.nan if v is None else v for v in values], dtype=np.float64)
    return np.array(values)


def _url_engine(url: str) -> Engine:
    try:
        return create_engine(url, pool_pre_ping=True)
    except (ArgumentError, ImportError) as error:
        raise InputError(f"store '{url}': {str(error).splitlines()[0]}") from None


def _file_engine(path: Path, create: bool) -> Engine:
    if path.is_dir():
        raise InputError(f"store '{path}': is a directory; name a file in it")
    if not create and not path.exists():
        raise InputError(f"store '{path}': no such file; name the store of an earlier run")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"store '{path}': {error.strerror}; choose another place") from None
    engine = create_engine(f"sqlite:///{path}")

    @event.listens_for(engine, "connect")
    def settings(connection: sqlite3.Connection, record: object) -> None:
        for pragma in ("journal_mode=WAL", "synchronous=NORMAL", "foreign_keys=ON"):
            connection.execute(f"PRAGMA {pragma}")
        connection.execute("PRAGMA busy_timeout=10000")

    return engine


def _prepare(connection: Connection, name: str) -> None:
    """Makes the tables that are missing; refuses those of a newer version."""
    Base.metadata.create_all(connection, tables=[Base.metadata.tables[SchemaRow.__tablename__]])
    found = connection.execute(select(SchemaRow.version)).scalar()
    if found is None:
        Base.metadata.create_all(connection)
        connection.execute(insert(SchemaRow), {"version": SCHEMA_VERSION})
    elif found < SCHEMA_VERSION:
        # newer versions only add tables and columns that may be empty: what is there stays as it is
        Base.metadata.create_all(connection)
        _add_columns(connection)
        connection.execute(update(SchemaRow).values(version=SCHEMA_VERSION))
    elif found != SCHEMA_VERSION:
        raise InputError(
            f"store '{name}': its tables are of version {found}, this program writes "
            f"{SCHEMA_VERSION}; name another store"
        )


def _add_columns(connection: Connection) -> None:
    there = inspect(connection)
    for table in Base.metadata.sorted_tables:
        known = {column["name"] for column in there.get_columns(table.name)}
        for column in table.columns:
            if column.name not in known:
                kind = column.type.compile(connection.dialect)
                connection.exec_driver_sql(f"ALTER TABLE {table.name} ADD COLUMN {column.name} {kind}")


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
