"""Result files made anew from the store are those of the run, byte for byte."""

import contextlib
import filecmp
import json
import shutil
import sqlite3

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.errors import InputError
from fiberloom.operation.past.parts import plane_of, targets_of
from fiberloom.operation.past.rebuild import info_of_run, own_folder, rebuild
from fiberloom.report.folder import RESULTS
from fiberloom.store import Store
from fiberloom.store.parts import RunPart, pack, unpack
from fiberloom.targets import random_targets

FILES = [name for name in RESULTS if name != "exposures"]
"""All that an observation writes but images and their pages: the store keeps no pixels."""


def observed(out, n=7, faults="", targets=60, camera="noise", **how):
    field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=n), camera=camera, faults=faults)
    field.keep = lambda seen: seen.save(field.folder)
    field.command_line = "fiberloom observe targets.csv"
    seen = field.run.observe(random_targets(field.plane, targets, 1), corrections=1, out=out, **how)
    return field, seen


def rebuilt(folder, run=1, out=None):
    with Store.read(folder / "store.sqlite") as store:
        return rebuild(store, run, out)


@pytest.fixture(scope="module")
def night(tmp_path_factory):
    """Two runs in one folder; the second with faults, a comparison and targets that none takes."""
    folder = tmp_path_factory.mktemp("night")
    observed(folder)
    observed(folder, 19, "dead=1,dark=1,lying=1", 200, compare_linear=True)
    return folder


@pytest.mark.parametrize(("run", "where"), [(1, "run-1"), (2, ".")])
def test_every_file_is_that_of_the_run(night, tmp_path, run, where):
    made = rebuilt(night, run, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(FILES)
    assert filecmp.cmpfiles(night / where, tmp_path, FILES, shallow=False) == (FILES, [], [])
    assert made.left_out == {}
    assert made.summary["run"] == run


def test_the_second_run_had_something_to_lose(night):
    summary = json.loads((night / "summary.json").read_text())
    assert {"dead", "dark"} & set(summary["faults"])
    assert summary["not_assigned"]
    assert [move["comparison"] for move in summary["moves"]][-1]
    assert summary["put_in"]


def test_images_bring_what_is_seen_and_are_told_to_be_left_out(tmp_path):
    observed(tmp_path / "run", 7, camera="image", pages="last")
    assert (tmp_path / "run" / "exposures").is_dir()
    made = rebuilt(tmp_path / "run", out=tmp_path / "new")
    assert filecmp.cmpfiles(tmp_path / "run", tmp_path / "new", FILES, shallow=False)[0] == FILES
    assert list(made.left_out) == ["exposures/"]
    assert "camera images" in made.left_out["exposures/"]
    # beside the pages themselves there is nothing to tell
    assert rebuilt(tmp_path / "run").left_out == {}


def test_without_a_folder_they_go_where_the_run_had_them(night, tmp_path):
    copy = shutil.copytree(night, tmp_path / "copy")
    for where in (copy, copy / "run-1"):
        for name in FILES:
            (where / name).unlink()
    (copy / "run-1").rmdir()
    assert [rebuilt(copy, run).folder for run in (2, 1)] == [copy, copy / "run-1"]
    for where in (".", "run-1"):
        assert filecmp.cmpfiles(night / where, copy / where, FILES, shallow=False)[0] == FILES


def test_a_numbered_run_has_its_own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    observed(None)
    with Store.read("runs/store.sqlite") as store:
        assert str(own_folder(store, info_of_run(store, 1))) == "runs/0001"
    before = (tmp_path / "runs" / "0001" / "summary.json").read_bytes()
    with Store.read("runs/store.sqlite") as store:
        rebuild(store, 1)
    assert sorted(p.name for p in (tmp_path / "runs" / "0001").iterdir()) == sorted(FILES)
    assert (tmp_path / "runs" / "0001" / "summary.json").read_bytes() == before


def test_results_of_another_run_are_moved_aside(night, tmp_path):
    rebuilt(night, 1, tmp_path)
    rebuilt(night, 1, tmp_path)
    assert not (tmp_path / "run-1").exists()
    rebuilt(night, 2, tmp_path)
    assert json.loads((tmp_path / "run-1" / "summary.json").read_text())["run"] == 1
    assert json.loads((tmp_path / "summary.json").read_text())["run"] == 2


def test_an_interrupted_run_shows_what_it_has_measured(tmp_path):
    field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")

    def full(_):
        raise InputError("fibres.ecsv: cannot be written (No space left on device)")

    field.keep = full
    with pytest.raises(InputError, match="No space left"):
        field.run.observe(random_targets(field.plane, 60, 1), corrections=1, out=tmp_path)
    made = rebuilt(tmp_path)
    assert made.run.status == "failed"
    field.last.save(tmp_path / "as held")
    assert filecmp.cmpfiles(tmp_path, tmp_path / "as held", FILES, shallow=False)[0] == FILES


def test_a_killed_run_shows_what_it_has_measured(night, tmp_path):
    copy = shutil.copytree(night, tmp_path / "copy")
    change(copy, "DELETE FROM parts WHERE run_id = 2 AND name = 'about' AND id = (SELECT max(id) FROM parts)")
    change(copy, "UPDATE runs SET status = 'interrupted', row_sum = NULL WHERE id = 2")
    made = rebuilt(copy, 2, tmp_path / "out")
    assert made.summary["stopped"] == "the run was interrupted"
    assert list(made.left_out) == ["exposures/"]
    same = [name for name in FILES if name != "summary.json"]
    # the time in their heads is that of the beginning
    heads = [(where / "fibres.ecsv").read_text().split("rows_sum")[1] for where in (night, tmp_path / "out")]
    assert heads[0].split("\n", 1)[0] == heads[1].split("\n", 1)[0]
    assert all((tmp_path / "out" / name).exists() for name in same)


def change(folder, query):
    with contextlib.closing(sqlite3.connect(folder / "store.sqlite")) as raw, raw:
        raw.execute(query)


@pytest.mark.parametrize(
    ("queries", "words"),
    [
        (["UPDATE runs SET folder = NULL, row_sum = NULL", "DELETE FROM parts"], "did not keep layout"),
        (["DELETE FROM parts"], r"is no observation \(fiberloom observe targets.csv\)"),
        (["DELETE FROM parts WHERE move_id IS NOT NULL"], "made no move: it has no results"),
        (["UPDATE runs SET config_hash = 'x', row_sum = NULL"], "is not read as it was written"),
        (["UPDATE parts SET data = x'00' WHERE id = 1"], "row 1 of the table parts"),
    ],
)
def test_what_cannot_be_made_is_told_in_one_line(night, tmp_path, queries, words):
    shutil.copy(night / "store.sqlite", tmp_path)
    for query in queries:
        change(tmp_path, query)
    with pytest.raises(InputError, match=words) as told:
        rebuilt(tmp_path, 1, tmp_path / "out")
    assert "\n" not in str(told.value)
    assert not (tmp_path / "out").exists()


def test_a_run_that_is_not_there(night):
    with pytest.raises(InputError, match="no run 7; 'fiberloom runs' lists them"):
        rebuilt(night, 7)


@pytest.mark.parametrize("name", ["sdssv", "pfs", "desi"])
def test_layouts_come_back_to_the_last_bit(name, tmp_path):
    plane = fl.FocalPlane.of(name, seed=3, n=7)
    with Store.open(tmp_path / "s.sqlite") as store, store.start_run(command_line="", instrument=name) as run:
        from fiberloom.operation.past.parts import record_begin

        targets = random_targets(plane, 20, 1)
        record_begin(run, plane, targets, fl.assign(plane, targets), {})
        parts, _ = store.parts(run.id)
    again = plane_of(parts["layout"])
    assert again.config_hash() == plane.config_hash()
    assert again.instrument == plane.instrument
    np.testing.assert_array_equal(again.arms, plane.arms)
    np.testing.assert_array_equal(targets_of(parts["targets"]).x_mm, targets.x_mm)


def test_parts_hold_every_bit():
    numbers = np.array([0.1, np.nan, -0.0, np.inf, 5e-324])
    part = unpack(
        pack({"text": "µ", "n": [1, None, 0.1]}, {"numbers": numbers, "names": np.array(["a", ""])})
    )
    assert isinstance(part, RunPart)
    assert part.head == {"text": "µ", "n": [1, None, 0.1]}
    assert part.arrays["numbers"].tobytes() == numbers.tobytes()
    assert part.arrays["names"].tolist() == ["a", ""]
