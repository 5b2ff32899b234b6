"""`benchmarks/twin_server.py --control`: which late ticks are the machine's, and of how many."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "benchmarks"))
import twin_server

SAID = {0: "late 10.0000 10.0009\nlate 20.0000 20.0003\nticks 1000 1 0.0009", 1: "ticks 1000 0 0.0001"}


def late(due_s, late_ms, core=0):
    return {"due_s": due_s, "late_ms": late_ms, "core": core}


@pytest.mark.parametrize(
    ("tick", "machines"),
    [
        (late(10.0004, 0.9), 1),  # the thread of its core missed a tick meanwhile
        (late(20.0, 0.7), 1),  # without 0.3 ms it would have been kept
        (late(20.0, 0.9), 0),
        (late(10.0004, 0.9, core=1), 0),
        (late(15.0, 0.9), 0),
        (late(10.0004, 0.9, core=-1), 0),
    ],
)
def test_a_late_tick_is_the_machines_where_its_core_was_held(tick, machines):
    result = {"late_ticks": [tick], "first_by_cause": {"woken": 1, "computed": 0}}
    assert twin_server.compared(result, SAID)["of_told_the_machine"] == machines


def test_ticks_that_are_not_told_one_by_one_are_counted_too():
    result = {"late_ticks": [late(15.0, 0.9)] * 200, "first_by_cause": {"woken": 240, "computed": 60}}
    found = twin_server.compared(result, SAID)
    assert (found["late_by_themselves"], found["told"], found["of_told_the_machine"]) == (300, 200, 0)
    assert found["core 0"] == {"ticks": 1000.0, "share_kept": 0.999, "worst_ms": pytest.approx(0.9)}
