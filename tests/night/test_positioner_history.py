"""`fiberloom history`: one positioner over runs and nights, as the store has it."""

import json

import numpy as np
import pytest
from nights import Night

from fiberloom.store.service.alarms import Severity
from fiberloom.store.service.history import nights_of, positioner_history

QUEUE = '[[field]]\nid = "a"\ntargets = "a.csv"\nexposure_s = 10\n'


@pytest.fixture(scope="module")
def night(tmp_path_factory):
    """Two nights of one field; one positioner was excluded, and had an alarm."""
    night = Night(tmp_path_factory.mktemp("history"), QUEUE)
    night.run()
    night.run()
    night.number = int(night.plane.positioner_id[0])
    array = night.setup().array.book
    array.exclude([night.number], "ann", "it squeaks", None)
    array.clear([night.number], "bob")
    subject = f"positioner {night.number}"
    night.book.raise_alarm(night.book.about.utc_start, "alarm", Severity.MAJOR, subject, "it is warm")
    night.book.raise_alarm(night.book.about.utc_start, "alarm", Severity.MAJOR, subject + "0", "another one")
    return night


def test_a_positioner_is_told_over_nights_as_the_store_has_it(fl, night):
    code, told, _ = fl("history", night.number, night.folder, "--json")
    (one,) = json.loads(told)["stores"]
    assert code == 0
    errors = []
    for visit in night.store.runs():
        rows = night.store.measurements(visit.id)
        mine = (rows["positioner_id"] == night.number) & np.isfinite(rows["error_um"])
        errors += rows["error_um"][mine].tolist()
    shown = [m["error_um"] for m in one["measurements"] if m["error_um"] is not None]
    assert shown == errors[::-1]
    assert {(m["night"], m["field"]) for m in one["measurements"] if m["target_id"] is not None} == {
        (1, "a"),
        (2, "a"),
    }
    (gone,) = one["exclusions"]
    assert (gone["who"], gone["why"], gone["cleared_by"]) == ("ann", "it squeaks", "bob")
    assert [a["text"] for a in one["alarms"]] == ["it is warm"]
    assert [n["night"] for n in one["nights"]] == [2, 1]


def test_the_table_and_what_is_not_there(fl, night, tmp_path):
    code, told, _ = fl("history", night.number, night.folder)
    assert code == 0
    for words in ("nights", "measurements", "it squeaks", "it is warm"):
        assert words in told
    code, _, said = fl("history", 999, night.folder)
    assert (code, "positioner 999: nothing on record" in said) == (2, True)
    code, _, said = fl("history", 1, tmp_path / "none")
    assert code == 2


def test_a_night_is_told_by_what_the_last_move_of_each_run_has_left(night):
    found = positioner_history(night.store, night.number)["measurements"]
    (last, first) = nights_of(found)
    runs = {m["run"]: m["error_um"] for m in reversed(found) if m["error_um"] is not None}
    assert [last["median_um"], first["median_um"]] == list(runs.values())[::-1]
    assert nights_of([]) == []
