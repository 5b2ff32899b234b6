"""A store checked: every row against its sum, every reference, and the database's own word."""

from __future__ import annotations

from dataclasses import dataclass, field

from sqlalchemy import Connection, Table, func, select

from fiberloom.errors import InputError
from fiberloom.store.database import Store
from fiberloom.store.schema import SCHEMA, SUM, TABLES
from fiberloom.store.sums import DamagedError, checked


@dataclass
class StoreCheck:
    """What was found in a store."""

    version: int
    rows: dict[str, int] = field(default_factory=dict)
    """Of each table."""
    without_sum: int = 0
    """Rows of older versions that have none: nothing tells whether they are as written."""
    faults: list[str] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """Nothing is wrong."""
        return not self.faults


def check_store(store: Store) -> StoreCheck:
    """Reads every row of a store; what is wrong is in `faults`, one line for each table at most."""
    with store.transaction() as connection:
        found = StoreCheck(connection.execute(select(SCHEMA.c.version)).scalar_one())
        found.faults += _said_by_sqlite(connection)
    for table in _summed():
        _check_table(store, table, found)
    return found


def _summed() -> list[Table]:
    return [table for name, table in sorted(TABLES.tables.items()) if table is not SCHEMA]


def _check_table(store: Store, table: Table, found: StoreCheck) -> None:
    try:
        with store.transaction() as connection:
            query = select(func.count()).select_from(table)
            found.rows[table.name] = connection.execute(query).scalar_one()
            found.without_sum += connection.execute(query.where(table.c[SUM].is_(None))).scalar_one()
            checked(connection, table)
    except (InputError, DamagedError) as error:
        found.faults.append(str(error).removeprefix(f"store '{store.name}': "))


def _said_by_sqlite(connection: Connection) -> list[str]:
    if connection.dialect.name != "sqlite":
        return []
    said = [str(row[0]) for row in connection.exec_driver_sql("PRAGMA quick_check")]
    lost = {str(row[0]) for row in connection.exec_driver_sql("PRAGMA foreign_key_check")}
    named = [f"rows of {table} belong to rows that are gone" for table in sorted(lost)]
    return [f"SQLite: {text}" for text in said if text != "ok"] + named
