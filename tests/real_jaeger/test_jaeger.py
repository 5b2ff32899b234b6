"""The real jaeger, unmodified, drives `fiberloom twin` over its own CAN@net interface.

Needs `make jaeger` once: jaeger 1.11.1 in an environment of its own, `.venv-jaeger`.
"""

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from programs import free_port

from fiberloom.instruments import generate, load_instrument
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.jaeger import jaeger_config

ROOT = Path(__file__).resolve().parents[2]
JAEGER_PYTHON = Path(os.environ.get("FIBERLOOM_JAEGER_PYTHON", ROOT / ".venv-jaeger" / "bin" / "python"))

pytestmark = [
    pytest.mark.jaeger,
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
        with contextlib.suppress(ValueError):  # closed
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


def closed(process):
    process.wait()
    process.stdin.close()
    process.stdout.close()


class Served:
    """`fiberloom twin` in a process of its own; which of jaeger's profiles finds it."""

    def __init__(self, profile, count, *options):
        where = f"127.0.0.1:{PORTS[profile]}"
        options = ("--listen", where, "--positioners", str(count), *options)
        self.process = processed([sys.executable, "-m", "fiberloom.cli", "twin", *options])
        self.lines = Lines(self.process.stdout)

    def __enter__(self):
        greeting = self.lines.wait_for("", 60)
        assert "positioners on" in greeting, greeting
        return self

    def __exit__(self, *error):
        self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(20)
        closed(self.process)
        assert code == 0, self.lines.seen


class Jaeger:
    """One process of jaeger that runs scenarios, each on a profile of its configuration.

    The configuration is what `--jaeger-config` writes, with a profile for each of our servers.
    """

    def __init__(self, folder, devices):
        config = json.loads(jaeger_config(addresses(PORTS["twin"], devices), folder))
        for name, port in PORTS.items():
            config["profiles"][name] = config["profiles"]["twin"] | {"port": port}
        path = folder / "jaeger.yml"
        path.write_text(json.dumps(config))
        environment = {"PATH": os.environ["PATH"], "HOME": str(folder), "MPLCONFIGDIR": str(folder)}
        environment |= {"OBSERVATORY": "APO", "JAEGER_APO_CONFIG_PATH": str(path)}
        drive = [str(JAEGER_PYTHON), str(Path(__file__).with_name("jaeger_drive.py"))]
        self.process = processed(drive, env=environment, cwd=folder)
        self.lines = Lines(self.process.stdout)

    def __enter__(self):
        self.lines.wait_for("RESULT ", 120)
        return self

    def __exit__(self, *error):
        self.process.kill()
        closed(self.process)

    def run(self, scenario, profile="twin", timeout_s=90, **job):
        job |= {"scenario": scenario, "profile": profile}
        self.process.stdin.write(json.dumps(job) + "\n")
        self.process.stdin.flush()
        answer = json.loads(self.lines.wait_for("RESULT ", timeout_s))
        print(scenario, answer)  # `pytest -m jaeger -rP` shows it
        assert "error" not in answer, answer["error"] + "".join(self.lines.seen[-60:])
        return answer


def addresses(port, devices):
    return [Address(f"127.0.0.{k + 1}", port) for k in range(devices)]


PROFILES = ("twin", "crowd", "bench", "boot", "array")
PORTS = {profile: free_port() for profile in PROFILES}


@pytest.fixture(scope="module")
def jaeger(tmp_path_factory):
    with Jaeger(tmp_path_factory.mktemp("jaeger"), devices=1) as it:
        yield it


@pytest.fixture(scope="module")
def ten():
    """Ten positioners in the middle of the focal plane, neighbours on, in real time."""
    with Served("twin", 10) as served:
        yield served


def facing_neighbours(count=10):
    """Two positioners and angles at which each reaches for the other's centre."""
    plane = generate(load_instrument("sdssv"), 0, n_positioners=count)
    pairs, centre = plane.neighbour_pairs(), plane.centres_mm
    nearest = np.argmin(np.hypot(*(centre[pairs[:, 0]] - centre[pairs[:, 1]]).T))
    goals = {}
    for mine, other in (pairs[nearest], pairs[nearest][::-1]):
        found = plane.inverse([centre[mine] + 0.95 * (centre[other] - centre[mine])], index=[mine])
        assert found.reachable.all()
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


def test_collision_locks_and_unlock_frees(jaeger):
    goals = facing_neighbours()
    # four times as fast: half a turn there, half a turn back
    with Served("crowd", 10, "--speed", "4"):
        answer = jaeger.run("collision", "crowd", goals=goals)
    assert answer["locked"], answer
    assert "locked" in answer["why"]
    assert set(answer["locked_by"]) <= set(goals)
    assert answer["locked_by"]
    assert answer["collided"]
    assert answer["refused_while_locked"]
    assert not answer["locked_after"]
    assert answer["miss_deg"] < MISS_DEG


@pytest.mark.long
def test_calibrations_and_homing(jaeger):
    # on a bench, and ten times as fast: nobody wants to watch a datum search
    with Served("bench", 2, "--no-neighbours", "--speed", "10"):
        answer = jaeger.run("calibrations", "bench")
    for step in ("hall_and_datum", "cogging_accepted", "cogging", "saved", "homed"):
        assert answer[step], (step, answer)
    assert all(abs(angle) < MISS_DEG for row in answer["home_deg"] for angle in row), answer["home_deg"]
    assert answer["miss_deg"] < MISS_DEG


@pytest.mark.long
def test_firmware_upgrade(jaeger, tmp_path):
    image = tmp_path / "tendo_v04.01.22.bin"
    image.write_bytes(bytes(range(256)) * 4 + b"tail")  # 1028 bytes: the last frame is shorter
    with Served("boot", 3, "--bootloader"):
        answer = jaeger.run("upgrade", "boot", image=str(image))
    assert answer["bootloader"]
    assert answer["firmware"] == ["04.80.21"]
    assert answer["loaded"]
    assert answer["check_ok"]
    assert answer["firmware_after"] == ["04.01.21"]
    assert answer["idle"]


@pytest.mark.long
def test_the_whole_array(tmp_path):
    with Served("array", 500), Jaeger(tmp_path, devices=6) as jaeger:
        answer = jaeger.run("array", "array", timeout_s=150)
    assert answer["count"] == 500
    assert max(answer["misses_deg"].values()) < MISS_DEG, answer["misses_deg"]
