"""`fiberloom night` as it is typed."""

import json
from pathlib import Path

import pytest
from nights import HEAD

import fiberloom as fl_package
from fiberloom.night.queue import read_queue
from fiberloom.targets import random_targets, write_targets

ROOT = Path(__file__).resolve().parents[2]
ARRAY = '[array]\npositioners = 7\n[[field]]\nid = "a"\ntargets = "a.csv"\nexposure_s = 60\n'


@pytest.fixture
def queue(tmp_path):
    write_targets(random_targets(fl_package.FocalPlane.of("sdssv", n=7), 40, 0), tmp_path / "a.csv")
    (tmp_path / "q.toml").write_text(HEAD + ARRAY)
    return tmp_path / "q.toml"


def test_a_night_is_carried_out_shown_and_not_resumed(fl, queue, tmp_path):
    out = tmp_path / "out"
    code, told, _ = fl("night", queue, "--out", out, "--json")
    figures = json.loads(told)
    assert (code, figures["night"]["status"], figures["totals"]["exposures"]) == (0, "finished", 1)
    page = Path(figures["folder"]) / "night.html"
    before = page.read_text()
    page.unlink()
    code, told, _ = fl("show", 1, out, "--night")
    assert (code, "1 of 1" in told or "7 of 7" in told) == (0, True)
    assert "rms, um" in told
    assert page.read_text() == before
    code, _, said = fl("night", queue, "--out", out, "--resume")
    assert (code, "night 1 is finished" in said) == (2, True)
    code, _, said = fl("show", 9, out, "--night")
    assert (code, "no night 9 in it" in said) == (2, True)


def test_what_is_wrong_is_told_before_anything_is_opened(fl, queue, tmp_path):
    for words, said in (
        (("night", tmp_path / "none.toml"), "none.toml: no such file; write one as examples/night.toml"),
        (("night", queue, "--exclude", "x"), "'x' is not the number of a positioner"),
        (("night", queue, "--bus", "cannet://10.0.0.1"), "name the camera too"),
        (("night", queue, "--resume"), "none was begun"),
    ):
        code, _, told = fl(*words, *(("--out", tmp_path / "out")))
        assert (code, said in told) == (2, True), told


def test_a_field_that_fails_is_exit_code_1(fl, queue, tmp_path):
    (tmp_path / "a.csv").write_text("target_id,x_mm,y_mm\n1,zero,0\n")
    code, told, _ = fl("night", queue, "--out", tmp_path / "out")
    assert code == 1
    assert "failed" in told
    assert "major: field a" in told


def test_the_example_can_be_read():
    queue = read_queue(ROOT / "examples" / "night.toml")
    assert [entry.id for entry in queue.fields] == ["pleiades", "orion", "gemini"]
    assert queue.array.positioners == 37
