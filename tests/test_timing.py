"""Where the seconds of a command go."""

import re
import subprocess
import sys
import time

import pytest

from fiberloom import timing


@timing.part("inner")
def inner(how_s):
    time.sleep(how_s)


@timing.part("outer")
def outer():
    time.sleep(0.1)
    inner(0.2)
    time.sleep(0.1)


def test_a_part_within_a_part_counts_once():
    table = timing.begin()
    table.stage("one")
    outer()
    table.stage("two")
    time.sleep(0.1)
    timing.end()
    inner(0.2)  # nobody measures any more
    lines = {line.split(" CPU s  ")[1].split(":")[0]: line for line in table.lines()}
    one = {name: float(s) for name, s in re.findall(r"(\w+) (\d\.\d)", lines["one"].partition(": ")[2])}
    assert abs(one["inner"] - 0.2) < 0.06
    assert abs(one["outer"] - 0.2) < 0.06
    assert "inner" not in lines["two"]


def test_a_part_that_fails_ends():
    @timing.part("fails")
    def fails():
        raise ValueError("broken")

    table = timing.begin()
    for _ in range(2):
        with pytest.raises(ValueError, match="broken"):
            fails()
    time.sleep(0.1)
    timing.end()
    assert "fails" not in table.lines()[0], "what came after it is not its own"


def test_observe_tells_where_its_seconds_went(tmp_path):
    command = [sys.executable, "-m", "fiberloom.cli", "observe", "examples/targets_sdssv.csv"]
    options = ["--positioners", "7", "--camera", "noise", "--moves", "1", "--timings"]
    done = subprocess.run(
        [*command, *options, "--out", str(tmp_path / "run")], capture_output=True, text=True, check=False
    )
    assert re.search(r"^ +\d+\.\d s +\d+\.\d CPU s  start: ", done.stderr, re.M)
    assert re.search(r"^ +\d+\.\d s +\d+\.\d CPU s  in all$", done.stderr, re.M)


def test_a_stage_has_processor_seconds_of_its_own_and_of_its_children():
    table = timing.begin()
    table.stage("rests")
    time.sleep(0.3)
    table.stage("works")
    begun_s = time.process_time()
    while time.process_time() - begun_s < 0.3:
        pass
    table.stage("has others work")
    busy = "import time\nwhile time.process_time() < 0.3: pass"
    subprocess.run([sys.executable, "-c", busy], check=True)
    timing.end()
    used_s = {
        name: float(s) for s, name in re.findall(r"(\d\.\d) CPU s  ([a-z ]+)", "\n".join(table.lines()))
    }
    assert used_s["rests"] < 0.1
    assert 0.3 <= used_s["works"] < 0.5
    assert 0.3 <= used_s["has others work"] < 0.6


def test_modules_that_are_read_are_a_part(tmp_path, monkeypatch):
    (tmp_path / "slow_to_read.py").write_text("import time\ntime.sleep(0.2)\n")
    monkeypatch.syspath_prepend(tmp_path)
    table = timing.begin()
    table.stage("one")
    import slow_to_read  # noqa: F401

    timing.end()
    assert re.search(r"one: imports 0\.[23]", "\n".join(table.lines()))
    assert re.search(r"start: imports", table.lines()[0]), "what passed before it was measured"
