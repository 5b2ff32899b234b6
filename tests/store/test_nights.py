"""The record of a night: what was written comes back, alarms are latched, one process has it."""

import subprocess
from datetime import UTC, datetime, timedelta

import pytest

from fiberloom.errors import InputError
from fiberloom.store import Store
from fiberloom.store.nights.book import NightBook, night_of, nights
from fiberloom.store.service.alarms import Severity

EVENING = datetime(2026, 11, 25, 18, 0, tzinfo=UTC)
ABOUT = {
    **{"name": "n", "queue": "night.toml", "array": "twin:1", "instrument": "sdssv", "config_hash": "c"},
    **{"seed": 3, "command_line": "fiberloom night night.toml"},
}


def after(seconds):
    return EVENING + timedelta(seconds=seconds)


@pytest.fixture
def book(tmp_path):
    with Store.open(tmp_path / "s.sqlite") as store:
        yield NightBook.begin(store, EVENING, ABOUT)


def test_a_night_comes_back(book):
    night = night_of(book.store)
    assert (night.id, night.seed, night.utc_start, night.status) == (book.id, 3, EVENING, "running")
    assert night.goes_on
    book.end(after(10), "finished", "queue done")
    night = night_of(book.store, book.id)
    assert (night.status, night.note, night.utc_end, night.goes_on) == (
        "finished",
        "queue done",
        after(10),
        False,
    )
    with pytest.raises(InputError, match="no night 9 in it"):
        night_of(book.store, 9)
    assert [n.id for n in nights(book.store)] == [book.id]


def test_a_night_of_a_process_that_is_there_is_not_taken_over(book):
    with pytest.raises(InputError, match="goes on in process"):
        book.take_over()
    child = subprocess.Popen(["true"])
    child.wait()
    book._change(type_of_night(), book.id, {"pid": child.pid})
    book.take_over()
    assert book.about.goes_on


def type_of_night():
    from fiberloom.store.schema import NightRow

    return NightRow


def test_visits_stages_and_exposures(book):
    which = {"field": "a", "repeat": 0, "dither": 1, "attempt": 2}
    visit = book.begin_visit(EVENING, "prepared", which)
    book.change_visit(visit, state="done", utc_end=after(60), on_target=7, assigned=7, rms_um=1.5)
    stage = {"visit_id": visit, "name": "blind", "duration_s": 30.0, "wall_s": 1.0, "outcome": "done"}
    book.note_stage(after(5), stage)
    exposure = book.ask_exposure(visit, 1, "key", 900.0)
    assert (book.exposures()[0].utc_start, book.exposures()[0].utc_end) == (None, None)
    book.change_exposure(exposure, utc_start=after(60), utc_end=after(960))
    (seen,), (took,), (exposed,) = book.visits(), book.stages(), book.exposures()
    assert (seen.dither, seen.attempt, seen.state, seen.rms_um, seen.utc_end) == (
        1,
        2,
        "done",
        1.5,
        after(60),
    )
    assert (took.name, took.duration_s, took.utc_start) == ("blind", 30.0, after(5))
    assert exposed.utc_end - exposed.utc_start == timedelta(seconds=900)
    with pytest.raises(InputError):
        book.ask_exposure(visit, 1, "key", 900.0)  # the shutter opens once for a key


def test_an_alarm_stays_until_its_cause_is_gone_and_a_person_has_seen_it(book):
    for k in range(3):
        book.raise_alarm(after(k), "camera", Severity.MAJOR, "camera", f"no image {k}")
    book.raise_alarm(after(3), "camera", Severity.MAJOR, "second camera", "no image")
    first, second = book.alarms()
    assert (first.count, first.text, first.since, first.last) == (3, "no image 2", EVENING, after(2))
    book.clear_alarm(after(4), "camera", "camera")
    assert not book.alarms()[0].over
    book.acknowledge(first.id, after(5), "ann")
    book.acknowledge(first.id, after(6), "bob")
    assert book.alarms()[0].over
    assert book.alarms()[0].acknowledged_by == "ann"
    assert not second.over
    book.raise_alarm(after(7), "camera", Severity.MAJOR, "camera", "again")
    assert [alarm.count for alarm in book.alarms()] == [3, 1, 1]


def test_a_command_that_comes_twice_is_on_record_once(book):
    assert book.note_command(EVENING, "ann", "skip a", "done", key="k1")
    assert not book.note_command(after(1), "ann", "skip a", "done", key="k1")
    assert book.note_command(after(2), "ann", "pause", "done")
    assert [c.command for c in book.commands()] == ["skip a", "pause"]


def test_fields_keep_their_order_and_their_last_state(book):
    book.note_field("b", "{}", "queued")
    book.note_field("a", "{}", "queued")
    book.note_field("b", "{}", "done")
    assert [(f.name, f.state) for f in book.fields()] == [("b", "done"), ("a", "queued")]
