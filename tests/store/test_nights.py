"""The record of a night: what was written comes back, alarms are latched, one process has it."""

import subprocess
from datetime import UTC, datetime, timedelta

import pytest

from fiberloom.errors import InputError
from fiberloom.night.asked.orders import QueueOrders
from fiberloom.night.overhead import learned_s
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.nights.book import NightBook, night_of, nights
from fiberloom.store.schema import NIGHTS, SUM
from fiberloom.store.service.alarms import Severity
from fiberloom.store.service.commands import CommandBook, CommandResult
from fiberloom.store.service.history import positioner_history

EVENING = datetime(2026, 11, 25, 18, 0, tzinfo=UTC)
ABOUT = {
    **{"name": "n", "queue": "night.toml", "array": "twin:1", "instrument": "sdssv", "config_hash": "c"},
    **{"seed": 3, "command_line": "fiberloom night night.toml"},
}


def after(seconds):
    return EVENING + timedelta(seconds=seconds)


@pytest.fixture
def book(place):
    with Store.open(place) as store:
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
    book._change(NIGHTS, book.id, {"pid": child.pid})
    book.take_over()
    assert book.about.goes_on


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


def test_orders_to_a_night_and_a_positioners_alarms_come_back(book):
    """What the page and `fiberloom history` ask of a store: the same on both databases."""
    commands = CommandBook(ArrayBook(book.store, "twin:1"))
    number = commands.begin("ann", "operator", "skip", {"field": "a"}, night=book.id)
    commands.end(number, CommandResult.DONE)
    refused = commands.begin("bob", "operator", "skip", {"field": "b"}, night=book.id)
    commands.end(refused, CommandResult.REFUSED, "no such field")
    assert QueueOrders.of(book.commands()).skipped == {"a": "by ann"}
    book.raise_alarm(after(1), "collision", Severity.CRITICAL, "positioner 4", "it has collided")
    found = positioner_history(book.store, 4)
    assert [(a["code"], a["night_id"]) for a in found["alarms"]] == [("collision", book.id)]
    assert (found["measurements"], found["events"], found["exclusions"]) == ([], [], [])
    assert not {"id", SUM} & found["alarms"][0].keys()  # what only the store itself is asked for
    assert positioner_history(book.store, 5)["alarms"] == []


def test_overheads_are_learnt_from_the_night_and_from_the_one_before(book):
    assert learned_s(book, dithered=False) is None
    for dither, (begin_s, ready_s) in enumerate([(0, 30), (100, 104)]):
        which = {"field": "a", "repeat": 0, "dither": dither, "attempt": 1}
        visit = book.begin_visit(after(begin_s), "positioning", which)
        exposure = book.ask_exposure(visit, 1, f"k{dither}", 60.0)
        book.change_exposure(exposure, utc_start=after(ready_s), utc_end=after(ready_s + 60))
        book.change_visit(visit, state="done", utc_end=after(ready_s + 60))
        steps = {"begin check": 0.5, "blind": 22.0, "correction 1": 1.0, "correction 2": 2.0}
        for name, lasts_s in steps.items() if dither == 0 else ():
            stage = {"visit_id": visit, "name": f"position: {name}", "outcome": "done"}
            book.note_stage(after(begin_s), {**stage, "duration_s": lasts_s, "wall_s": 0.1})
        if dither == 0:  # a blind move as short as a correction: 0.5 + 1.5 + 3
            assert learned_s(book, dithered=True) == 5.0
    assert (learned_s(book, dithered=False), learned_s(book, dithered=True)) == (30.0, 4.0)
    later = NightBook.begin(book.store, after(9000), ABOUT)
    assert (learned_s(later, dithered=False), learned_s(later, dithered=True)) == (30.0, None)
    other = NightBook.begin(book.store, after(9000), ABOUT | {"config_hash": "another layout"})
    assert learned_s(other, dithered=False) is None
