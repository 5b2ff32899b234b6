"""Engines of stores: a file to write, a file only to read, a database by its URL.

A file is read as it is, on media that cannot be written and on a full disk too; an older store is not
brought up to date for it.
"""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import tempfile
from pathlib import Path
from urllib.parse import quote

from sqlalchemy import URL, Engine, create_engine, event
from sqlalchemy.exc import ArgumentError

from fiberloom.errors import InputError
from fiberloom.store.schema import TABLES

_SQLITE = "sqlite"
_BUSY_MS = 10_000


def url_engine(url: str) -> Engine:
    """The database of a URL; InputError where SQLAlchemy does not know its kind."""
    try:
        return create_engine(url, pool_pre_ping=True)
    except (ArgumentError, ImportError) as error:
        raise InputError(f"store '{url}': {str(error).splitlines()[0]}") from None


def file_engine(path: Path) -> Engine:
    """An SQLite file to write; its folder is made. Any character may be in the path."""
    if path.is_dir():
        raise InputError(f"store '{path}': is a directory; name a file in it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"store '{path}': {error.strerror}; choose another place") from None
    engine = create_engine(URL.create(_SQLITE, database=str(path)))

    @event.listens_for(engine, "connect")
    def settings(connection: sqlite3.Connection, record: object) -> None:
        for pragma in ("journal_mode=WAL", "synchronous=NORMAL", "foreign_keys=ON"):
            connection.execute(f"PRAGMA {pragma}")
        connection.execute(f"PRAGMA busy_timeout={_BUSY_MS}")

    return engine


def reading_engine(path: Path) -> Engine:
    """An SQLite file only to read; columns and tables of newer versions are there, and empty."""
    if path.is_dir():
        raise InputError(f"store '{path}': is a directory; name a file in it")

    def connect() -> sqlite3.Connection:
        connection = _opened(path)
        connection.execute(f"PRAGMA busy_timeout={_BUSY_MS}")
        _as_of_now(connection)
        connection.execute("PRAGMA query_only=ON")
        return connection

    return create_engine(URL.create(_SQLITE, database=str(path)), creator=connect)


def sqlite_uri(path: Path, **how: str) -> str:
    """A path as SQLite takes it in a URI: `?`, `#` and `%` are letters of it. `how`: mode, immutable."""
    words = "&".join(f"{key}={value}" for key, value in how.items())
    return f"file:{quote(str(path.absolute()))}?{words}"


def _opened(path: Path) -> sqlite3.Connection:
    # SQLite makes two files beside it, for its locks and for what is not yet in the file itself. With
    # mode=ro it makes them too, and cannot remove them at the end
    try:
        return _connected(sqlite_uri(path, mode="rw"))
    except sqlite3.OperationalError:
        if _has_more(path):
            return _copied(path)
        return _connected(sqlite_uri(path, mode="ro", immutable="1"))


def _connected(uri: str) -> sqlite3.Connection:
    connection = sqlite3.connect(uri, uri=True, check_same_thread=False)
    try:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.Error:
        connection.close()
        raise
    return connection


def _log_of(path: Path) -> Path:
    return path.with_name(f"{path.name}-wal")


def _has_more(path: Path) -> bool:
    """Is something recorded beside the file that is not in it yet? A process that was killed leaves that."""
    with contextlib.suppress(OSError):
        return _log_of(path).stat().st_size > 0
    return False


def _copied(path: Path) -> sqlite3.Connection:
    """What is in the file and beside it, by way of a copy in the folder of temporary files."""
    with tempfile.TemporaryDirectory(prefix="fiberloom-") as folder:
        for part in (path, _log_of(path)):
            shutil.copyfile(part, Path(folder) / part.name)
        source = sqlite3.connect(Path(folder) / path.name)
        memory = sqlite3.connect(":memory:", check_same_thread=False)
        with contextlib.closing(source):
            source.backup(memory)
    return memory


def _as_of_now(connection: sqlite3.Connection) -> None:
    """Shows the tables of an older version with the columns of this one, in memory alone."""
    connection.execute("PRAGMA temp_store=MEMORY")
    names = {row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    for table in TABLES.sorted_tables if names else ():
        there = {row[1] for row in connection.execute(f"PRAGMA main.table_info({table.name})")}
        names_of = [column.name for column in table.columns]
        if there.issuperset(names_of):
            continue
        wanted = ", ".join(name if name in there else f"NULL AS {name}" for name in names_of)
        source = f"FROM main.{table.name}" if table.name in names else "WHERE 0"
        connection.execute(f"CREATE TEMP VIEW {table.name} AS SELECT {wanted} {source}")
    connection.commit()
