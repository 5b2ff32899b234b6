"""Arrays in the store: one owner at a time, exclusions, places; older stores get the tables."""

import os
import subprocess
import sys
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.store import Store
from fiberloom.store.arrays import STALE_S, ArrayBook, ArrayPlaces, NotOwner, arrays_of
from fiberloom.store.schema import ARRAY_STATE
from fiberloom.store.sums import change

BUS = "cannet://10.1.10.31:19228"
IDS = np.array([4, 9, 12])


@pytest.fixture
def book(place):
    with Store.open(place) as store:
        yield ArrayBook(store, BUS)


def backdate(book, **values):
    with book.store.transaction() as connection:
        change(connection, ARRAY_STATE, ARRAY_STATE.c.address == BUS, values)


def dead_pid():
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    return process.pid


def test_one_owner_at_a_time(book):
    token, before = book.take("fiberloom park", "connecting")
    assert (before.state, before.token) == ("off", "")
    with pytest.raises(InputError, match=f"in use by `fiberloom park` .process {os.getpid()} on"):
        book.take("fiberloom home", "connecting")
    book.release(token, "parked", "folded")
    second, before = book.take("fiberloom home", "connecting")
    assert (before.state, before.text) == ("parked", "folded")
    assert second != token


def test_another_array_is_another_lock(book):
    book.take("fiberloom park", "connecting")
    ArrayBook(book.store, "socketcan:can0").take("fiberloom park", "connecting")
    assert arrays_of(book.store) == [BUS, "socketcan:can0"]


def test_an_owner_whose_process_is_gone_loses_it(book):
    first, _ = book.take("fiberloom observe t.csv", "moving")
    backdate(book, pid=dead_pid())
    _, before = book.take("fiberloom park", "connecting")
    assert (before.state, before.stale, before.command) == ("moving", True, "fiberloom observe t.csv")
    with pytest.raises(NotOwner, match="nothing more is moved"):
        book.beat(first)
    with pytest.raises(NotOwner):
        book.enter(first, "idle")
    book.release(first, "off")
    assert book.state().command == "fiberloom park"


def test_an_owner_without_a_sign_of_life_loses_it(book):
    token, _ = book.take("fiberloom observe t.csv", "moving")
    backdate(book, heartbeat=datetime.now(UTC) - timedelta(seconds=0.8 * STALE_S))
    assert book.state().owned
    backdate(book, heartbeat=datetime.now(UTC) - timedelta(seconds=1.2 * STALE_S))
    assert not book.state().owned
    book.beat(token)
    assert book.state().owned
    backdate(book, heartbeat=datetime.now(UTC) - timedelta(seconds=1.2 * STALE_S), host="far")
    assert book.take("fiberloom park", "connecting")[1].host == "far"


def test_processes_that_take_it_in_the_same_moment(tmp_path):
    code = (
        "import sys\nfrom fiberloom.store import Store\nfrom fiberloom.store.arrays import ArrayBook\n"
        "from fiberloom.errors import InputError\n"
        "try:\n    print(ArrayBook(Store.open(sys.argv[1]), 'b').take('x', 'idle')[0])\n"
        "except InputError:\n    print('no')\ninput()"
    )
    words = [sys.executable, "-c", code, str(tmp_path / "s.sqlite")]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    processes = [subprocess.Popen(words, **pipes) for _ in range(4)]
    said = [p.stdout.readline().strip() for p in processes]
    for p in processes:
        p.communicate("\n")
    assert sorted(word == "no" for word in said) == [False, True, True, True]


def test_a_stop_is_asked_of_the_owner(book):
    assert not book.ask_stop("ann")
    token, _ = book.take("fiberloom observe t.csv", "moving")
    assert book.ask_stop("ann")
    assert book.state().stop_asked_by == "ann"
    book.release(token, "stopped")
    assert (book.state().stop_asked_by, book.state().token) == ("", "")


def test_an_array_that_was_never_owned_can_be_noted_stopped(book):
    book.note_stopped("stopped by ann", "stopped")
    assert (book.state().state, book.state().text, book.state().owned) == ("stopped", "stopped by ann", False)


def test_exclusions_have_an_author_a_reason_and_an_end(book):
    soon = datetime.now(UTC) + timedelta(hours=1)
    book.exclude([12, 4], "ann", "beta slips", soon)
    book.exclude([4, 9], "bob", "another reason")
    assert [(e.positioner_id, e.who, e.why) for e in book.exclusions()] == [
        (4, "ann", "beta slips"),
        (9, "bob", "another reason"),
        (12, "ann", "beta slips"),
    ]
    assert book.exclusions()[0].until == soon
    assert book.clear([9], "ann") == [9]
    with pytest.raises(InputError, match="positioner 9 is not excluded"):
        book.clear([9], "ann")
    past = book.exclusions(past=True)
    assert [(e.positioner_id, e.cleared_by) for e in past if e.cleared] == [(9, "ann")]
    assert ArrayBook(book.store, "other").exclusions() == []


def test_an_exclusion_ends_by_itself(book):
    book.exclude([4], "ann", "warm motor", datetime.now(UTC) - timedelta(seconds=1))
    assert book.exclusions() == []
    assert len(book.exclusions(past=True)) == 1
    book.exclude([4], "ann", "warm again")
    assert [e.why for e in book.exclusions()] == ["warm again"]


def places(angle, how="seen", datum=True, n=3):
    return ArrayPlaces(
        np.full((n, 2), angle), np.full((n, 2), angle + 0.5), [how] * n, np.full(n, datum), [None] * n
    )


def test_places_are_the_last_ones_and_unknown_ones_keep_theirs(book):
    assert np.isnan(book.places(IDS).angles_deg).all()
    book.note_places(IDS, places(10.0))
    later = places(20.0, "reported", datum=False)
    later.angles_deg[1] = np.nan
    later.wire_deg[2] = np.nan
    book.note_places(IDS, later)
    found = book.places(np.array([12, 9, 4, 77]))
    np.testing.assert_array_equal(found.angles_deg[:, 0], [20.0, 10.0, 20.0, np.nan])
    np.testing.assert_array_equal(found.wire_deg[:, 0], [np.nan, 10.5, 20.5, np.nan])
    assert found.how == ["reported", "seen", "reported", "unknown"]
    assert found.datum.tolist() == [False, True, False, False]
    assert abs((datetime.now(UTC) - found.utc[0]).total_seconds()) < 60
    assert found.utc[3] is None
