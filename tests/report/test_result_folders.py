"""Results of another run in the same folder are moved aside; two runs at once are refused."""

import json
import os
from pathlib import Path

import pytest

import fiberloom as fl
from fiberloom.errors import InputError
from fiberloom.operation.observe import STORE
from fiberloom.report.folder import RESULTS, point_latest, set_aside
from fiberloom.store import Store
from fiberloom.targets import random_targets


@pytest.fixture
def field():
    return fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")


def test_results_go_into_a_folder_with_the_number_of_their_run(tmp_path):
    assert set_aside(tmp_path, 4) is None
    (tmp_path / "summary.json").write_text(json.dumps({"run": 2}))
    (tmp_path / "exposures").mkdir()
    (tmp_path / "store.sqlite").touch()
    assert set_aside(tmp_path, 4) == tmp_path / "run-2"
    assert sorted(p.name for p in (tmp_path / "run-2").iterdir()) == ["exposures", "summary.json"]
    assert (tmp_path / "store.sqlite").exists()


@pytest.mark.parametrize("summary", [None, "{}", "[]", "no json"])
def test_what_tells_no_number_is_of_the_last_run_and_nothing_is_lost(tmp_path, summary):
    for k in range(2):
        (tmp_path / "fibres.ecsv").write_text(str(k))
        if summary is not None:
            (tmp_path / "summary.json").write_text(summary)
        set_aside(tmp_path, 4)
    assert [(tmp_path / name / "fibres.ecsv").read_text() for name in ("run-4", "run-4-1")] == ["0", "1"]


def test_two_observations_into_one_folder(field, tmp_path):
    targets = random_targets(field.plane, 100, 1)
    field.keep = lambda seen: seen.save(tmp_path)
    for _ in range(2):
        field.run.observe(targets, corrections=0, out=tmp_path)
    assert json.loads((tmp_path / "summary.json").read_text())["run"] == 2
    assert json.loads((tmp_path / "run-1" / "summary.json").read_text())["run"] == 1
    assert {p.name for p in tmp_path.iterdir()} >= set(RESULTS) - {"exposures"}


def test_a_run_whose_files_cannot_be_written_is_not_finished(field, tmp_path):
    def full(_):
        raise InputError("fibres.ecsv: cannot be written (No space left on device)")

    field.keep = full
    with pytest.raises(InputError, match="No space left"):
        field.run.observe(random_targets(field.plane, 100, 1), corrections=0, out=tmp_path)
    with Store.open(tmp_path / STORE) as store:
        (run,) = store.runs()
    assert run.status == "failed"
    assert run.n_measurements > 0


def test_a_folder_into_which_another_run_writes_is_refused(field, tmp_path):
    with Store.open(tmp_path / STORE) as store, store.start_run(command_line="", instrument="sdssv"):
        with pytest.raises(InputError, match=r"run 1, begun on .* still writes there"):
            field.run.observe(random_targets(field.plane, 100, 1), corrections=0, out=tmp_path)
        assert [run.status for run in store.runs()] == ["running", "failed"]


# folders with numbers


def seen_in(folder):
    return json.loads((folder / "summary.json").read_text())


def test_without_a_folder_each_run_has_one_with_its_number(field, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    targets = random_targets(field.plane, 100, 1)
    field.keep = lambda seen: seen.save(field.folder)
    for _ in range(2):
        field.run.observe(targets, corrections=0)
    runs = tmp_path / "runs"
    assert [seen_in(runs / name)["run"] for name in ("0001", "0002", "latest")] == [1, 2, 2]
    assert os.readlink(runs / "latest") == "0002"
    assert sorted(p.name for p in runs.iterdir()) == ["0001", "0002", "latest", "store.sqlite"]
    assert field.folder == Path("runs/0002")
    with Store.read(runs / STORE) as store:
        assert [(run.id, run.folder) for run in store.runs()] == [(1, "0001"), (2, "0002")]


def test_a_folder_that_was_asked_for_stays_as_it_is(field, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    field.keep = lambda seen: seen.save(field.folder)
    field.run.observe(random_targets(field.plane, 100, 1), corrections=0, out="night")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["night"]
    assert {p.name for p in (tmp_path / "night").iterdir()} == {STORE, *RESULTS} - {"exposures"}


def test_two_runs_at_once_each_have_a_folder(field, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with Store.open("runs/store.sqlite") as store, store.start_run(command_line="", instrument="sdssv"):
        field.run.observe(random_targets(field.plane, 100, 1), corrections=0)
    assert field.folder == Path("runs/0002")


def test_numbers_that_begin_anew_lose_nothing(field, tmp_path, monkeypatch):
    """The store was removed, the folders stayed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs" / "0001").mkdir(parents=True)
    (tmp_path / "runs" / "0001" / "summary.json").write_text('{"run": 1, "utc": "long ago"}')
    field.keep = lambda seen: seen.save(field.folder)
    field.run.observe(random_targets(field.plane, 100, 1), corrections=0)
    assert seen_in(tmp_path / "runs" / "0001" / "run-1")["utc"] == "long ago"
    assert seen_in(tmp_path / "runs" / "latest")["utc"] != "long ago"


def no_links(*_, **__):
    raise OSError(1, "Operation not permitted")


def test_where_links_cannot_be_made_a_text_names_the_newest(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "symlink_to", no_links)
    for name in ("0001", "0002"):
        point_latest(tmp_path / name)
    assert [p.name for p in tmp_path.iterdir()] == ["latest.txt"]
    assert (tmp_path / "latest.txt").read_text() == "0002\n"
    monkeypatch.undo()
    point_latest(tmp_path / "0003")
    assert [p.name for p in tmp_path.iterdir()] == ["latest"]
    assert os.readlink(tmp_path / "latest") == "0003"


def test_a_folder_that_is_called_latest_stays(tmp_path):
    (tmp_path / "latest").mkdir()
    (tmp_path / "latest" / "summary.json").touch()
    point_latest(tmp_path / "0001")
    assert (tmp_path / "latest.txt").read_text() == "0001\n"
    assert [p.name for p in (tmp_path / "latest").iterdir()] == ["summary.json"]


def test_where_nothing_can_be_noted_the_run_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "symlink_to", no_links)
    monkeypatch.setattr(Path, "replace", no_links)
    point_latest(tmp_path / "0001")
    assert list(tmp_path.iterdir()) == []
