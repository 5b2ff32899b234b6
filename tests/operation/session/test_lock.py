"""The lock in a process: signs of life, a stop that is asked for, an array that is lost."""

import subprocess
import sys
import time

import pytest

from fiberloom.errors import InputError
from fiberloom.operation.session import array_lock
from fiberloom.operation.session.array_lock import ArrayLock, state_of
from fiberloom.operation.session.states import Deed, SessionState, Step
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook, NotOwner
from fiberloom.store.schema import ARRAY_STATE
from fiberloom.store.sums import change

BUS = "socketcan:can0"


@pytest.fixture
def book(tmp_path):
    with Store.open(tmp_path / "arrays.sqlite") as store:
        yield ArrayBook(store, BUS)


def until(condition, within_s=5.0):
    end_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def backdate(book, **values):
    with book.store.transaction() as connection:
        change(connection, ARRAY_STATE, ARRAY_STATE.c.address == BUS, values)


def gone():
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    return process.pid


def test_signs_of_life_come_while_nothing_else_does(book, monkeypatch):
    monkeypatch.setattr(array_lock, "HEARTBEAT_S", 0.2)
    lock = ArrayLock(book, "x")
    lock.take(Deed.PARK, lambda why: None)
    first = book.state().heartbeat
    until(lambda: book.state().heartbeat > first)
    lock.release()
    assert not book.state().owned


def test_a_stop_reaches_the_owner_once(book):
    heard, lock = [], ArrayLock(book, "x")
    lock.take(Deed.PARK, heard.append)
    book.ask_stop("ann on console")
    until(lambda: heard)
    time.sleep(0.3)
    assert heard == ["stopped by ann on console"]
    lock.release()


def test_an_owner_that_lost_the_array_moves_nothing_more(book):
    heard, lock = [], ArrayLock(book, "x")
    lock.take(Deed.PARK, heard.append)
    backdate(book, token="another")
    until(lambda: heard)
    assert heard == ["another process has taken the array"]
    with pytest.raises(NotOwner, match="nothing more is moved"):
        lock.step(Step.ANSWER)
    lock.release()
    assert book.state().token == "another"


def test_an_array_whose_owner_died_in_motion_is_unknown_and_said_so(book):
    book.take("fiberloom observe t.csv", SessionState.MOVING)
    backdate(book, pid=gone())
    assert state_of(book.state()) is SessionState.UNKNOWN
    lock = ArrayLock(book, "fiberloom park")
    said = lock.take(Deed.PARK, lambda why: None)
    assert said.startswith("taken over from `fiberloom observe t.csv` (process ")
    assert said.endswith("which has ended without a word; it was moving")
    lock.release()
    assert book.state().state == SessionState.UNKNOWN  # nothing was seen by the new one


def test_a_lock_after_a_collision_outlives_its_process(book):
    book.take("fiberloom observe t.csv", SessionState.LOCKED)
    backdate(book, pid=gone(), text="collision of 4, 9")
    with pytest.raises(InputError, match=r"is locked .collision of 4, 9[)]:"):
        ArrayLock(book, "fiberloom park").take(Deed.PARK, lambda why: None)
