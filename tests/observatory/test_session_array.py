"""An array as a control system has it: what it sees, which commands it accepts, how it stops."""

import time
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from observed import BUS, PLANE, HeldArray, observed

from fiberloom.errors import InputError
from fiberloom.observatory.alarms import alarms_of
from fiberloom.observatory.network import Endpoint, need
from fiberloom.operation.session.states import SessionState
from fiberloom.store.arrays import ArrayState
from fiberloom.store.service.alarms import Severity
from fiberloom.twin import Fault


@pytest.fixture
def array(tmp_path):
    made, _ = observed(tmp_path)
    yield made
    made.close()
    made._book.store.close()


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
    run = array._field.last
    assert run.summary()["n_assigned"] > 3


def test_a_motion_is_stopped_and_nothing_goes_on(array):
    held = array._field.source
    held.slow.set()
    array.park("ann")
    moving(array)
    with pytest.raises(InputError, match="park of ann is at work: wait for its end, or stop"):
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
    held = array._field.source
    held.slow.set()
    array.park("ann")
    moving(array)

    def broken(who):
        raise InputError("arrays.sqlite: disk I/O error")

    monkeypatch.setattr(array._book, "ask_stop", broken)
    assert array.stop("bob") == "park has ended; the array is stopped"
    assert array.view().state == "stopped"


def test_where_nothing_runs_here_whichever_process_moves_it_is_stopped(array, monkeypatch):
    class Stopped:
        def __init__(self, book, connect, shared, who):
            self.text = f"{who} stopped {book.address}, shared: {shared}"

        async def stop(self):
            return self

    monkeypatch.setattr("fiberloom.observatory.array.Stopper", Stopped)
    assert array.stop("bob") == f"bob stopped {BUS}, shared: False"
    array._bus = "twin:"
    assert array.stop("bob") == "nothing moves"


def test_lists_are_read_from_their_folder_alone(array, tmp_path):
    (tmp_path / "other.csv").write_text("x_mm,y_mm\n0,0\n")
    (tmp_path / "targets" / "linked.csv").symlink_to(tmp_path / "other.csv")
    for name in ("../other.csv", str(tmp_path / "other.csv"), "", "linked.csv", "none.csv"):
        with pytest.raises(InputError, match="no such list in"):
            array.configure("ann", name)
    assert not array.view().command


def test_a_command_that_fails_is_an_alarm_until_the_next_one(array, monkeypatch):
    held = array._field.source

    async def refuses():
        raise InputError("10.1.10.31: connection refused")

    monkeypatch.setattr(held, "open", refuses)
    array.park("ann")
    (alarm,) = ended(array).alarms
    assert (alarm.code, alarm.severity, alarm.text) == (
        "command",
        Severity.MAJOR,
        "park: 10.1.10.31: connection refused",
    )
    monkeypatch.undo()
    array.park("ann")
    assert ended(array).alarms == ()


def test_positioners_that_stay_behind_are_alarms_of_their_own(tmp_path):
    held = HeldArray()
    made, _ = observed(tmp_path, held)
    dead, excluded = PLANE.positioner_id[[2, 4]].tolist()
    held.twin.inject(Fault("dead", dead))
    made._book.exclude([excluded], "ann", "no power")
    made.park("ann")
    view = ended(made)
    assert view.excluded == (excluded,)
    assert f"positioner {dead}" in {alarm.subject for alarm in view.alarms}, view
    assert {alarm.code for alarm in view.alarms} == {"positioner"}
    made._book.store.close()


def test_a_store_that_cannot_be_read_is_an_alarm(array, monkeypatch):
    def broken():
        raise InputError("arrays.sqlite: file is not a database")

    monkeypatch.setattr(array._book, "state", broken)
    view = array.view()
    assert (view.state, view.severity, view.alarms[0].code) == ("unknown", Severity.CRITICAL, "store")


def row(state, token="", beat_s=0.0, **given):
    now = datetime.now(UTC)
    values = {"state": state, "since": now, "text": "", "token": token, "command": "fiberloom park"}
    values |= {"host": "far", "pid": 1, "process_start": "", "stop_asked_by": ""}
    return ArrayState(**values | {"heartbeat": now - timedelta(seconds=beat_s)} | given)


def test_alarms_the_worst_first():
    assert alarms_of(row("idle"), "", {}) == ()
    assert alarms_of(row("moving", token="a"), "", {}) == ()
    found = alarms_of(row("locked", text="collision of positioners 3, 4"), "park: no", {5: "dark"})
    assert [(a.code, a.severity.name) for a in found] == [
        ("collision", "CRITICAL"),
        ("command", "MAJOR"),
        ("positioner", "MINOR"),
    ]
    assert "collision of positioners 3, 4; look at" in str(found[0])
    assert found[2].subject == "positioner 5"
    (gone,) = alarms_of(row("moving", token="a", beat_s=100.0), "", {})
    assert (gone.code, gone.severity) == ("owner", Severity.MAJOR)
    # a recovery whose owner is gone leaves the array locked
    assert alarms_of(row("recovering", token="a", beat_s=100.0), "", {})[0].code == "collision"
    assert SessionState.LOCKED == "locked"


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
