"""All rows of a store into another one, e.g. from a file into an observatory's database, or back."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import Connection, Table, func, insert, select, text

from fiberloom.errors import InputError
from fiberloom.store.database import Store
from fiberloom.store.schema import SCHEMA, TABLES
from fiberloom.store.sums import Row, checked

_AT_ONCE = 1000


def copy_store(source: Store, target: Store) -> dict[str, int]:
    """Copies every row, with its number and its sum: rows by table. All or nothing.

    Raises
    ------
    InputError
        The target is not empty; a row of the source is damaged.
    """
    with source.transaction() as old, target.transaction() as new:
        tables = [table for table in TABLES.sorted_tables if table is not SCHEMA]
        if any(new.execute(select(func.count()).select_from(table)).scalar_one() for table in tables):
            raise InputError(f"store '{target.name}': is not empty; name a new one")
        return {table.name: _put(new, table, checked(old, table)) for table in tables}


def _put(connection: Connection, table: Table, rows: Sequence[Row]) -> int:
    plain = [dict(row) for row in rows]
    for first in range(0, len(plain), _AT_ONCE):
        connection.execute(insert(table), plain[first : first + _AT_ONCE])
    if plain and "id" in table.c and connection.dialect.name == "postgresql":  # numbers go on after the last
        last = (
            f"SELECT setval(pg_get_serial_sequence('{table.name}', 'id'), (SELECT max(id) FROM {table.name}))"
        )
        connection.execute(text(last))
    return len(plain)
