"""`fiberloom design`: what the commands print, draw and end with."""

import json

import pytest

from fiberloom.design.figures import _reached
from fiberloom.design.lattice import Lattice
from fiberloom.instruments import load_instrument


def told(fl, *words):
    code, said, _ = fl("design", *words, "--json")
    return code, json.loads(said)


def test_coverage_tells_of_holes_and_draws_a_map(fl, tmp_path):
    code, found = told(fl, "coverage", "desi", "--out", tmp_path / "map.png")
    assert code == 0
    assert (tmp_path / "map.png").stat().st_size > 10_000
    text = json.dumps(found)
    assert "10.392" in text  # the pitch at which equal arms of 3 mm leave no hole: 6 sqrt(3)


def test_a_gear_that_cannot_be_in_time_ends_with_1(fl, tmp_path):
    assert fl("design", "gear", "sdssv", "--out", tmp_path / "gear.png")[0] == 0
    assert (tmp_path / "gear.png").exists()
    assert fl("design", "gear", "sdssv", "--within", 20)[0] == 1


def test_a_spring_outside_its_window_ends_with_1(fl, tmp_path, monkeypatch):
    monkeypatch.setattr("fiberloom.design.spring.UNITS", 61)  # 500 take seconds to draw
    code, said, _ = fl("design", "spring", "sdssv", "--out", tmp_path / "spring.png")
    assert code == 1
    assert "wind it" in said
    assert (tmp_path / "spring.png").exists()
    assert fl("design", "spring", "sdssv", "--factor", 1)[0] == 0


def test_throughput_asks_for_the_fibre(fl):
    assert fl("design", "throughput", "sdssv", "--core", 120, "--scale", 60)[0] == 0
    code, _, said = fl("design", "throughput", "sdssv")
    assert code == 2
    assert "--core" in said


@pytest.mark.parametrize("command", ["coverage", "gear", "spring"])
def test_a_file_that_is_not_there_is_named(fl, command):
    code, _, said = fl("design", command, "nowhere.toml")
    assert code == 2
    assert "nowhere.toml" in said


def test_a_title_does_not_say_every_point_where_a_rest_is_left():
    """MOONS: the ranges of the axes leave a rest that only one fibre reaches."""
    from fiberloom.design.coverage import coverage

    lattice = Lattice.of(load_instrument("moons"), "fibre")
    assert _reached(coverage(lattice, seed=0)).endswith("% reached by 2 or more")
