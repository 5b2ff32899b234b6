"""The sum of a row: written with it, compared when it is read.

SQLite has none of its own: a bit that flips on a disk or in a copy changes a number and nothing else. The
sum is the CRC-32 of all columns but the database's own number of the row.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Connection, Table, insert

from fiberloom.store.schema import Base, PlaceRow

SUM = "row_sum"
_LATER = {PlaceRow.__tablename__: {"datum"}}
"""Columns that are written over later."""


class DamagedError(ValueError):
    """What the store holds is not what was written."""


def put(connection: Connection, row: type[Base], values: Iterable[Mapping[str, Any]]) -> None:
    """Inserts rows of a table with their sums; a column that is not given is None."""
    table = _table(row)
    made = [{**v, SUM: _sum(table, v)} for v in values]
    if made:
        connection.execute(insert(table), made)


def put_one(connection: Connection, row: type[Base], values: Mapping[str, Any]) -> int:
    """Inserts one row with its sum; its number."""
    table = _table(row)
    query = insert(table).returning(table.c.id)
    number: int = connection.execute(query, {**values, SUM: _sum(table, values)}).scalar_one()
    return number


def check(row: type[Base], rows: Iterable[Mapping[Any, Any]]) -> None:
    """Raises DamagedError for the first of `rows`, with all columns of their table, that has changed."""
    table = _table(row)
    for values in rows:
        if values[SUM] is not None and values[SUM] != _sum(table, values):
            number = values.get("id", values.get("positioner_id"))
            raise DamagedError(f"row {number} of the table {table.name} is not what was written")


def _table(row: type[Base]) -> Table:
    table = row.__table__
    assert isinstance(table, Table)
    return table


def _sum(table: Table, values: Mapping[Any, Any]) -> int:
    skip = {"id", SUM} | _LATER.get(table.name, set())
    parts = [_as_read(c.type.python_type, values.get(c.name)) for c in table.columns if c.name not in skip]
    return zlib.crc32(repr(parts).encode("utf-8", errors="surrogatepass"))


def _as_read(kind: type, value: Any) -> Any:
    """A value as it comes back from any database: without a zone, whole numbers as what the column holds."""
    if value is None:
        return None
    if kind is datetime:
        return (value.astimezone(UTC) if value.tzinfo else value).replace(tzinfo=None).isoformat()
    # SQLite keeps -0.0 as 0
    return float(value) + 0.0 if kind is float else kind(value)
