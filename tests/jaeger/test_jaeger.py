"""The real jaeger, unmodified, drives `fiberloom twin` over its own CAN@net interface.

Needs `make jaeger` once: jaeger 1.11.1 in an environment of its own, `.venv-jaeger`.
"""

import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from fiberloom.commands.twin import jaeger_config
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin.server import Address

ROOT = Path(__file__).resolve().parents[2]
JAEGER_PYTHON = Path(os.environ.get("FIBERLOOM_JAEGER_PYTHON", ROOT / ".venv-jaeger" / "bin" / "python"))

pytestmark = [
    pytest.mark.jaeger,
    pytest.mark.xdist_group("jaeger"),
    pytest.mark.skipif(
        not JAEGER_PYTHON.exists(),
        reason="the real jaeger is not here: `make jaeger` puts it into .venv-jaeger",
    ),
]

MISS_DEG = 0.01
"""Between the commanded and the reported angle; jaeger itself is content with 0.1."""


class Lines:
    """Lines of a process, with a time limit."""

    def __init__(self, stream):
        self.seen = []
        self._queue = queue.Queue()
        threading.Thread(target=self._read, args=(stream,), daemon=True).start()

    def _read(self, stream):
        for line in stream:
            self.seen.append(line)
            self._queue.put(line)
        self._queue.put(None)

    def wait_for(self, start, timeout_s):
        while (line := self._queue.get(timeout=timeout_s)) is not None:
            if line.startswith(start):
                return line[len(start) :]
        raise AssertionError("".join(self.seen[-40:]))


def processed(command, **kwargs):
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **kwargs
    )


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Served:
    """`fiberloom twin` in a process of its own."""

    def __init__(self, port, *options):
        command = [sys.executable, "-m", "fiberloom.cli", "twin", "--listen", f"127.0.0.1:{port}", *options]
        self.process = processed(command)
        self.lines = Lines(self.process.stdout)

    def __enter__(self):
        self.lines.wait_for("", 60)
        return self

    def __exit__(self, *error):
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(20) == 0, self.lines.seen


class Jaeger:
    """One process of jaeger that runs scenarios. Its configuration is what `--jaeger-config` writes."""

    def __init__(self, folder):
        self.folder = folder

    def start(self, port, devices):
        config = self.folder / "jaeger.yml"
        config.write_text(
            jaeger_config([Address(f"127.0.0.{k + 1}", port) for k in range(devices)], self.folder)
        )
        environment = {"PATH": os.environ["PATH"], "HOME": str(self.folder), "OBSERVATORY": "APO"}
        environment |= {"JAEGER_APO_CONFIG_PATH": str(config), "MPLCONFIGDIR": str(self.folder)}
        drive = [str(JAEGER_PYTHON), str(Path(__file__).with_name("jaeger_drive.py"))]
        self.process = processed(drive, env=environment, cwd=self.folder)
        self.lines = Lines(self.process.stdout)
        self.lines.wait_for("RESULT ", 120)

    def run(self, scenario, timeout_s=90, **job):
        job |= {"scenario": scenario, "profile": "twin"}
        self.process.stdin.write(json.dumps(job) + "\n")
        self.process.stdin.flush()
        answer = json.loads(self.lines.wait_for("RESULT ", timeout_s))
        assert "error" not in answer, answer["error"] + "".join(self.lines.seen[-60:])
        return answer


PORT = free_port()


@pytest.fixture(scope="module")
def jaeger(tmp_path_factory):
    it = Jaeger(tmp_path_factory.mktemp("jaeger"))
    it.start(PORT, devices=6)
    yield it
    it.process.kill()
    it.process.wait()


@pytest.fixture(scope="module")
def ten():
    """Ten positioners in the middle of the focal plane, neighbours on, in real time."""
    with Served(PORT, "--positioners", "10") as served:
        yield served


def facing_neighbours(count=10):
    """Two positioners and angles at which each reaches for the other's centre."""
    plane = generate(load_instrument("sdssv"), 0, n_positioners=count)
    first, second = map(int, plane.neighbour_pairs()[0])
    middle = (plane.centres_mm[first] + plane.centres_mm[second]) / 2.0
    goals = {}
    for mine in (first, second):
        reach_for = plane.centres_mm[mine] + 1.8 * (middle - plane.centres_mm[mine])
        found = plane.inverse([reach_for], index=[mine])
        goals[int(plane.positioner_id[mine])] = [float(found.alpha_deg[0]), float(found.beta_deg[0])]
    return goals


def test_initialise_status_goto_trajectory(jaeger, ten):
    answer = jaeger.run("moves")
    assert len(answer["ids"]) == 10
    assert answer["firmware"] == ["04.01.21"]
    assert answer["idle"]
    assert answer["initialised"]
    assert answer["closed_loop"]
    assert max(answer["misses_deg"].values()) < MISS_DEG, answer["misses_deg"]


def test_stop_on_the_way(jaeger, ten):
    answer = jaeger.run("stop")
    assert answer["was_moving"]
    assert answer["idle_after"]
    # two seconds of 12 deg/s, at most: nobody was near the goal of 90
    assert all(26.0 < alpha < 80.0 for alpha, _ in answer["stopped_at"]), answer["stopped_at"]
    assert answer["miss_deg"] < MISS_DEG


def test_collision_locks_and_unlock_frees(jaeger, ten):
    goals = facing_neighbours()
    answer = jaeger.run("collision", goals=goals)
    assert answer["locked"], answer
    assert "locked" in answer["why"]
    assert set(answer["locked_by"]) <= set(goals)
    assert answer["locked_by"]
    assert answer["collided"]
    assert answer["refused_while_locked"]
    assert not answer["locked_after"]
    assert answer["miss_deg"] < MISS_DEG


def test_calibrations_and_homing(jaeger):
    # on a bench, and ten times as fast: nobody wants to watch a datum search
    with Served(PORT, "--positioners", "2", "--no-neighbours", "--speed", "10"):
        answer = jaeger.run("calibrations")
    for step in ("hall_and_datum", "cogging_accepted", "cogging", "saved", "homed"):
        assert answer[step], (step, answer)
    assert all(abs(angle) < MISS_DEG for row in answer["home_deg"] for angle in row), answer["home_deg"]
    assert answer["miss_deg"] < MISS_DEG


def test_firmware_upgrade(jaeger, tmp_path):
    image = tmp_path / "tendo_v04.01.22.bin"
    image.write_bytes(bytes(range(256)) * 4 + b"tail")  # 1028 bytes: the last frame is shorter
    with Served(PORT, "--positioners", "3", "--bootloader"):
        answer = jaeger.run("upgrade", image=str(image))
    assert answer["bootloader"]
    assert answer["firmware"] == ["04.80.21"]
    assert answer["loaded"]
    assert answer["check_ok"]
    assert answer["firmware_after"] == ["04.01.21"]
    assert answer["idle"]


@pytest.mark.long
def test_the_whole_array(jaeger):
    with Served(PORT, "--positioners", "500"):
        answer = jaeger.run("array", timeout_s=150)
    assert answer["count"] == 500
    assert max(answer["misses_deg"].values()) < MISS_DEG, answer["misses_deg"]
