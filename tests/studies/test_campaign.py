"""Campaigns: the same rows whoever computes them, and nothing lost by a kill."""

import multiprocessing
import subprocess
import sys
from pathlib import Path

import campaign_experiments as experiments
import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.studies.campaign import Campaign, forget, run

HERE = Path(__file__).resolve().parent


def study(experiment=experiments.draw, n=11, chunk=2, seed=5, settings=None):
    return Campaign("study", experiment, n, seed, settings, chunk)


def assert_same(first, second):
    assert first.keys() == second.keys()
    for name, column in first.items():
        assert column.tobytes() == second[name].tobytes()


def test_rows_come_in_the_order_of_units_whatever_the_chunks():
    rows = run(study())
    np.testing.assert_array_equal(rows["unit"], np.arange(11))
    assert rows["draw"].shape == (11, 3)
    assert_same(rows, run(study(chunk=5)))
    assert run(study(seed=6))["draw"].tobytes() != rows["draw"].tobytes()


def test_one_worker_or_three(tmp_path):
    assert_same(run(study()), run(study(), tmp_path, workers=3))


def test_a_dask_cluster_gives_the_same(tmp_path):
    distributed = pytest.importorskip("distributed", reason="pip install distributed: a Dask cluster")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
    ) as cluster:
        rows = run(study(), tmp_path, scheduler=cluster.scheduler_address)
    assert_same(rows, run(study()))


def test_nobody_at_the_schedulers_address(monkeypatch):
    monkeypatch.setattr("fiberloom.studies.campaign.CONNECT_S", 0.5)
    with pytest.raises(InputError, match=r"--scheduler tcp://127\.0\.0\.1:9: no Dask scheduler answers"):
        run(study(), scheduler="tcp://127.0.0.1:9")


def test_killed_and_resumed(tmp_path):
    """The whole process dies in the middle; the next one computes only what is missing."""
    settings = {"unit": 6, "mark": str(tmp_path / "mark"), "log": str(tmp_path / "log")}
    campaign = study(experiments.killed_at, settings=settings)
    code = (
        "from pathlib import Path; import test_campaign as t;"
        f"t.run(t.study(t.experiments.killed_at, settings={settings!r}), Path({str(tmp_path)!r}))"
    )
    died = subprocess.run([sys.executable, "-c", code], cwd=HERE, check=False)
    assert died.returncode == -9
    log = Path(settings["log"])
    assert log.read_text().split() == ["0", "2", "4"]
    told = []
    rows = run(campaign, tmp_path, progress=lambda done, total: told.append((done, total)))
    assert log.read_text().split() == ["0", "2", "4", "6", "8", "10"]
    assert told == [(6, 11), (8, 11), (10, 11), (11, 11)]
    assert_same(rows, run(study()))
    forget(campaign, tmp_path)
    assert not (tmp_path / "chunks").exists()


def test_a_worker_that_dies_is_told_and_what_is_done_stays(tmp_path):
    settings = {"unit": 10, "mark": str(tmp_path / "mark"), "log": str(tmp_path / "log")}
    campaign = study(experiments.killed_at, settings=settings)
    with pytest.raises(InputError, match="a worker process died"):
        run(campaign, tmp_path, workers=2)
    assert not multiprocessing.active_children()
    assert_same(run(campaign, tmp_path), run(study()))


def test_other_settings_find_no_chunks_of_these(tmp_path):
    run(study(), tmp_path)
    told = []
    run(study(seed=6), tmp_path, progress=lambda done, total: told.append(done))
    assert told[0] == 0
    keys = {study(**c).key() for c in ({}, {"seed": 6}, {"n": 12}, {"chunk": 3}, {"settings": {"a": 1}})}
    assert len(keys) == 5


def test_a_broken_chunk_is_computed_again(tmp_path):
    first = run(study(), tmp_path)
    file = next(tmp_path.glob("chunks/*/000003.npz"))
    file.write_bytes(file.read_bytes()[:100])
    assert_same(first, run(study(), tmp_path))


def test_bad_input():
    with pytest.raises(InputError, match="0 units in chunks of 2"):
        study(n=0)
    with pytest.raises(InputError, match="0 workers"):
        run(study(), workers=0)
    with pytest.raises(ValueError, match="'unit' has no equal share"):
        run(study(experiments.lopsided))
