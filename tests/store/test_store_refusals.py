"""What a store refuses, and what it says to do."""

import numpy as np
import pytest
from sqlalchemy.exc import IntegrityError, OperationalError

from fiberloom.errors import InputError
from fiberloom.store import Store
from fiberloom.store import database as database_module


@pytest.fixture
def store(tmp_path):
    with Store.open(tmp_path / "s.sqlite") as opened:
        yield opened


def start(store):
    return store.start_run(command_line="fiberloom observe x.csv", instrument="sdssv")


def test_a_run_that_is_not_there(store):
    for ask in (store.measurements, store.moves, store.events, store.calibrations):
        with pytest.raises(InputError, match="no run 7; 'fiberloom runs' lists them"):
            ask(7)
    with pytest.raises(InputError, match="no run in it"):
        store.last_run()
    assert store.runs() == []
    assert store.calibrated(7) == {}


def test_the_last_run_can_be_recorded_further(store):
    with start(store) as first, start(store) as second:
        assert first.id < second.id
    assert store.last_run().id == second.id
    store.last_run().record_calibration([], "alpha", "transmission", "maps.npz", "12ab")
    assert store.calibrated(second.id) == {}
    store.last_run().record_calibration([4, 5], "alpha", "transmission", "maps.npz", "12ab")
    store.last_run().record_calibration([4, 5], "beta", "transmission", "maps.npz", "12ab")
    assert store.calibrated(second.id) == {"transmission": 2}


def test_a_column_that_measurements_do_not_have_is_named(store):
    words = r"no column \['colour'\]; known: \['alpha_deg'"
    with start(store) as run, pytest.raises(ValueError, match=words):
        run.record_move(1, "blind", {"positioner_id": [1], "colour": ["red"]})
    # nothing of the move is left
    assert len(store.moves(run.id)["number"]) == 0


def test_a_move_without_measurements_is_a_move(store):
    with start(store) as run:
        run.record_move(1, "blind", None)
    assert store.moves(run.id)["kind"].tolist() == ["blind"]
    assert len(store.measurements(run.id)["x_mm"]) == 0


def test_numbers_that_are_not_known_come_back_as_nan_and_texts_empty(store):
    with start(store) as run:
        run.record_move(1, "blind", {"positioner_id": [1, 2], "x_mm": [np.nan, 2.0]})
        run.record_event("note", "a")
    got = store.measurements(run.id)
    np.testing.assert_array_equal(got["x_mm"], [np.nan, 2.0])
    assert got["seen"].tolist() == [True, True]
    assert np.isnan(store.events(run.id)["positioner_id"]).all()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda p: "nonsense://x", "store 'nonsense://x': "),
        (lambda p: p, "is a directory; name a file in it"),
        (lambda p: p / "none.sqlite", "no such file; name the store of an earlier run"),
    ],
)
def test_places_that_hold_no_store(tmp_path, make, words):
    with pytest.raises(InputError, match=words):
        Store.open(make(tmp_path), create=False)


def test_a_folder_that_is_a_file(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="choose another place"):
        Store.open(tmp_path / "file" / "s.sqlite")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (IntegrityError("s", {}, Exception("UNIQUE constraint failed")), "does not finish making its tables"),
        (OperationalError("s", {}, Exception("table runs already exists")), "does not finish making"),
        (OperationalError("s", {}, Exception("database is locked")), "another process holds it; try again"),
    ],
)
def test_a_store_that_another_process_is_making(tmp_path, monkeypatch, error, words):
    tries = []

    def objecting(connection, name):
        tries.append(name)
        raise error

    monkeypatch.setattr(database_module, "_prepare", objecting)
    monkeypatch.setattr(database_module, "_MOMENT_S", 0.0)
    with pytest.raises(InputError, match=words):
        Store.open(tmp_path / "s.sqlite")
    # only what passes by itself is tried again
    assert len(tries) == (1 if "holds it" in words else database_module._TRIES)
