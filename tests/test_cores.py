"""How many threads a twin and its camera use unless told."""

import os
from pathlib import Path

import pytest

from fiberloom.instruments import generate, load_instrument
from fiberloom.timing import core_count
from fiberloom.twin import Twin, draw_units

TASKS = Path("/proc/self/task")


@pytest.fixture
def one_core():
    if not hasattr(os, "sched_setaffinity"):
        pytest.skip("this system knows no affinity of processes: Linux does")
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    yield
    os.sched_setaffinity(0, before)


def test_a_process_that_may_use_one_core_counts_one(one_core):
    assert core_count() == 1


@pytest.mark.skipif(not TASKS.exists(), reason="no /proc here, where threads are counted: Linux has it")
def test_its_twin_has_no_helpers(one_core):
    plane = generate(load_instrument("sdssv"), seed=5, n_positioners=2)
    units, before = draw_units(plane, seed=11), len(list(TASKS.iterdir()))
    alone = Twin(plane, units)
    assert len(list(TASKS.iterdir())) == before
    helped = Twin(plane, units, threads=3)
    assert len(list(TASKS.iterdir())) == before + 2
    del alone, helped


def test_where_no_affinity_is_known_all_cores_count(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert core_count() == 1
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    assert core_count() == 3
