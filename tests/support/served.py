"""A served array of seven positioners on the virtual twin, for the tests of the service."""

import contextlib
import json
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request

import uvicorn
from starlette.testclient import TestClient

from fiberloom.connect import open_hardware
from fiberloom.field import Field
from fiberloom.instruments import generate, load_instrument
from fiberloom.service.array import Author, ServedArray
from fiberloom.service.guard.tokens import Identity, Role
from fiberloom.service.guard.wall import Gate, hosts_of
from fiberloom.service.hub import Hub
from fiberloom.service.night.served_night import NightPace, ServedNight
from fiberloom.service.pace import PacedSource
from fiberloom.service.web.app import application
from fiberloom.service.web.target_root import TargetRoot
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.targets import random_targets, write_targets

N = 7
HOST, PORT = "127.0.0.1", 8080
OURS = {"X-Fiberloom": "1", "Origin": f"http://{HOST}:{PORT}"}
STREAM = f"ws://{HOST}:{PORT}/api/v1/stream"
ANN = Author("ann", "engineer")
THREE_FIELDS = """
begin = 2026-11-25T18:00:00Z
dawn = 2026-11-25T20:00:00Z
require = 1.0
attempts = 1
[[field]]
id = "a"
targets = "targets/t.csv"
exposure_s = {long_s}
exposures = 2
[[field]]
id = "b"
targets = "targets/t.csv"
exposure_s = {short_s}
[[field]]
id = "left"
targets = "targets/t.csv"
exposure_s = {short_s}
"""
"""A queue of an array with one dark fibre: each field is exposed once, with an alarm, and is not done."""
PATIENCE_S = 60.0
"""What comes by itself may take so long on a machine with other work."""


def plane_of(n=N):
    return generate(load_instrument("sdssv"), seed=0, n_positioners=n)


@contextlib.contextmanager
def served(folder, speed=None, faults="", n=N):
    """The array with maps and a target list `t.csv`; virtual seconds a second, None: as quick as it goes."""
    plane = plane_of(n)
    source = open_hardware(plane, "twin:", "noise", faults=faults)
    (folder / "targets").mkdir(exist_ok=True)
    write_targets(random_targets(plane, 20 * n, 1), folder / "targets" / "t.csv")
    with Store.open(folder / "store.sqlite") as store:
        field = Field(plane, source if speed is None else PacedSource(source, speed))
        array = ServedArray(field, ArrayBook(store, "twin:test"), "twin:", folder, Hub())
        array.begin()
        try:
            idle(array)
            yield array
        finally:
            array.close()


@contextlib.contextmanager
def served_night(array, queue_file):
    """The night of a queue on an array at a pace of 20; while a shutter is open at 200."""
    source = array.field.source
    night = ServedNight(array, queue_file, NightPace(source, source.speed, 10 * source.speed))
    night.start()
    try:
        yield night
    finally:
        array.stop_own(ANN)
        idle(array)
        night.close()


@contextlib.contextmanager
def served_three_fields(folder, long_s, short_s):
    """An array with one dark fibre and its night, which waits to be begun."""
    (folder / "q.toml").write_text(THREE_FIELDS.format(long_s=long_s, short_s=short_s))
    with (
        served(folder, speed=20.0, faults="dark=1") as array,
        served_night(array, folder / "q.toml") as night,
    ):
        yield array, night


def idle(array):
    """Waits until no command runs."""
    wait_for(lambda: array.running is None)


def wait_for(condition):
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, "it does not come"
        time.sleep(0.02)


def gate(tokens=None, port=PORT, scheme="http"):
    return Gate(hosts_of(HOST, port, ()), scheme, tokens, Identity("local", Role.ENGINEER))


@contextlib.contextmanager
def asking(array, folder, tokens=None, headers=OURS, night=None):
    """A client of the service, without a network."""
    app = application(array, gate(tokens), TargetRoot(folder / "targets"), night)
    with TestClient(app, base_url=f"http://{HOST}:{PORT}", headers=headers) as client:
        yield client


def free_port():
    """A port of this machine on which nothing listens."""
    with socket.socket() as made:
        made.bind((HOST, 0))
        return made.getsockname()[1]


class StartedService:
    """`fiberloom serve` as a process of its own, with these words; killed at the end of the block."""

    def __init__(self, *words):
        self.url = f"http://{HOST}:{(port := free_port())}"
        options = [*words, "--listen", f"{HOST}:{port}"]
        self.process = subprocess.Popen([sys.executable, "-m", "fiberloom.cli", "serve", *map(str, options)])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()

    def ask(self, path, body=None):
        """What is answered: to a command where there is a body."""
        headers = {"X-Fiberloom": "1", "Origin": self.url, "Content-Type": "application/json"}
        content = None if body is None else json.dumps(body).encode()
        with urllib.request.urlopen(urllib.request.Request(self.url + path, content, headers)) as answer:
            return json.load(answer)

    def asked(self, path):
        """The same; None while nothing listens, or it is not ready."""
        try:
            return self.ask(path)
        except OSError:
            return None

    def ready(self):
        """A command could begin."""
        return (
            all((self.asked("/readyz") or {"": False}).values())
            and self.ask("/api/v1/state")["running"] is None
        )

    def end(self):
        """By a signal; its exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(PATIENCE_S)


@contextlib.contextmanager
def listening(array, folder, sock, tokens=None, night=None):
    """The service on a socket, in a thread."""
    app = application(array, gate(tokens, sock.getsockname()[1]), TargetRoot(folder / "targets"), night)
    config = uvicorn.Config(app, ws="websockets-sansio", log_config=None, timeout_graceful_shutdown=1)
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [sock]}, daemon=True)
    thread.start()
    wait_for(lambda: server.started)
    try:
        yield f"http://{HOST}:{sock.getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join(PATIENCE_S)
