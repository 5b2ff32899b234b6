"""What was learnt: the newest stands, every earlier state can be had again, old stores are kept."""

import sqlite3
import subprocess
import sys

import numpy as np
import pytest
from databases import aged

from fiberloom.errors import InputError
from fiberloom.store import Store
from fiberloom.store.learnt import OBSERVE, UNDO, Learnt, LearntHistory, generations
from fiberloom.store.schema import SCHEMA_VERSION
from fiberloom.store.upkeep.upgrade import upgrade


def history(tmp_path, origin="abc"):
    return LearntHistory(Store.open(tmp_path / "l.sqlite"), origin)


def learnt(text, moves=1):
    return Learnt(moves, 0.5, text.encode())


def test_the_newest_state_of_each_positioner_stands(tmp_path):
    h = history(tmp_path)
    first = h.begin(OBSERVE, "sdssv", "cafe", 3)
    h.put(first, {1: learnt("a1"), 2: learnt("b1")})
    second = h.begin(OBSERVE, "sdssv", "cafe", 3)
    h.put(second, {2: learnt("b2", 5)})
    h.put(second, {2: learnt("b3", 6), 3: learnt("c3")})
    assert {p: s.data for p, s in h.latest().items()} == {1: b"a1", 2: b"b3", 3: b"c3"}
    assert {p: s.data for p, s in h.latest(first).items()} == {1: b"a1", 2: b"b1"}
    shown = h.generations()
    assert [(g.kind, g.n_positioners, g.moves) for g in shown] == [(OBSERVE, 2, 1), (OBSERVE, 2, 6)]
    assert history(tmp_path, "other calibration").latest() == {}


def test_undo_makes_a_new_generation_and_can_be_undone(tmp_path):
    h = history(tmp_path)
    numbers = [h.begin(OBSERVE, "sdssv", "cafe") for _ in range(3)]
    for k, number in enumerate(numbers):
        h.put(number, {p: learnt(f"{p}{k}") for p in (1, 2)})
    back = h.undo(numbers[0], [2])
    assert {p: s.data for p, s in h.latest().items()} == {1: b"12", 2: b"20"}
    h.undo(0)
    assert [s.data for s in h.latest().values()] == [None, None]
    h.undo(back)
    assert {p: s.data for p, s in h.latest().items()} == {1: b"12", 2: b"20"}
    assert [g.kind for g in generations(Store.open(tmp_path / "l.sqlite"))] == [OBSERVE] * 3 + [UNDO] * 3


def test_what_cannot_be_undone_is_told(tmp_path):
    h = history(tmp_path)
    with pytest.raises(InputError, match="no generation 7"):
        h.undo(7)
    with pytest.raises(InputError, match="nothing was learnt"):
        h.undo(0)
    h.put(h.begin(OBSERVE, "sdssv", "cafe"), {1: learnt("a")})
    with pytest.raises(InputError, match="nothing was learnt of positioner 5"):
        h.undo(0, [5])


def test_a_store_of_the_first_version_gets_the_tables_and_loses_nothing(tmp_path):
    path = tmp_path / "old.sqlite"
    with Store.open(path) as store, store.start_run(command_line="x", instrument="sdssv", seed=4) as run:
        run.record_move(1, "blind", {"positioner_id": np.arange(5), "error_um": np.arange(5.0)})
    aged(path)
    upgrade(str(path))
    h = LearntHistory(Store.open(path), "abc")
    h.put(h.begin(OBSERVE, "sdssv", "cafe"), {1: learnt("a")})
    with Store.open(path) as store:
        np.testing.assert_array_equal(store.measurements(run.id)["error_um"], np.arange(5.0))
        assert store.runs()[0].seed == 4
    with sqlite3.connect(path) as raw:
        assert raw.execute("SELECT version FROM fiberloom_schema").fetchall() == [(SCHEMA_VERSION,)]


def test_many_positioners_at_once(tmp_path):
    h = history(tmp_path)
    number = h.begin(OBSERVE, "sdssv", "cafe")
    for text in ("x", "y"):
        h.put(number, {p: learnt(text) for p in range(5000)})
    assert {s.data for s in h.latest().values()} == {b"y"}
    assert len(h.latest()) == 5000


def test_two_processes_may_make_a_store_in_the_same_moment(tmp_path):
    code = "import sys; from fiberloom.store import Store; Store.open(sys.argv[1]).close()"
    words = [sys.executable, "-c", code, str(tmp_path / "s.sqlite")]
    both = [subprocess.Popen(words, stderr=subprocess.PIPE, text=True) for _ in range(3)]
    assert [(p.communicate()[1], p.returncode) for p in both] == [("", 0)] * 3
