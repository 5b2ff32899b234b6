"""`fiberloom twin` from outside: it says where it listens, and ends well when told to."""

import json
import signal
import subprocess
import sys

import pytest

COMMAND = [sys.executable, "-m", "fiberloom.cli", "twin", "--positioners", "3", "--listen"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_with_a_report(number, tmp_path):
    config = tmp_path / "for_jaeger" / "jaeger.yml"
    options = ["127.0.0.1:19398", "--devices", "2", "--jaeger-config", str(config)]
    with subprocess.Popen([*COMMAND, *options], stdout=subprocess.PIPE, text=True) as served:
        greeting = served.stdout.readline()
        served.send_signal(number)
        rest, _ = served.communicate(timeout=20)
    assert served.returncode == 0
    assert greeting.startswith("3 positioners on 2 devices")
    assert "127.0.0.1:19398 to 127.0.0.2:19398" in greeting
    assert "kept" in rest
    profile = json.loads(config.read_text())["profiles"]["twin"]
    assert profile["channels"] == ["127.0.0.1", "127.0.0.2"]
    assert profile["port"] == 19398


def test_json_is_one_object(tmp_path):
    options = ["127.0.0.1:19397", "--stop-after", "0.2", "--json", "--faults", "lying=1@0.1"]
    done = subprocess.run([*COMMAND, *options], capture_output=True, text=True, timeout=60, check=True)
    report = json.loads(done.stdout)
    assert report["share_kept"] <= 1.0
    assert report["ticks"] + report["resting"] > 300
    assert report["happened"][0].endswith("s: lying positioner " + report["happened"][0].split()[-1])
