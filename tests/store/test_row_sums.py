"""A byte that changes in the file of a store is told in one line that names table and row, in every table."""

import contextlib
import sqlite3
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from sqlalchemy import select

from fiberloom.errors import InputError
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook, ArrayPlaces
from fiberloom.store.engines import file_engine
from fiberloom.store.learnt import OBSERVE, Learnt, LearntHistory, generations
from fiberloom.store.nights.book import NightBook, nights
from fiberloom.store.parts import pack
from fiberloom.store.schema import PLACES, TABLES
from fiberloom.store.service.alarms import Severity
from fiberloom.store.sums import _sum

BUS = "cannet://10.1.10.31:19228"


@pytest.fixture
def path(tmp_path):
    """A store with a row in every table, with texts that are nowhere else in the file."""
    with Store.open(tmp_path / "s.sqlite") as store:
        with store.start_run(command_line="COMMAND-OF-RUN", instrument="sdssv", config_hash="c0ffee") as run:
            run.record_move(1, "KIND-OF-MOVE", {"positioner_id": [7], "target_id": ["TARGET-SEEN"]})
            run.record_event("flag", "TEXT-OF-EVENT", positioner_id=7)
            run.record_calibration([7], "alpha", "arms", "FILE-OF-CALIBRATION", "12ab")
            run.record_part("NAME-OF-PART", pack({"a": 1}))
        book = ArrayBook(store, BUS)
        book.exclude([4, 9], "ann", "first reason", datetime.now(UTC) + timedelta(hours=1))
        book.clear([9], "AUTHOR-OF-CLEARING")
        token, _ = book.take("COMMAND-OF-OWNER", "connecting")
        book.release(token, "parked", "TEXT-OF-STATE")
        book.note_places(
            np.array([4]), ArrayPlaces(np.ones((1, 2)), np.ones((1, 2)), ["HOW-OF-PLACE"], [True], [None])
        )
        history = LearntHistory(store, "ORIGIN-OF-GENERATION")
        history.put(history.begin(OBSERVE, "INSTRUMENT-LEARNT", "beef"), {4: Learnt(1, 0.5, b"STATE-LEARNT")})
        write_night(store)
    return tmp_path / "s.sqlite"


def write_night(store):
    """A row in each table of nights."""
    now = datetime.now(UTC)
    about = {"name": "n", "queue": "FILE-OF-QUEUE", "array": BUS, "instrument": "i", "config_hash": "c"}
    book = NightBook.begin(store, now, about | {"seed": 0, "command_line": "x"})
    book.note_field("NAME-OF-FIELD", "{}", "queued")
    visit = book.begin_visit(
        now, "prepared", {"field": "FIELD-OF-VISIT", "repeat": 0, "dither": 0, "attempt": 1}
    )
    stage = {"visit_id": visit, "name": "NAME-OF-STAGE", "duration_s": 1.0, "wall_s": 0.5, "outcome": "done"}
    book.note_stage(now, stage)
    book.ask_exposure(visit, 1, "KEY-OF-EXPOSURE", 900.0)
    book.note_command(now, "AUTHOR-OF-COMMAND", "stop", "done")
    book.raise_alarm(now, "camera", Severity.MAJOR, "camera", "TEXT-OF-ALARM")


def flip(path, text, bit=1, at=0):
    """One bit of the byte `at` of a text, in its row and in the index where the column has one."""
    content, changed = path.read_bytes(), bytearray(text.encode())
    changed[at] ^= bit
    assert text.encode() in content
    path.write_bytes(content.replace(text.encode(), changed))


def everything(path):
    """Reads all that a store holds, as the commands do."""
    with Store.read(path) as store:
        for run in store.runs():
            for table in (store.moves, store.measurements, store.events, store.calibrations, store.parts):
                table(run.id)
        book = ArrayBook(store, BUS)
        book.state(), book.exclusions(), book.places(np.array([4]))
        night = NightBook(store, nights(store)[0].id)
        night.fields(), night.visits(), night.stages(), night.exposures(), night.commands(), night.alarms()
        for generation in generations(store):
            LearntHistory(store, generation.origin).of_generation(generation.id)
            LearntHistory(store, generation.origin).latest()


CASES = {
    "runs": ("COMMAND-OF-RUN", "1"),
    "moves": ("KIND-OF-MOVE", "1"),
    "measurements": ("TARGET-SEEN", "1"),
    "events": ("TEXT-OF-EVENT", "1"),
    "calibrations": ("FILE-OF-CALIBRATION", "1"),
    "parts": ("NAME-OF-PART", "1"),
    "exclusions": ("AUTHOR-OF-CLEARING", "2"),
    "array_state": ("TEXT-OF-STATE", BUS),
    "places": ("HOW-OF-PLACE", "4"),
    "learnt_generations": ("INSTRUMENT-LEARNT", "1"),
    "learnt_states": ("STATE-LEARNT", "1"),
    "nights": ("FILE-OF-QUEUE", "1"),
    "fields": ("NAME-OF-FIELD", "1"),
    "visits": ("FIELD-OF-VISIT", "1"),
    "stages": ("NAME-OF-STAGE", "1"),
    "exposures": ("KEY-OF-EXPOSURE", "1"),
    "commands": ("AUTHOR-OF-COMMAND", "1"),
    "alarms": ("TEXT-OF-ALARM", "1"),
}


def test_every_table_has_a_case():
    assert set(CASES) == set(TABLES.tables) - {"fiberloom_schema"}


def test_what_was_not_touched_is_read(path):
    everything(path)


@pytest.mark.parametrize("table", CASES)
def test_a_flipped_bit_is_told(path, table):
    text, row = CASES[table]
    flip(path, text)
    with pytest.raises(InputError) as told:
        everything(path)
    line = str(told.value)
    assert f"is damaged: row {row} of the table {table} is not what was written" in line
    assert str(path) in line
    assert "\n" not in line


@pytest.mark.parametrize(
    ("text", "table"),
    [("ORIGIN-OF-GENERATION", "learnt_generations"), ("c0ffee", "runs"), ("finished", "runs")],
)
def test_a_row_is_told_that_would_not_be_found_any_more(path, text, table):
    flip(path, text)
    with pytest.raises(InputError, match=f"row 1 of the table {table} "):
        everything(path)
    with Store.read(path) as store, pytest.raises(InputError, match=f"row 1 of the table {table} "):
        store.runs("running") if table == "runs" else LearntHistory(store, "ORIGIN-OF-GENERATION").latest()


def damage(path, query):
    with contextlib.closing(sqlite3.connect(path)) as raw, raw:
        raw.execute(query)


def test_an_array_whose_address_has_changed_is_not_taken_for_a_new_one(path):
    damage(path, "UPDATE array_state SET address = 'x'")
    with Store.open(path) as store, pytest.raises(InputError, match="row x of the table array_state"):
        ArrayBook(store, BUS).take("fiberloom park", "connecting")


@pytest.mark.parametrize(
    ("table", "column", "value"),
    [
        ("runs", "utc_start", "'2026-01-0x 10:00:00.000000'"),
        ("exclusions", "since", "'yesterday'"),
        ("runs", "pid", "'p12'"),
        ("runs", "note", "CAST(x'ff' AS TEXT)"),
        ("array_state", "heartbeat", "'2026-13-01 10:00:00.000000'"),
    ],
)
def test_a_cell_that_cannot_be_read_names_its_row(path, table, column, value):
    damage(path, f"UPDATE {table} SET {column} = {value}")
    with pytest.raises(InputError, match=rf"row \S+ of the table {table} is not what was written"):
        everything(path)


def test_a_damaged_row_is_not_written_over(path):
    """A new sum would make it look sound."""
    damage(path, "UPDATE exclusions SET why = 'another' WHERE id = 1")
    damage(path, "UPDATE array_state SET text = 'another'")
    damage(path, "UPDATE runs SET seed = 5")
    before = list(dump(path))
    with Store.open(path) as store:
        book = ArrayBook(store, BUS)
        for deed in (
            lambda: book.clear([4], "ann"),
            lambda: book.note_stopped("by hand", "stopped"),
            lambda: store.last_run().end("failed"),
        ):
            with pytest.raises(InputError, match="is not what was written"):
                deed()
    assert list(dump(path)) == before


def test_a_datum_that_was_never_searched_is_not_believed(path):
    """It would make a positioner that is not seen move."""
    with Store.open(path) as store:
        ArrayBook(store, BUS).forget_datum(np.array([4]))
        assert ArrayBook(store, BUS).places(np.array([4])).datum.tolist() == [False]
    damage(path, "UPDATE places SET datum = 1")
    with pytest.raises(InputError, match="row 4 of the table places is not what was written"):
        everything(path)


def test_sums_of_places_that_left_the_datum_out_are_right_still(path):
    with Store.open(path) as store, store.transaction() as connection:
        (row,) = connection.execute(select(PLACES)).mappings()
        old = _sum(PLACES, row, {"datum"})
    damage(path, f"UPDATE places SET row_sum = {old}")
    everything(path)
    damage(path, "UPDATE places SET alpha_deg = 3.5")
    with pytest.raises(InputError, match="table places"):
        everything(path)


def dump(path):
    with contextlib.closing(sqlite3.connect(path)) as raw:
        yield from raw.iterdump()


def test_rows_without_sums_are_read_and_get_one_when_they_change(path):
    for table in ("runs", "exclusions", "array_state", "learnt_generations"):
        damage(path, f"UPDATE {table} SET row_sum = NULL")
    everything(path)
    with Store.open(path) as store:
        store.last_run().end("failed", "by hand")
        ArrayBook(store, BUS).clear([4], "bob")
    everything(path)
    with contextlib.closing(sqlite3.connect(path)) as raw:
        for table, sums in (("runs", [1]), ("exclusions", [1, 0]), ("array_state", [0])):
            rows = raw.execute(f"SELECT row_sum IS NOT NULL FROM {table}").fetchall()
            assert [has for (has,) in rows] == sums


def test_an_engine_keeps_the_numbers_of_any_path(tmp_path):
    assert file_engine(tmp_path / "50%?x=#1").url.database == str(tmp_path / "50%?x=#1")
