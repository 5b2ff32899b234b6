"""A sweep of designs on the workers of a Dask scheduler: the same rows as in this process."""

import json

import pytest

from fiberloom.design.merits import MeritSettings
from fiberloom.design.sweep import sweep
from fiberloom.errors import InputError
from fiberloom.instruments import load_instrument

distributed = pytest.importorskip("distributed", reason="pip install distributed: a Dask cluster")

PFS = load_instrument("pfs")
QUICK = MeritSettings(fields=2, rings=2)
RANGES = {"pitch": [8.0, -1.0, 8.6]}


@pytest.fixture(scope="module")
def two_workers():
    """A scheduler here, and two processes."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.long
def test_two_workers_of_a_scheduler_find_the_same(two_workers):
    found = sweep(PFS, RANGES, QUICK, scheduler=two_workers)
    assert found == sweep(PFS, RANGES, QUICK)
    assert [bool(one.refused) for one in found] == [False, True, False]


@pytest.mark.long
def test_the_command_goes_to_the_scheduler(fl, two_workers):
    words = ("--vary", "pitch=8;8.6", "--fields", 2, "--scheduler", two_workers, "--json")
    code, said, _ = fl("design", "sweep", "pfs", *words)
    assert code == 0
    assert [row["changes"] for row in json.loads(said)] == [{"pitch": 8.0}, {"pitch": 8.6}]


def test_an_address_without_a_scheduler_is_refused_in_one_line(monkeypatch):
    monkeypatch.setattr("fiberloom.design.sweep.CONNECT_S", 0.2)
    with pytest.raises(InputError, match="start one with 'dask scheduler'") as told:
        sweep(PFS, {"pitch": [8.0]}, QUICK, scheduler="tcp://127.0.0.1:9")
    assert "\n" not in str(told.value)
