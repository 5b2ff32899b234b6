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
    lines = {line.split("s  ")[1].split(":")[0]: line for line in table.lines()}
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
    assert re.search(r"^ +\d+\.\d s  start: ", done.stderr, re.M)
    assert re.search(r"^ +\d+\.\d s  in all, \d+\.\d CPU s$", done.stderr, re.M)


def test_modules_that_are_read_are_a_part(tmp_path, monkeypatch):
    (tmp_path / "slow_to_read.py").write_text("import time\ntime.sleep(0.2)\n")
    monkeypatch.syspath_prepend(tmp_path)
    table = timing.begin()
    table.stage("one")
    import slow_to_read  # noqa: F401

    timing.end()
    assert re.search(r"one: imports 0\.[23]", "\n".join(table.lines()))
    assert re.search(r"start: imports", table.lines()[0]), "what passed before it was measured"
