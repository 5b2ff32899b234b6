"""An older store brought up to date: only when it is asked for, whole or not at all, and with a copy kept."""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path

from alembic.operations import Operations
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, inspect, select, update
from sqlalchemy.exc import SQLAlchemyError

from fiberloom.errors import InputError, one_line
from fiberloom.store.engines import file_engine, url_engine
from fiberloom.store.find import existing
from fiberloom.store.schema import SCHEMA, SCHEMA_VERSION
from fiberloom.wholefile import whole

_HERE = Path(__file__).parent


def upgrade(where: str) -> tuple[int, Path | None]:
    """Brings the tables of a store up to date.

    Parameters
    ----------
    where : str
        Path of an SQLite file, or a database URL.

    Returns
    -------
    int, Path or None
        The version that it had; the copy that was kept of a file as it was, None where there was nothing
        to do or the store is no file.

    Raises
    ------
    InputError
        There is no store, it is of a newer version, it cannot be written; then it is as it was before.
    """
    existing(where)
    url = "://" in where
    engine = url_engine(where) if url else file_engine(Path(where))
    try:
        found = _version(engine, where)
        if found == SCHEMA_VERSION:
            return found, None
        kept = None if url else _copy(Path(where), found)
        with engine.begin() as connection:
            upgrade_tables(connection, found)
        return found, kept
    except (SQLAlchemyError, sqlite3.Error) as error:
        cause = getattr(error, "orig", None) or error
        raise InputError(
            f"store '{where}': cannot be upgraded, and is as it was: {one_line(cause)}"
        ) from None
    finally:
        engine.dispose()


def upgrade_tables(connection: Connection, found: int, to: int = SCHEMA_VERSION) -> None:
    """Goes up the line of revisions, from version `found` to version `to`, in the transaction at hand."""
    # to itself: SQLite begins a transaction with the first row that is written; no other process writes then
    connection.execute(update(SCHEMA).values(version=SCHEMA.c.version))
    line = ScriptDirectory(str(_HERE), version_locations=[str(_HERE / "revisions")])
    steps = list(line.iterate_revisions(str(to), str(found) if found else "base"))
    with Operations.context(MigrationContext.configure(connection)):
        for step in reversed(steps):
            step.module.upgrade()
    connection.execute(update(SCHEMA).values(version=to))


def _version(engine: Engine, where: str) -> int:
    with engine.connect() as connection:
        if not inspect(connection).has_table(SCHEMA.name):
            raise InputError(f"store '{where}': has no tables of fiberloom; name the store of an earlier run")
        found = connection.execute(select(SCHEMA.c.version)).scalar() or 0
    if found > SCHEMA_VERSION:
        raise InputError(
            f"store '{where}': its tables are of version {found}, this program writes {SCHEMA_VERSION}; "
            "upgrade it with a newer fiberloom"
        )
    return found


def _copy(path: Path, version: int) -> Path:
    """The file as it is, with what is recorded beside it, under a name that tells its version."""
    kept = path.with_name(f"{path.name}.v{version}")
    if kept.exists():
        raise InputError(f"{kept}: is there already, from an earlier upgrade; move it away first")
    with (
        whole(kept) as part,
        contextlib.closing(sqlite3.connect(path)) as old,
        contextlib.closing(sqlite3.connect(part)) as new,
    ):
        old.backup(new)
    return kept
