"""Campaigns on the workers of a Dask scheduler: the same rows, and a clean end whatever dies."""

import campaign_experiments as experiments
import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.studies import workers
from fiberloom.studies.campaign import Campaign, run

distributed = pytest.importorskip("distributed", reason="pip install distributed: a Dask cluster")
dask = pytest.importorskip("dask", reason="pip install distributed: a Dask cluster")


def study(experiment=experiments.draw, settings=None):
    return Campaign("study", experiment, n_units=11, seed=5, settings=settings, chunk=2)


@pytest.fixture(scope="module")
def two_workers():
    """A scheduler here, and two processes; a nanny starts another one where one dies."""
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
        ) as cluster,
    ):
        yield cluster.scheduler_address


def test_the_rows_are_those_of_one_process(two_workers):
    rows, alone = run(study(), scheduler=two_workers), run(study())
    assert {name: column.tobytes() for name, column in rows.items()} == {
        name: column.tobytes() for name, column in alone.items()
    }


def test_units_that_kill_their_worker_each_time_are_named_with_it(two_workers, tmp_path):
    campaign = study(experiments.deadly, {"units": [5]})
    with pytest.raises(InputError, match=r"units 4 to 5 kill .*the last: worker tcp://.*all others are done"):
        run(campaign, tmp_path, scheduler=two_workers)
    assert len(list(tmp_path.glob("chunks/*/*.npz"))) == 5


@pytest.mark.parametrize("name", ["fiberloom", "Python", "numpy", "scipy"])
def test_a_worker_with_another_program_is_refused(two_workers, monkeypatch, name):
    here = workers.versions() | {name: "of yesterday"}
    monkeypatch.setattr(workers, "versions", lambda: here)
    with pytest.raises(InputError, match=rf"worker .* has {name} .*, the caller of yesterday: install"):
        run(study(), scheduler=two_workers)


def test_a_scheduler_without_workers(monkeypatch):
    monkeypatch.setattr(workers, "ABSENT_S", 0.2)
    monkeypatch.setattr(workers, "LOOK_S", 0.1)
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address="127.0.0.1:0") as cluster,
        pytest.raises(InputError, match=r"no worker for 0 s; .*start workers"),
    ):
        run(study(), scheduler=cluster.scheduler_address)


def test_a_scheduler_that_goes_away(tmp_path):
    """What was done before stays."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
    ) as cluster:
        told = []

        def close_after_two(done, total):
            told.append(done)
            if done == 4:
                cluster.close()

        with (
            dask.config.set({"distributed.comm.timeouts.connect": "0.5s"}),
            pytest.raises(InputError, match="the scheduler has gone; what is finished is kept"),
        ):
            run(
                study(experiments.slow),
                tmp_path,
                scheduler=cluster.scheduler_address,
                progress=close_after_two,
            )
    assert told == [0, 2, 4]
    assert len(list(tmp_path.glob("chunks/*/*.npz"))) == 2


def test_no_scheduler_at_the_address(monkeypatch):
    monkeypatch.setattr(workers, "CONNECT_S", 0.5)
    with pytest.raises(InputError, match=r"--scheduler tcp://127\.0\.0\.1:9: no Dask scheduler answers"):
        run(study(), scheduler="tcp://127.0.0.1:9")


def test_versions_tell_one_program_from_another():
    assert set(workers.versions()) == {"fiberloom", "Python", "numpy", "scipy"}
    assert workers.versions()["numpy"] == np.__version__
