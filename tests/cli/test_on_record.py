"""`exclude` and `status`: what an operator writes on the record of an array, and reads there."""

import json
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook, ArrayPlaces

BUS = "cannet://10.1.10.31"


@pytest.fixture
def at(fl, tmp_path):
    """A command to one array, recorded in a store of the test."""
    store = tmp_path / "arrays.sqlite"

    def run(*words, bus=BUS):
        return fl(*words, "--store", store, *(["--bus", bus] if bus else []))

    run.store = store
    return run


def listed(at, *words):
    code, out, err = at("exclude", "list", "--json", *words)
    assert code == 0, err
    return json.loads(out)


def test_who_is_excluded_is_listed_with_reason_author_and_end(at):
    assert at("exclude", "list")[1] == "no positioner is excluded\n"
    code, out, _ = at(
        "exclude", "add", "12,204", "--why", "beta slips", "--who", "Ana", "--until", "2099-01-02"
    )
    assert (code, out) == (0, "excluded: 12, 204; from the next command on\n")
    rows = listed(at)
    assert [row["positioner"] for row in rows] == [12, 204]
    assert {(row["why"], row["who"], row["until"]) for row in rows} == {
        ("beta slips", "Ana", "2099-01-02T00:00:00+00:00")
    }
    _, out, _ = at("exclude", "list")
    assert "beta slips" in out
    assert "Ana" in out


def test_one_that_is_cleared_stays_on_the_list_of_the_past(at):
    at("exclude", "add", "12,204", "--why", "dark")
    code, out, _ = at("exclude", "clear", "12", "--who", "Bo")
    assert (code, out) == (0, "no longer excluded: 12\n")
    assert [row["positioner"] for row in listed(at)] == [204]
    (cleared,) = [row for row in listed(at, "--past") if row["cleared"]]
    assert cleared["positioner"] == 12
    assert cleared["cleared"].endswith(" by Bo")


def test_an_exclusion_ends_by_itself(at):
    soon = datetime.now(UTC) + timedelta(hours=2)
    there = soon.astimezone().isoformat(timespec="seconds")
    assert at("exclude", "add", "12", "--why", "warm", "--until", there)[0] == 0
    (row,) = listed(at)
    assert datetime.fromisoformat(row["until"]) == soon.replace(microsecond=0)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["add", "", "--why", "dark"], "which positioners? e.g. 12,40"),
        (["add", "12;13", "--why", "dark"], "12;13"),
        (["add", "12", "--why", "  "], "a reason is needed"),
        (["add", "12", "--why", "dark", "--until", "tomorrow"], "write a time as 2026-11-30"),
        (["add", "12", "--why", "dark", "--until", "2020-01-01"], "is over already; times are UTC"),
        (["clear", "12"], "12"),
    ],
)
def test_what_cannot_be_written_down_is_refused_in_one_line(at, words, told):
    code, out, err = at("exclude", *words)
    assert code == 2
    assert told in err
    assert len(err.splitlines()) == 1, err
    assert out == ""


def test_an_array_has_to_be_named(at):
    code, _, err = at("exclude", "list", bus=None)
    assert code == 2
    assert "--bus: which array?" in err


def test_of_no_array_nothing_is_on_record(at):
    for bus in (None, BUS):
        code, out, _ = at("status", bus=bus)
        assert code == 0
        assert "no array is on record" in out
    assert not at.store.exists()  # who only asks makes no store


def test_status_only_reads(at, monkeypatch):
    """Also beside a command that has the store, on media that cannot be written, and on a full disk."""
    at("exclude", "add", "204", "--why", "dark")
    monkeypatch.setattr(Store, "open", lambda *a, **k: pytest.fail("opened to write"))
    code, out, _ = at("status", "--json")
    assert code == 0
    assert json.loads(out)[0]["excluded"] == 1


def test_status_tells_what_is_on_record_of_every_array(at):
    with Store.open(at.store) as store:
        book = ArrayBook(store, "cannet://10.1.10.31:19228")
        angles_deg = np.array([[10.0, 170.0], [20.0, 65.5]])
        places = ArrayPlaces(
            angles_deg, angles_deg, ["seen", "reported"], np.array([True, False]), [None] * 2
        )
        book.note_places(np.array([12, 204]), places)
    at("exclude", "add", "204", "--why", "dark", bus="cannet://10.1.10.31:19228")
    code, out, _ = at("status", "--json", bus=None)
    assert code == 0
    (report,) = json.loads(out)
    assert report["state"] == "off"
    assert report["owner"] == "none"
    assert (report["positioners"], report["places seen"], report["places reported"]) == (2, 1, 1)
    assert (report["datum on record"], report["excluded"]) == (1, 1)
    assert report["exclusions"][0]["why"] == "dark"
    code, out, _ = at("status", "--places")
    assert code == 0
    for shown in ("off", "dark", "170", "seen", "reported"):
        assert shown in out
