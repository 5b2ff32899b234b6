"""An array as a control system has it: what it sees, which commands it accepts, how it stops."""

import time
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import numpy as np
import pytest
from observed import BUS, PLANE, HeldArray, observed

from fiberloom.errors import InputError
from fiberloom.observatory.network import Endpoint, need
from fiberloom.service.array import ServedArray
from fiberloom.store.arrays import ArrayState
from fiberloom.store.service.alarms import Severity
from fiberloom.twin import Fault


@pytest.fixture
def array(tmp_path):
    made, _ = observed(tmp_path)
    yield made
    made.close()
    made.book.store.close()


def ended(array, within_s=60.0):
    """Waits until no command runs; how the array is then."""
    end_s = time.monotonic() + within_s
    while array.view().command:
        assert time.monotonic() < end_s, array.view()
        time.sleep(0.02)
    return array.view()


def moving(array, within_s=60.0):
    end_s = time.monotonic() + within_s
    while (view := array.view()).state != "moving":
        assert time.monotonic() < end_s
        assert view.command, view
        time.sleep(0.01)


def test_park_then_a_target_list(array):
    before = array.view()
    assert (before.address, before.state, before.positioners) == (BUS, "off", 7)
    assert array.park("ann") == "park has begun"
    assert array.view().command == "park of ann"
    assert ended(array).state == "parked"
    assert array.configure("ann", "list.csv") == "configure has begun"
    view = ended(array)
    assert (view.state, view.alarms, view.severity) == ("idle", (), None), view
    run = array.field.last
    assert run.summary()["n_assigned"] > 3


def test_a_motion_is_stopped_and_nothing_goes_on(array):
    held = array.field.source
    held.slow.set()
    array.park("ann")
    moving(array)
    with pytest.raises(InputError, match="park of ann runs since"):
        array.home("bob")
    assert array.stop("bob") == "park has ended; the array is stopped"
    view = array.view()
    assert (view.state, view.text, view.command) == ("stopped", "stopped by bob", "")
    still_mm = held.twin.fibre_xy("metrology")
    held.twin.run(1.0)
    assert np.abs(held.twin.fibre_xy("metrology") - still_mm).max() < 1e-3
    parked_mm = PLANE.forward(*PLANE.park_deg.T)
    assert np.hypot(*(still_mm - parked_mm).T).max() > 1.0  # it was on the way
    held.slow.clear()
    array.park("bob")
    assert ended(array).state == "parked"


def test_a_command_is_stopped_without_a_store(array, monkeypatch):
    held = array.field.source
    held.slow.set()
    array.park("ann")
    moving(array)

    def broken(*_):
        raise InputError("arrays.sqlite: disk I/O error")

    monkeypatch.setattr(array.array.commands, "begin", broken)
    assert array.stop("bob") == "park has ended; the array is stopped"
    assert array.view().state == "stopped"


def test_where_nothing_runs_here_whichever_process_moves_it_is_stopped(array, monkeypatch):
    class Stopped:
        def __init__(self, book, halt, shared, who):
            self.text = f"{who} stopped {book.address}, shared: {shared}"

        async def stop(self):
            return self

    monkeypatch.setattr("fiberloom.service.array.Stopper", Stopped)
    assert array.stop("bob") == f"bob by the service stopped {BUS}, shared: False"
    array.array.bus = "twin:"
    assert array.stop("bob") == "nothing moves"


def test_lists_are_read_from_their_folder_alone(array, tmp_path):
    (tmp_path / "other.csv").write_text("x_mm,y_mm\n0,0\n")
    (tmp_path / "targets" / "linked.csv").symlink_to(tmp_path / "other.csv")
    for name in ("../other.csv", str(tmp_path / "other.csv"), "", "linked.csv", "none.csv"):
        with pytest.raises(InputError, match="target list"):
            array.configure("ann", name)
    assert not array.view().command


def test_a_command_that_fails_is_an_alarm_until_the_next_one(array, monkeypatch):
    held = array.field.source

    async def refuses():
        raise InputError("10.1.10.31: connection refused")

    monkeypatch.setattr(held, "open", refuses)
    array.park("ann")
    (alarm,) = ended(array).alarms
    assert (alarm.code, alarm.severity, alarm.text) == (
        "command",
        Severity.MAJOR,
        "10.1.10.31: connection refused",
    )
    monkeypatch.undo()
    array.park("ann")
    assert ended(array).alarms == ()


def test_positioners_that_stay_behind_are_alarms_of_their_own(tmp_path):
    held = HeldArray()
    made, _ = observed(tmp_path, held)
    dead, excluded = PLANE.positioner_id[[2, 4]].tolist()
    held.twin.inject(Fault("dead", dead))
    made.book.exclude([excluded], "ann", "no power")
    made.park("ann")
    view = ended(made)
    assert view.excluded == (excluded,)
    assert f"positioner {dead}" in {alarm.subject for alarm in view.alarms}, view
    assert {alarm.code for alarm in view.alarms} <= {"dead", "lying", "alarm"}, view
    made.close()
    made.book.store.close()


def test_a_store_that_cannot_be_read_is_an_alarm(array, monkeypatch):
    def broken():
        raise InputError("arrays.sqlite: file is not a database")

    monkeypatch.setattr(array.book, "state", broken)
    view = array.view()
    assert (view.state, view.severity, view.alarms[0].code) == ("unknown", Severity.CRITICAL, "store")


def test_an_owner_that_is_gone_is_an_alarm_until_the_next_look(array, monkeypatch):
    now = datetime.now(UTC)
    row = ArrayState("moving", now, "", "a", "park", "far", 1, "", now - timedelta(seconds=100), "")
    monkeypatch.setattr(array.book, "state", lambda: row)
    (alarm,) = array.view().alarms
    assert (alarm.code, alarm.severity) == ("owner", Severity.MAJOR)
    assert alarm.text.endswith("is gone; the array was moving")
    monkeypatch.undo()
    assert array.view().alarms == ()


@pytest.mark.parametrize(("silent_s", "owner"), [(0, "`park` (process 1 on far)"), (100, "")])
def test_an_owner_that_is_gone_keeps_no_button_of_the_page_from_use(silent_s, owner):
    """The next command takes the array over."""
    last = datetime.now(UTC) - timedelta(seconds=silent_s)
    row = ArrayState("moving", last, "", "a", "park", "far", 1, "", last, "")
    book = SimpleNamespace(address="b", state=lambda: row)
    assert ServedArray.state(SimpleNamespace(book=book, _running=None))["owner"] == owner


def test_a_locked_array_is_an_alarm_with_what_to_do(array):
    array.book.note_stopped("collision of positioners 3, 4", "locked")
    (alarm,) = array.view().alarms
    assert (alarm.code, alarm.severity, alarm.text) == (
        "collision",
        Severity.CRITICAL,
        "collision of positioners 3, 4",
    )
    assert "recover" in alarm.advice
    array.book.note_stopped("", "idle")
    assert array.view().alarms == ()


def test_addresses_beyond_loopback_only_where_the_network_is_trusted():
    assert str(Endpoint.parse("localhost", 4840)) == "127.0.0.1:4840"
    assert Endpoint.parse("127.0.0.1:5000", 4840).port == 5000
    with pytest.raises(InputError, match=r"'0\.0\.0\.0': any program there could move the array"):
        Endpoint.parse("0.0.0.0", 4840)
    assert Endpoint.parse("10.1.1.1", 4840, trusted_network=True).host == "10.1.1.1"
    for text in ("127.0.0.1:0", "127.0.0.1:70000", "127.0.0.1:x"):
        with pytest.raises(InputError, match=r"expected HOST\[:PORT\]"):
            Endpoint.parse(text, 4840)
    with pytest.raises(InputError, match="an IPv4 address is needed"):
        Endpoint.parse("fps.example.org", 4840)
    with pytest.raises(
        InputError, match=r"no_such_package is not installed: pip install 'fiberloom\[opcua\]'"
    ):
        need("no_such_package", "opcua")
