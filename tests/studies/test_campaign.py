"""Campaigns: the same rows whoever computes them, and nothing lost by a kill."""

import multiprocessing
import subprocess
import sys
from pathlib import Path

import campaign_experiments as experiments
import numpy as np
import pytest

from fiberloom import version
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


def test_a_process_that_dies_once_costs_nothing_but_time(tmp_path):
    settings = {"unit": 6, "mark": str(tmp_path / "mark"), "log": str(tmp_path / "log")}
    assert_same(run(study(experiments.killed_at, settings=settings), tmp_path, workers=2), run(study()))
    assert Path(settings["mark"]).exists()
    assert not multiprocessing.active_children()


def test_units_that_kill_their_process_each_time_are_named_and_all_else_is_done(tmp_path):
    campaign, told = study(experiments.deadly, settings={"units": [5]}), []
    with pytest.raises(InputError, match=r"units 4 to 5 kill their worker each time.*all others are done"):
        run(campaign, tmp_path, workers=2, progress=lambda done, total: told.append(done))
    assert not multiprocessing.active_children()
    assert told[-1] == 9
    names = {file.name for file in tmp_path.glob("chunks/*/*.npz")}
    assert names == {f"{i:06d}.npz" for i in (0, 1, 3, 4, 5)}


def test_where_all_units_kill_their_process_the_campaign_ends_early(tmp_path):
    campaign = study(experiments.deadly, n=40, settings={"units": list(range(40))})
    with pytest.raises(InputError, match=r"units (\d+ to \d+, ){2}\d+ to \d+ kill.*the campaign ends here"):
        run(campaign, tmp_path, workers=2)


def test_other_code_finds_no_chunks_of_this(tmp_path, monkeypatch):
    run(study(), tmp_path)
    monkeypatch.setattr("fiberloom.studies.campaign.code_digest", lambda: "of other code")
    told = []
    run(study(), tmp_path, progress=lambda done, total: told.append(done))
    assert told[0] == 0


def test_the_digest_is_of_every_file_of_the_package(tmp_path, monkeypatch):
    package = tmp_path / "fiberloom"
    (package / "__pycache__").mkdir(parents=True)
    for name in ("version.py", "_core.so", "presets.toml", "__pycache__/version.pyc"):
        (package / name).write_bytes(name.encode())
    monkeypatch.setattr(version, "__file__", str(package / "version.py"))
    digests = [version.code_digest.__wrapped__()]
    for name in ("_core.so", "presets.toml", "version.py", "__pycache__/version.pyc"):
        (package / name).write_bytes(b"changed")
        digests.append(version.code_digest.__wrapped__())
    assert len(set(digests)) == 4
    assert digests[3] == digests[4]


def test_the_core_s_digest_is_of_what_is_compiled(tmp_path, monkeypatch):
    monkeypatch.setattr(version, "__file__", str(tmp_path / "version.py"))
    digests = []
    for name in ("_core.cpython-311.so", "presets.toml", "_core.cpython-311.so"):
        (tmp_path / name).write_bytes(str(len(digests)).encode())
        digests.append(version.core_digest.__wrapped__())
    assert digests[0] == digests[1] != digests[2]


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
