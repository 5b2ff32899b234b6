"""Stores are read where nothing can be written, with any letter in their path, and stay as they are."""

import contextlib
import resource
import signal
import sqlite3
import subprocess
import sys

import numpy as np
import pytest
from databases import aged
from readonly import read_only

from fiberloom.errors import InputError
from fiberloom.store import Store
from fiberloom.store.engines import sqlite_uri
from fiberloom.store.listing import runs_below
from fiberloom.store.upkeep.upgrade import upgrade


def made(path, moves=1):
    with Store.open(path) as store, store.start_run(command_line="x", instrument="sdssv", seed=4) as run:
        for number in range(1, moves + 1):
            run.record_move(number, "blind", {"positioner_id": np.arange(5), "error_um": np.arange(5.0)})
    return path


def test_a_store_on_media_that_cannot_be_written_is_read(tmp_path):
    made(tmp_path / "s.sqlite")
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    with read_only(tmp_path):
        with pytest.raises(PermissionError):
            (tmp_path / "new").touch()
        with pytest.raises(InputError, match="readonly"):
            Store.open(tmp_path / "s.sqlite")
        (row,) = runs_below(str(tmp_path))
        with Store.read(tmp_path / "s.sqlite") as store:
            assert store.measurements(1)["error_um"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
            with pytest.raises(InputError, match="cannot be written"):
                store.start_run(command_line="x", instrument="sdssv")
    assert (row["status"], row["moves"], row["seed"]) == ("finished", 1, 4)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


KILLED = """
import os, signal, sys
from fiberloom.store import Store
store = Store.open(sys.argv[1])
run = store.start_run(command_line="x", instrument="sdssv")
run.record_event("flag", "the last one")
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_beside_the_file_is_read_there_too(tmp_path):
    path = tmp_path / "s.sqlite"
    subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    assert path.with_name("s.sqlite-wal").stat().st_size > 0
    path.with_name("s.sqlite-shm").unlink()
    with read_only(tmp_path), Store.read(path) as store:
        assert store.events(1)["text"].tolist() == ["the last one"]
        assert [run.status for run in store.runs()] == ["interrupted"]


def test_a_store_on_a_full_disk_is_read(tmp_path):
    path = made(tmp_path / "s.sqlite", moves=3)
    before, (_, most) = (
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN),
        resource.getrlimit(resource.RLIMIT_FSIZE),
    )
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, most))
        with pytest.raises(InputError):
            Store.open(path)
        (row,) = runs_below(str(tmp_path))
        with Store.read(path) as store:
            assert len(store.measurements(1)["move"]) == 15
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
        signal.signal(signal.SIGXFSZ, before)
    assert row["measurements"] == 15


def test_nothing_is_left_beside_a_store_that_was_read(tmp_path):
    made(tmp_path / "s.sqlite")
    runs_below(str(tmp_path))
    assert [p.name for p in tmp_path.iterdir()] == ["s.sqlite"]


def test_a_store_is_read_while_another_process_writes_it(tmp_path):
    with Store.open(tmp_path / "s.sqlite") as store, store.start_run(command_line="", instrument="i") as run:
        run.record_event("flag", "one")
        with Store.read(tmp_path / "s.sqlite") as reader:
            run.record_event("flag", "two")
            assert reader.events(run.id)["text"].tolist() == ["one", "two"]


def test_an_older_store_is_read_and_stays_as_it_is(tmp_path):
    path = aged(made(tmp_path / "old.sqlite"))
    before = path.read_bytes()
    with Store.read(path) as store:
        assert store.measurements(1)["error_um"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
        assert [(run.seed, run.n_moves) for run in store.runs()] == [(4, 1)]
    assert path.read_bytes() == before


def test_an_older_store_is_written_when_it_was_upgraded(tmp_path):
    path = aged(made(tmp_path / "old.sqlite"))
    with pytest.raises(InputError, match="of version 1, this program writes"):
        Store.open(path)
    upgrade(str(path))
    with Store.open(path) as store, store.start_run(command_line="", instrument="i"):
        assert [run.n_measurements for run in store.runs()] == [5, 0]
    with contextlib.closing(sqlite3.connect(path)) as raw:
        sums = raw.execute("SELECT row_sum IS NULL FROM runs ORDER BY id").fetchall()
    assert sums == [(1,), (0,)]


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"", "has no tables of fiberloom"), (b"no database at all" * 99, "is not a database")],
)
def test_what_is_no_store_is_told(tmp_path, content, words):
    (tmp_path / "s.sqlite").write_bytes(content)
    with pytest.raises(InputError, match=words):
        Store.read(tmp_path / "s.sqlite")
    assert (tmp_path / "s.sqlite").read_bytes() == content


ODD = ["a?b", "100%", "a%20b", "n#1", "two words", "ä&ö=ü", "mode=ro?x", "semi;colon", "plus+"]


@pytest.mark.parametrize("name", ODD)
def test_any_letter_may_be_in_the_path(tmp_path, name):
    path = tmp_path / name / f"{name}.sqlite"
    made(path)
    assert [p.name for p in tmp_path.iterdir()] == [name]
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    (row,) = runs_below(str(tmp_path))
    assert (row["store"], row["moves"]) == (str(path), 1)
    with Store.read(path) as store:
        assert len(store.measurements(1)["move"]) == 5


@pytest.mark.parametrize("name", ODD)
def test_a_path_is_one_in_a_uri_too(tmp_path, name):
    path = tmp_path / name
    with contextlib.closing(sqlite3.connect(sqlite_uri(path, mode="rwc"), uri=True)) as raw:
        raw.execute("CREATE TABLE t (x)")
    assert [p.name for p in tmp_path.iterdir()] == [name]
