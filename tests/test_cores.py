"""How many threads a twin and its camera use unless told."""

import os

import pytest

from fiberloom.timing import core_count


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system knows no affinity of processes")
def test_a_process_that_may_use_one_core_counts_one():
    before = os.sched_getaffinity(0)
    assert core_count() == len(before)
    os.sched_setaffinity(0, {min(before)})
    try:
        assert core_count() == 1
    finally:
        os.sched_setaffinity(0, before)


def test_where_no_affinity_is_known_all_cores_count(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert core_count() == 1
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    assert core_count() == 3
