"""Results of another run in the same folder are moved aside; two runs at once are refused."""

import json

import pytest

import fiberloom as fl
from fiberloom.errors import InputError
from fiberloom.operation.observe import STORE
from fiberloom.report.folder import RESULTS, set_aside
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
