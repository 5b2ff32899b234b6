"""Observations without `--out`, then `runs` and `show`, as an operator types them."""

import json
import shutil
from pathlib import Path

import pytest
from readonly import read_only

from fiberloom.instruments import generate, load_instrument
from fiberloom.targets import random_targets, write_targets

PLANE = ("--positioners", 7, "--seed", 4)
QUICK = ("--camera", "noise", "--moves", 2, "--pages", "none")


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    folder = tmp_path_factory.mktemp("desk with 100% # of ?")
    plane = generate(load_instrument("sdssv"), 4, n_positioners=7)
    write_targets(random_targets(plane, 40, 4), folder / "targets.csv")
    return folder


@pytest.fixture
def twice(fl, desk, monkeypatch):
    monkeypatch.chdir(desk)
    if not Path("runs").exists():
        for number in (1, 2):
            code, out, _ = fl("observe", "targets.csv", *PLANE, *QUICK)
            assert code == 0
            assert f"results in runs/000{number}/: summary.json" in out
    return fl


def test_runs_names_the_folder_of_each(twice):
    code, out, _ = twice("runs")
    assert code == 0
    lines = [line.split() for line in out.splitlines() if "finished" in line]
    # number, moves, folder
    assert [(line[0], line[4], line[7]) for line in lines] == [("1", "2", "0001;"), ("2", "2", "0002;")]
    rows = json.loads(twice("runs", "--json")[1])
    assert [(row["store"], row["folder"]) for row in rows] == [
        ("runs/store.sqlite", n) for n in ("0001", "0002")
    ]


def test_show_makes_the_files_anew(twice, tmp_path):
    before = {p.name: p.read_bytes() for p in Path("runs/0001").iterdir()}
    code, out, _ = twice("show", 1, "--out", tmp_path)
    assert code == 0
    assert out.startswith("run 1, finished, begun 20")
    assert "`fiberloom observe targets.csv --positioners 7 --seed 4" in out
    assert f"results in {tmp_path}/: " in out.replace("\n", "")
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
    for path in Path("runs/0001").iterdir():
        path.unlink()
    report = json.loads(twice("show", 1, "--json")[1])
    assert (report["run"], report["status"], report["folder"]) == (1, "finished", "runs/0001")
    assert {p.name: p.read_bytes() for p in Path("runs/0001").iterdir()} == before


def test_runs_health_and_show_read_media_that_cannot_be_written(twice, tmp_path):
    store, folder = shutil.copy("runs/store.sqlite", tmp_path), tmp_path
    with read_only(folder):
        assert len(json.loads(twice("runs", folder, "--json")[1])) == 2
        assert json.loads(twice("health", folder, *PLANE, "--json")[1])["runs"] == 2
        code, _, err = twice("show", 1, folder)
        assert (code, "choose another folder" in err) == (2, True)
        assert twice("show", 1, folder, "--out", "shown")[0] == 0
    assert [str(p) for p in folder.iterdir()] == [str(store)]
    assert Path("shown/summary.json").read_bytes() == Path("runs/0001/summary.json").read_bytes()


def test_json_of_observe_names_the_folder(fl, desk, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    code, out, _ = fl("observe", desk / "targets.csv", *PLANE, *QUICK, "--json")
    assert (code, json.loads(out)["folder"]) == (0, "runs/0001")
    assert "folder" not in json.loads(Path("runs/latest/summary.json").read_text())


def test_show_finds_the_store(twice, desk, monkeypatch):
    for where in ("runs", "runs/store.sqlite", desk, "."):
        assert twice("show", 2, where)[0] == 0
    code, out, err = twice("show", 9)
    assert (code, out) == (2, "")
    assert err == "fiberloom: runs: no run 9; `fiberloom runs runs` lists them\n"
    assert "no such file" in twice("show", 1, "nowhere")[2]


def test_show_of_a_number_that_several_stores_have_asks_which(fl, desk, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for night in ("a", "b"):
        assert fl("observe", desk / "targets.csv", *PLANE, *QUICK, "--out", night)[0] == 0
    code, _, err = fl("show", 1, ".")
    assert code == 2
    assert "run 1 is in 2 stores; name one of them: a/store.sqlite, b/store.sqlite" in err
    assert fl("show", 1, "b")[0] == 0


@pytest.mark.parametrize("name", ["a?b", "100%", "n#1", "two words", "%3Fx"])
def test_results_go_to_a_folder_of_any_name(fl, desk, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    assert fl("observe", desk / "targets.csv", *PLANE, *QUICK, "--out", name)[0] == 0
    assert [p.name for p in tmp_path.iterdir()] == [name]
    before = {p.name: p.read_bytes() for p in (tmp_path / name).iterdir() if p.suffix != ".sqlite"}
    assert set(before) == {
        "summary.json",
        "fibres.ecsv",
        "trajectories.json",
        "focal_plane.png",
        "errors.png",
    }
    assert fl("show", 1, name, "--out", f"{name}/again {name}")[0] == 0
    again = tmp_path / name / f"again {name}"
    assert {p.name: p.read_bytes() for p in again.iterdir()} == before
    assert fl("verify", f"{name}/trajectories.json", *PLANE)[0] == 0
    assert fl("health", name, *PLANE)[0] == 0
