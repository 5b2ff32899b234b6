"""What people ask of a night that goes on: pause, skip, add, first, park; and what it foresees."""

import json
from datetime import UTC, datetime, timedelta

import pytest
from nights import Night

from fiberloom.errors import InputError
from fiberloom.night.asked.orders import ADD, PRIORITY, SKIP, QueueOrders, new_field, require_field
from fiberloom.night.foresee import Overheads, foresee
from fiberloom.night.queue import Queue
from fiberloom.night.step import Close, End, Expose, NightState, Park, Pause, Visited, VisitState, as_asked
from fiberloom.store.service.commands import CommandBook, CommandRecord, CommandResult

DUSK = datetime(2026, 1, 1, 18, tzinfo=UTC)
TWO = """
[[field]]
id = "a"
targets = "a.csv"
exposure_s = 30
exposures = 2
[[field]]
id = "b"
targets = "b.csv"
exposure_s = 20
"""
ANN = ("ann", "operator")


def queue(**more):
    fields = [
        {"id": "a", "targets": "a.csv", "exposure_s": 30, "exposures": 2},
        {"id": "b", "targets": "b.csv", "exposure_s": 20, "dithers_um": ((0, 0), (60, 0))},
    ]
    return Queue.model_validate({"dawn": DUSK + timedelta(hours=2), "field": fields, **more})


def said(command, result=CommandResult.DONE, **asked):
    return CommandRecord(1, DUSK, "ann", "operator", command, json.dumps(asked), "", DUSK, result, "")


def test_orders_change_the_queue_and_those_that_were_refused_do_not(tmp_path):
    (tmp_path / "n.csv").write_text("")
    new = {"id": "new", "targets": str(tmp_path / "n.csv"), "exposure_s": 5}
    orders = QueueOrders.of(
        [
            said(SKIP, field="a"),
            said(PRIORITY, field="b", priority=7.0),
            said(ADD, **new),
            said(SKIP, CommandResult.REFUSED, field="b"),
        ]
    )
    found = orders.applied(queue())
    assert [(e.id, e.priority, e.skip) for e in found.fields] == [
        ("a", 0, "by ann"),
        ("b", 7, ""),
        ("new", 0, ""),
    ]
    (tmp_path / "n.csv").unlink()  # its list has gone: the night goes on without it
    assert [e.id for e in orders.applied(queue()).fields] == ["a", "b"]


def test_a_field_that_cannot_be_added_is_told_why(tmp_path):
    with pytest.raises(InputError, match="field 'a': is in the queue already"):
        new_field(queue(), {"id": "a"}, tmp_path)
    with pytest.raises(InputError, match="exposure_s"):
        new_field(queue(), {"id": "c", "exposure_s": -1}, tmp_path)
    with pytest.raises(InputError, match="field 'z': not in the queue; it has a, b"):
        require_field(queue(), "z")


READY, DONE = VisitState.READY, VisitState.DONE
CUT = Close(VisitState.INTERRUPTED, "parked by bob")


@pytest.mark.parametrize(
    ("state", "step", "asked", "found"),
    [
        (NightState(), Expose(1), ("", ""), Expose(1)),
        (NightState(), Expose(1), ("ann", ""), Pause("ann")),
        (NightState(), End("dawn"), ("ann", ""), End("dawn")),
        (NightState(), Expose(1), ("ann", "bob"), Park("parked by bob")),
        (NightState((Visited("a", 0, 0, READY),)), Expose(1), ("", "bob"), CUT),
        (NightState((Visited("a", 0, 0, DONE),), True), Park(""), ("", "bob"), End("parked by bob")),
    ],
)  # fmt: skip
def test_what_people_ask_comes_before_the_queue(state, step, asked, found):
    assert as_asked(step, state, *asked) == found


def test_what_is_foreseen_is_what_the_night_does_by_its_own_rule():
    found = foresee(NightState(), queue(), DUSK, Overheads(25.0, 3.0))
    times = [
        (f.what, f.field, (f.begin - DUSK).total_seconds(), (f.end - DUSK).total_seconds()) for f in found
    ]
    assert times == [
        ("position", "a", 0, 25),
        ("expose", "a", 25, 85),
        ("position", "b", 85, 110),
        ("expose", "b", 110, 130),
        ("position", "b", 130, 133),
        ("expose", "b", 133, 153),
        ("park", "", 153, 178),
    ]
    late = foresee(NightState(), queue(), DUSK + timedelta(hours=3), Overheads(25.0, 3.0))
    assert late == []  # no visit, so nothing to park


def night_with(folder, texts, ask):
    """A night of two fields; `ask(setup, book, text)` is called once at each step that is in `texts`."""
    night = Night(folder, TWO)
    setup = night.setup()

    def progress(text):
        if text in texts:
            texts.remove(text)
            ask(setup, CommandBook(setup.array.book), text)

    night.ended = night.run(progress=progress, setup=setup)
    return night


def test_a_night_is_paused_between_exposures_and_goes_on(tmp_path):
    def ask(setup, book, text):
        if text == "pause":
            setup.control.go_on()
        else:
            setup.control.pause("ann")

    night = night_with(tmp_path, ["expose 1", "pause"], ask)
    assert night.ended.status == "finished"
    names = [(s.name, s.visit_id) for s in night.book.stages() if ":" not in s.name]
    assert names[:4] == [("position", 1), ("expose 1", 1), ("pause", None), ("expose 2", 1)]
    assert all(e.utc_end is not None for e in night.book.exposures())


def test_a_field_is_skipped_one_is_added_and_another_comes_first(tmp_path):
    def ask(setup, book, text):
        def note(command, **asked):
            number = book.begin(*ANN, command, asked, night=1)
            book.end(number, CommandResult.DONE)

        note(SKIP, field="a")
        note(ADD, id="new", targets=str(tmp_path / "c.csv"), exposure_s=10)
        note(PRIORITY, field="new", priority=5)

    night = night_with(tmp_path, ["expose 1"], ask)
    visits = [(v.field, v.state, v.note) for v in night.book.visits()]
    assert visits == [("a", "interrupted", "skipped: by ann"), ("new", "done", ""), ("b", "done", "")]
    assert len([e for e in night.book.exposures() if e.visit_id == 1]) == 1
    states = {f.name: (f.state, f.reason) for f in night.book.fields()}
    assert states["a"] == ("skipped", "by ann; 0 of 1 places done")
    assert [(c.author, c.command) for c in night.book.commands()] == [
        ("ann", SKIP),
        ("ann", ADD),
        ("ann", PRIORITY),
    ]
    assert not [alarm for alarm in night.book.alarms() if alarm.code == "visit"]  # as asked: no alarm


@pytest.mark.parametrize("text", ["blind", "expose 1"])
def test_a_night_parks_at_once_and_can_be_resumed(tmp_path, text):
    night = night_with(tmp_path, [text], lambda setup, book, text: setup.control.park("ann"))
    assert (night.ended.status, night.ended.why) == ("interrupted", "parked by ann")
    assert night.setup().array.book.state().state == "parked"
    (visit,) = night.book.visits()
    assert visit.state == "interrupted"
    assert len(night.book.exposures()) == (text == "expose 1")  # one that is open is not cut short
    assert all(e.utc_end - e.utc_start == timedelta(seconds=30) for e in night.book.exposures())
    assert night.run(resume=True).status == "finished"
    assert sum(e.utc_end is not None for e in night.book.exposures()) == 3
