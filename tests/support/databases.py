"""Databases for tests: an SQLite file, and PostgreSQL where it can be started."""

import contextlib
import os
import shutil
import sqlite3
import subprocess
import tempfile
from pathlib import Path

import pytest

LEFT_OUT = (
    "left out: stores in PostgreSQL: install the Debian package postgresql and the extra fiberloom[postgres]"
)


def programs():
    """The folder of the newest PostgreSQL of this machine, or nothing."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
    return found[-1] if found else None


@contextlib.contextmanager
def postgres():
    """The URL of a PostgreSQL of its own, without a TCP port; it ends with the block."""
    pytest.importorskip("psycopg", reason=LEFT_OUT)
    there = programs()
    if there is None:
        pytest.skip(LEFT_OUT)
    folder = Path(tempfile.mkdtemp(prefix="fiberloom-pg-"))
    as_user = []
    if os.getuid() == 0:  # the server does not run as root
        shutil.chown(folder, "postgres", "postgres")
        other = shutil.which("runuser", path=f"{os.environ.get('PATH', os.defpath)}:/usr/sbin:/sbin")
        as_user = [other or "runuser", "-u", "postgres", "--"]
    folder.chmod(0o755)

    def run(name, *words):
        command = [*as_user, str(there / name), *words]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, timeout=120, cwd="/")

    data = f"{folder}/data"
    run("initdb", "-D", data, "-U", "fiberloom", "--auth=trust", "-E", "UTF8", "--no-sync")
    how = f"-c listen_addresses='' -c unix_socket_directories={folder} -c fsync=off"
    run("pg_ctl", "-D", data, "-w", "-l", f"{folder}/log", "-o", how, "start")
    try:
        yield f"postgresql+psycopg://fiberloom@/postgres?host={folder}"
    finally:
        run("pg_ctl", "-D", data, "-w", "-m", "immediate", "stop")
        shutil.rmtree(folder, ignore_errors=True)


def emptied(url):
    """The same database without tables."""
    from sqlalchemy import create_engine, text

    engine = create_engine(url)
    with engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    engine.dispose()
    return url


LATER = (
    *("alarms", "commands", "exposures", "stages", "visits", "fields", "nights"),
    *("learnt_states", "learnt_generations", "exclusions", "array_state", "places", "parts"),
)
"""Tables that version 1 did not have, in an order in which they can go."""


def aged(path):
    """Makes a store of today as version 1 left it; its path."""
    with contextlib.closing(sqlite3.connect(path)) as raw, raw:
        for table in LATER:
            raw.execute(f"DROP TABLE {table}")
        raw.execute("ALTER TABLE runs DROP COLUMN folder")
        raw.execute("ALTER TABLE moves DROP COLUMN n_measured")
        for table in ("runs", "moves", "measurements", "events", "calibrations"):
            raw.execute(f"ALTER TABLE {table} DROP COLUMN row_sum")
        raw.execute("UPDATE fiberloom_schema SET version = 1")
    return path
