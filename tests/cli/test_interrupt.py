"""Ctrl-C and kill: what was measured is still there."""

import os
import re
import signal
import subprocess
import time

import pytest
from programs import start

from fiberloom.store import Store

TARGETS = "target_id,x_mm,y_mm\n" + "".join(f"t{i},{5 * i - 20},{3 * i - 12}\n" for i in range(9))


def begun(folder, seconds=240.0):
    """An observation of many moves, once it has recorded its first ones."""
    (folder / "t.csv").write_text(TARGETS)
    words = ["observe", "t.csv", "--positioners", "7", "--moves", "5000", "--out", "out"]
    process = start(*words, cwd=folder, stdout=subprocess.PIPE)
    end = time.monotonic() + seconds
    while measured(folder) < 14:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < end, "no measurement was recorded"
        time.sleep(0.2)
    return process


def measured(folder):
    path = folder / "out" / "store.sqlite"
    if not path.exists():
        return 0
    with Store.open(path) as store:
        runs = store.runs()
        return runs[-1].n_measurements if runs else 0


@pytest.mark.slow
def test_ctrl_c_ends_in_one_line_and_keeps_everything(tmp_path):
    process = begun(tmp_path)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    *progress, last = stderr.strip().splitlines()
    assert last.startswith("fiberloom: interrupted")
    assert all(re.match(r"[a-z]", line) and "Error" not in line for line in progress), progress
    with Store.open(tmp_path / "out" / "store.sqlite") as store:
        run = store.runs()[-1]
        assert run.status == "interrupted"
        assert run.n_measurements >= 14


@pytest.mark.slow
def test_a_killed_run_shows_as_interrupted_with_all_it_measured(tmp_path):
    process = begun(tmp_path)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate(timeout=60)
    with Store.open(tmp_path / "out" / "store.sqlite") as store:
        run = store.runs()[-1]
        assert run.status == "interrupted"
        assert len(store.measurements(run.id)["x_mm"]) == run.n_measurements >= 14
