"""A store checked: every row against its sum, every reference, and the database's own word."""

from __future__ import annotations

from dataclasses import dataclass, field

from sqlalchemy import Connection, func, select

from fiberloom.errors import InputError
from fiberloom.store.database import Store
from fiberloom.store.schema import Base, SchemaRow
from fiberloom.store.sums import SUM, DamagedError, checked


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
        found = StoreCheck(connection.execute(select(SchemaRow.version)).scalar_one())
        found.faults += _said_by_sqlite(connection)
    for row in _kinds():
        _check_table(store, row, found)
    return found


def _kinds() -> list[type[Base]]:
    rows = [mapper.class_ for mapper in Base.registry.mappers]
    return sorted((row for row in rows if row is not SchemaRow), key=lambda row: str(row.__tablename__))


def _check_table(store: Store, row: type[Base], found: StoreCheck) -> None:
    table = row.__table__
    try:
        with store.transaction() as connection:
            query = select(func.count()).select_from(table)
            found.rows[row.__tablename__] = connection.execute(query).scalar_one()
            found.without_sum += connection.execute(query.where(table.c[SUM].is_(None))).scalar_one()
            checked(connection, row)
    except (InputError, DamagedError) as error:
        found.faults.append(str(error).removeprefix(f"store '{store.name}': "))


def _said_by_sqlite(connection: Connection) -> list[str]:
    if connection.dialect.name != "sqlite":
        return []
    said = [str(row[0]) for row in connection.exec_driver_sql("PRAGMA quick_check")]
    lost = {str(row[0]) for row in connection.exec_driver_sql("PRAGMA foreign_key_check")}
    named = [f"rows of {table} belong to rows that are gone" for table in sorted(lost)]
    return [f"SQLite: {text}" for text in said if text != "ok"] + named
