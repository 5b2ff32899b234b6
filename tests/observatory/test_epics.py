"""A client of Channel Access by others reads the state, sees an alarm and stops a motion, over loopback."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from observed import BUS, PLANE, free_port

from fiberloom.errors import InputError
from fiberloom.observatory import epics
from fiberloom.observatory.network import Endpoint

pytest.importorskip("softioc", reason="pip install 'fiberloom[epics]': EPICS")
client = pytest.importorskip("caproto.sync.client", reason="pip install caproto: an EPICS client")
HERE = Path(__file__).resolve().parent


class Ioc:
    """A process that serves, and its records as a client has them."""

    def __init__(self, process):
        self.process = process

    def tell(self, word):
        """Where fibres are after that, (N, 2) mm."""
        self.process.stdin.write(f"{word}\n")
        self.process.stdin.flush()
        return np.array(json.loads(self.process.stdout.readline()))

    def read(self, name):
        """Value and severity of a record."""
        found = client.read(f"FPS:{name}", data_type="time", timeout=10.0, repeater=False)
        data = found.data[0] if found.data.dtype.kind != "u" or name == "STATE" else bytes(found.data)
        value = data.split(b"\0")[0].decode() if isinstance(data, bytes) else data
        value = epics.STATES[int(value)] if name == "STATE" else value
        return value, int(found.metadata.severity)

    def write(self, name, value):
        client.write(f"FPS:{name}", value, timeout=10.0, repeater=False)

    def until(self, name, wanted, within_s=60.0):
        """Waits for a value; with its severity."""
        end_s = time.monotonic() + within_s
        right = wanted if callable(wanted) else lambda value: value == wanted
        while not right((found := self.read(name))[0]):
            assert time.monotonic() < end_s, (name, found, wanted)
            time.sleep(0.05)
        return found


@pytest.fixture(scope="module")
def ioc(tmp_path_factory):
    folder, port = tmp_path_factory.mktemp("ioc"), free_port()
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("ADDR_LIST", "127.0.0.1"), ("AUTO_ADDR_LIST", "NO"), ("SERVER_PORT", str(port))):
            patch.setenv(f"EPICS_CA_{name}", value)
        with subprocess.Popen(
            [sys.executable, str(HERE / "ioc.py"), str(folder), "FPS", str(port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])},
        ) as process:
            line = process.stdout.readline()
            while line and line != "ready\n":  # what EPICS says of itself
                line = process.stdout.readline()
            yield Ioc(process)
            process.stdin.close()


def test_a_client_reads_the_state_and_stops_a_motion(ioc):
    assert ioc.until("STATE", "off") == ("off", 0)
    ioc.until("ADDRESS", BUS)  # records are written one after the other
    ioc.until("POSITIONERS", 7)
    beat = ioc.read("HEARTBEAT")[0]
    ioc.until("HEARTBEAT", lambda now: now > beat)
    ioc.tell("slow")
    ioc.write("PARK", 1)
    ioc.until("STATE", "moving")
    ioc.write("HOME", 1)
    said = ioc.until("SAID", lambda text: text.startswith("refused: park of EPICS runs since"))
    assert said[1] == 1
    ioc.write("STOP", 1)
    ioc.until("SAID", "park has ended; the array is stopped")
    ioc.until("STATE", "stopped")
    # the second where the store was slow to say who asked, and the command was ended from here
    assert ioc.read("TEXT")[0] in ("stopped by EPICS", "stopped by the operator")
    still_mm, later_mm = ioc.tell("fast"), ioc.tell("run")
    assert np.abs(later_mm - still_mm).max() < 1e-3
    assert np.hypot(*(still_mm - PLANE.forward(*PLANE.park_deg.T)).T).max() > 1.0  # it was on the way
    ioc.write("CONFIGURE", "list.csv")
    ioc.until("SAID", "configure has begun")
    ioc.until("COMMAND", "observe of EPICS")
    ioc.until("COMMAND", "")
    ioc.until("STATE", "idle")


def test_a_client_sees_an_alarm_come_and_go(ioc):
    ioc.tell("lock")
    assert ioc.until("STATE", "locked") == ("locked", 2)
    text, severity = ioc.read("ALARM")
    assert "collision of positioners 3, 4" in text
    assert severity == 2
    assert ioc.until("ALARMS", 1) == (1, 2)
    ioc.write("PARK", 1)
    said, severity = ioc.until("SAID", lambda text: text.startswith("refused: "))
    assert "fiberloom recover" in said
    assert severity == 1
    ioc.tell("free")
    assert ioc.until("STATE", "idle") == ("idle", 0)
    assert ioc.read("ALARM") == ("", 0)


def test_what_cannot_be_served_is_told(monkeypatch):
    endpoint = Endpoint("127.0.0.1", free_port())
    with pytest.raises(InputError, match="prefix 'F P': letters, digits"):
        epics.EpicsIoc(None, "F P", endpoint)
    monkeypatch.setattr(epics, "_begun", True)
    with pytest.raises(InputError, match="this process has an IOC; another one needs its own process"):
        epics.EpicsIoc(None, "FPS", endpoint)


def test_every_state_has_a_place_in_a_record():
    assert len(epics.STATES) <= 16  # of mbbi
    assert all(len(state) < 26 for state in epics.STATES)
