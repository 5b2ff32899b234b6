"""The sum of a row: written with it, compared when it is read.

SQLite has none of its own: a bit that flips on a disk or in a copy changes a number and nothing else. The
sum is the CRC-32 of all columns but the database's own number of the row.
"""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from functools import cache
from typing import Any, TypeVar

from sqlalchemy import Connection, Table, and_, insert, select, update
from sqlalchemy.exc import SQLAlchemyError

from fiberloom.store.schema import PLACES, SUM

_LEFT_OUT = {PLACES.name: {"datum"}}
"""Columns that sums did not cover when stores of today began to be written; such a sum is right still."""

Row = Mapping[Any, Any]
Record = TypeVar("Record")


class DamagedError(ValueError):
    """What the store holds is not what was written."""


def as_utc(when: datetime) -> datetime:
    """A time as a database gives it: SQLite forgets the zone, which is UTC; others tell one."""
    return when.replace(tzinfo=UTC) if when.tzinfo is None else when.astimezone(UTC)


def record_of(kind: type[Record], row: Row) -> Record:
    """The record of a row: `kind` names its columns."""
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    values = {name: row[name] for name in names}
    return kind(**{k: as_utc(v) if isinstance(v, datetime) else v for k, v in values.items()})


def put(connection: Connection, table: Table, values: Iterable[Mapping[str, Any]]) -> None:
    """Inserts rows of a table with their sums; a column that is not given is None."""
    made = [{**v, SUM: _sum(table, v)} for v in values]
    if made:
        connection.execute(insert(table), made)


def put_one(connection: Connection, table: Table, values: Mapping[str, Any]) -> int:
    """Inserts one row with its sum; its number."""
    query = insert(table).returning(table.c.id)
    number: int = connection.execute(query, {**values, SUM: _sum(table, values)}).scalar_one()
    return number


def change(connection: Connection, table: Table, where: Any, values: Mapping[str, Any]) -> int:
    """Gives rows that exist new values and new sums; how many there were.

    `connection`: of the transaction; `where`: which rows of the `table`; `values`: by column.
    Raises DamagedError where one of them has changed by itself: a new sum would hide that.
    """
    # to itself: from here to the end of the transaction no other process changes these rows
    if not connection.execute(update(table).where(where).values({SUM: table.c[SUM]})).rowcount:
        return 0
    there = checked(connection, table, where)
    for old in there:
        made = {**values, SUM: _sum(table, {**old, **values})}
        connection.execute(update(table).where(_same(table, old)).values(made))
    return len(there)


def checked(connection: Connection, table: Table, where: Any = None) -> Sequence[Row]:
    """The rows of a table with all columns, by their key. DamagedError names the first that has changed."""
    keys = list(table.primary_key)
    query = select(table).order_by(*keys)
    chosen = query if where is None else query.where(where)
    try:
        rows = connection.execute(chosen).mappings().all()
    except _UNREADABLE as error:
        if _is_of_a_cell(error):
            _name_unreadable(connection, table)
        raise
    check(table, rows)
    return rows


def check(table: Table, rows: Iterable[Row]) -> None:
    """Raises DamagedError for the first of `rows`, with all columns of their table, that has changed."""
    for values in rows:
        if values[SUM] is not None and not _is_sound(table, values):
            raise _damaged(table, values)


def _is_sound(table: Table, values: Row) -> bool:
    try:
        left_out = _LEFT_OUT.get(table.name, ())
        found = values[SUM]
        return bool(found == _sum(table, values) or (left_out and found == _sum(table, values, left_out)))
    except (ValueError, TypeError, OverflowError):  # a text where a number belongs
        return False


_UNREADABLE = (ValueError, TypeError, sqlite3.Error, SQLAlchemyError)


def _is_of_a_cell(error: Exception) -> bool:
    """A date that is none, a text that is not UTF-8; not what the database has to say of itself."""
    return isinstance(error, ValueError | TypeError) or "decode" in str(error)


def _name_unreadable(connection: Connection, table: Table) -> None:
    """Raises DamagedError for the first row whose cells cannot be read, e.g. a date that is none."""
    for key in connection.execute(select(*table.primary_key)).mappings().all():
        try:
            connection.execute(select(table).where(_same(table, key))).all()
        except _UNREADABLE as error:
            if _is_of_a_cell(error):
                raise _damaged(table, key) from None
            raise


def _same(table: Table, values: Row) -> Any:
    """The condition for the row that has the key of these values."""
    return and_(*(column == values[column.name] for column in table.primary_key))


def _damaged(table: Table, values: Row) -> DamagedError:
    # an array has no number but an address; a place has an address and a positioner
    key = next(values[name] for name in ("id", "positioner_id", "address") if name in values)
    return DamagedError(f"row {key} of the table {table.name} is not what was written")


def _sum(table: Table, values: Row, left_out: Iterable[str] = ()) -> int:
    parts = [_as_read(kind, values.get(name)) for name, kind in _summed(table, frozenset(left_out))]
    return zlib.crc32(repr(parts).encode("utf-8", errors="surrogatepass"))


@cache
def _summed(table: Table, left_out: frozenset[str]) -> list[tuple[str, type]]:
    """Columns that a sum covers, and the Python types of their values."""
    skip = {"id", SUM, *left_out}
    return [(c.name, c.type.python_type) for c in table.columns if c.name not in skip]


def _as_read(kind: type, value: Any) -> Any:
    """A value as it comes back from any database: without a zone, whole numbers as what the column holds."""
    if value is None:
        return None
    if kind is datetime:
        return as_utc(value).replace(tzinfo=None).isoformat()
    # SQLite keeps -0.0 as 0
    return float(value) + 0.0 if kind is float else kind(value)
