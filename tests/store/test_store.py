"""What was recorded is there, whatever happens afterwards."""

import os
import resource
import signal
import sqlite3
import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.store import Store
from fiberloom.store.process import is_alive, process_start
from fiberloom.version import __version__

N = 500


def measured(n=N):
    rng = np.random.default_rng(0)
    seen = np.ones(n, dtype=bool)
    seen[3] = False
    x = rng.normal(size=n)
    x[3] = np.nan
    return {
        "positioner_id": np.arange(1, n + 1),
        "x_mm": x,
        "y_mm": x + 1.0,
        "seen": seen,
        "alpha_deg": np.full(n, 12.5),
        "beta_deg": 90.0,
        "target_id": np.array([f"t{k}" for k in range(n)]),
        "status": np.array([None, *["on_target"] * (n - 1)], dtype=object),
    }


def start(store, **kwargs):
    return store.start_run(command_line="fiberloom observe x.csv", instrument="sdssv", **kwargs)


def test_a_move_comes_back_as_it_was_recorded(tmp_path):
    store = Store.open(tmp_path / "new" / "store.sqlite")
    given = measured()
    with start(store, config_hash="abc", seed=7) as run:
        run.record_move(1, "blind", given, time_s=12.5, plan_digest="feed")
        run.record_move(2, "correction 1", {"positioner_id": [4, 5], "error_um": [0.5, 0.25]})
        run.record_event("collision", "stopped", positioner_id=np.int64(9), time_s=3.0)
        run.record_calibration([1, 2], "alpha", "transmission", "maps.npz", "12ab")
    got = store.measurements(run.id)
    assert len(got["move"]) == N + 2
    for name in ("positioner_id", "x_mm", "y_mm", "seen", "target_id"):
        np.testing.assert_array_equal(got[name][:N], given[name])
    assert got["beta_deg"][0] == 90.0
    assert got["status"][:2].tolist() == ["", "on_target"]
    assert got["kind"][-1] == "correction 1"
    assert np.isnan(got["x_mm"][-1])
    np.testing.assert_array_equal(got["error_um"][-2:], [0.5, 0.25])
    assert store.moves(run.id)["plan_digest"].tolist() == ["feed", ""]
    assert store.events(run.id)["positioner_id"].tolist() == [9]
    assert store.calibrations(run.id)["hash"].tolist() == ["12ab", "12ab"]


def test_runs_tell_how_they_ended(tmp_path):
    store = Store.open(tmp_path / "s.sqlite")
    with start(store, seed=3, note="first light"):
        pass
    with pytest.raises(RuntimeError), start(store):
        raise RuntimeError("motor on fire")
    run = start(store)
    run.record_move(1, "blind", measured(4))
    with pytest.raises(KeyboardInterrupt), run:
        raise KeyboardInterrupt
    start(store)
    runs = Store.open(tmp_path / "s.sqlite", create=False).runs()
    assert [r.status for r in runs] == ["finished", "failed", "interrupted", "running"]
    assert [r.note for r in runs] == [
        "first light", "RuntimeError: motor on fire", "KeyboardInterrupt: ", "",
    ]  # fmt: skip
    assert (runs[0].seed, runs[1].seed, runs[0].version) == (3, None, __version__)
    assert (runs[2].n_moves, runs[2].n_measurements) == (1, 4)
    assert runs[0].utc_start <= runs[0].utc_end
    assert runs[0].utc_start.tzinfo is not None


def test_a_killed_process_leaves_everything_it_recorded(tmp_path):
    path = tmp_path / "s.sqlite"
    script = f"""
        import sys
        sys.path.insert(0, {str(os.path.dirname(__file__))!r})
        from test_store import measured, start
        from fiberloom.store import Store
        run = start(Store.open({str(path)!r}))
        for number in range(1, 1_000_000):
            run.record_move(number, "correction", measured())
            print(number, flush=True)
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    child = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(script)], stdout=subprocess.PIPE, env=environment
    )
    with child:
        told = [int(child.stdout.readline()) for _ in range(5)]
        assert Store.open(path).runs()[0].status == "running"
        time.sleep(0.03)  # somewhere inside a later record
        child.send_signal(signal.SIGKILL)
        told += [int(line) for line in child.stdout.read().split(b"\n") if line]
    store = Store.open(path)
    run = store.runs()[0]
    assert run.status == "interrupted"
    # what was told is there; a record that was on its way is there whole or not at all
    assert run.n_moves in (told[-1], told[-1] + 1)
    assert run.n_measurements == run.n_moves * N
    with sqlite3.connect(path) as raw:
        assert raw.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    raw.close()


def test_a_process_number_that_was_given_out_again_is_not_the_old_process():
    own = os.getpid()
    assert is_alive(os.uname().nodename, own, process_start(own))
    assert not is_alive(os.uname().nodename, own, "another boot:1")
    assert is_alive("elsewhere", 1, "")
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    assert not is_alive(os.uname().nodename, child.pid, "")


def test_two_processes_may_write_at_the_same_time(tmp_path):
    path = tmp_path / "s.sqlite"
    first, second = Store.open(path), Store.open(path)
    one, two = start(first), start(second)
    for number in range(1, 6):
        one.record_move(number, "blind", measured(10))
        two.record_move(number, "blind", measured(10))
    assert [r.n_moves for r in first.runs()] == [5, 5]


def test_a_file_that_is_something_else_is_refused(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("this is no database, but a text that is longer than a header " * 100)
    with pytest.raises(InputError, match=r"notes.txt.*not a database"):
        Store.open(path)
    assert path.read_text().startswith("this is no database")


def test_a_damaged_database_is_told(tmp_path):
    path = tmp_path / "s.sqlite"
    with Store.open(path) as store, start(store) as run:
        for number in range(20):
            run.record_move(number, "blind", measured())
    data = bytearray(path.read_bytes())
    data[4096 * 3 :] = os.urandom(len(data) - 4096 * 3)
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"s.sqlite': is damaged"):
        Store.open(path).measurements(1)


def test_tables_of_another_version_are_refused(tmp_path):
    path = tmp_path / "s.sqlite"
    Store.open(path).close()
    with sqlite3.connect(path) as raw:
        raw.execute("UPDATE fiberloom_schema SET version = 99")
    raw.close()
    with pytest.raises(InputError, match="version 99"):
        Store.open(path)


def test_places_that_cannot_be_written_are_input_errors(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="choose another place"):
        Store.open(tmp_path / "file" / "s.sqlite")
    with pytest.raises(InputError, match="is a directory"):
        Store.open(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        Store.open(tmp_path / "none.sqlite", create=False)
    with pytest.raises(InputError, match="nonsense"):
        Store.open("nonsense://host/db")


@pytest.mark.skipif(
    not os.path.isdir("/proc/self"), reason="no /proc here, which refuses even root: Linux has it"
)
def test_a_folder_that_cannot_be_written_is_an_input_error():
    with pytest.raises(InputError, match="cannot be opened"):
        Store.open("/proc/s.sqlite")


def test_a_full_disk_is_told_and_what_was_there_stays(tmp_path):
    # a limit on the size of files stands in for the disk
    path = tmp_path / "s.sqlite"
    store = Store.open(path)
    run = start(store)
    run.record_move(1, "blind", measured())
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignore = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 300_000, old[1]))
    try:
        moves = fill(run)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
        signal.signal(signal.SIGXFSZ, ignore)
    store.close()
    assert Store.open(path).runs()[0].n_measurements == (1 + moves) * N


def fill(run):
    """How many moves go in before the disk is full."""
    for moves in range(200):
        try:
            run.record_move(moves, "blind", measured())
        except InputError as error:
            if "the disk" not in str(error):
                raise
            return moves
    raise AssertionError("the disk never filled")


def test_unknown_runs_and_columns_are_named(tmp_path):
    store = Store.open(tmp_path / "s.sqlite")
    with pytest.raises(InputError, match="no run 5"):
        store.measurements(5)
    with pytest.raises(ValueError, match="no column \\['colour'\\]"):
        start(store).record_move(1, "blind", {"positioner_id": [1], "colour": ["red"]})
    assert store.runs()[0].n_moves == 0


def test_an_empty_run_has_empty_columns(tmp_path):
    store = Store.open(tmp_path / "s.sqlite")
    run = start(store)
    assert all(len(column) == 0 for column in store.measurements(run.id).values())
