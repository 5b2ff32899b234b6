"""`benchmarks.instruments.full`: what is met, what is missed, and which rows are kept."""

import sys
from dataclasses import asdict, replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from benchmarks.instruments import full

ROW = full.FullField("pfs", 2394, 2216, 2216, 2216, 5.0, 4.9, 12, 0, 69, 84.0, 0.9, 0, 0)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({}, []),
        ({"within": 2215}, ["1 of the healthy beyond 5 um"]),
        ({"contacts": 1}, ["contacts"]),
        ({"code": 1}, ["exit code 1"]),
        ({"cpu_s": 601.0}, ["more than 600 CPU s"]),
        ({"memory_gib": 8.1}, ["more than 8 GiB"]),
        ({"healthy": 0, "within": 0, "worst_um": None}, ["no fibre was observed"]),
    ],
)
def test_a_row_is_met_only_where_nothing_is_missed(wrong, said):
    made = replace(ROW, **wrong)
    assert made.missed == said
    assert made.line().endswith("| met |") == (not said)


def test_rows_are_kept_by_the_code_that_made_them(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(full, "observe", lambda name, *_: made.append(name) or ROW)
    for code, times in (("a", 1), ("a", 1), ("b", 2)):
        monkeypatch.setattr(full, "code_digest", lambda code=code: code)
        assert full.row("pfs", 0, tmp_path, False) == ROW
        assert len(made) == times
    full.row("pfs", 0, tmp_path, True)
    assert len(made) == 3


def test_one_that_left_no_summary_is_not_kept_and_the_code_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(full, "observe", lambda *_: "ended with 2")
    assert full.main(["--instrument", "pfs", "--out", str(tmp_path)]) == 1
    assert "not made: ended with 2" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


def test_a_row_is_made_of_the_last_move_that_is_no_comparison():
    last = {"comparison": False, "n_fibres": 87, "n_within_requirement": 86, "max_um": 5.5}
    summary = {
        "moves": [last, last | {"comparison": True, "n_fibres": 1}],
        "n_positioners": 92, "n_assigned": 88, "requirement_um": 5.0, "contacts_true": 2,
    }  # fmt: skip
    found = full.field_of("megara", summary, 3.0, 0.2, 0)
    assert asdict(found) | {"healthy": 87, "named": 1, "moves": 1, "contacts": 2} == asdict(found)
    assert found.missed == ["1 of the healthy beyond 5 um", "contacts"]


def test_of_several_seeds_it_tells_how_many_have_met(tmp_path, monkeypatch, capsys):
    """One misses, one is not made."""
    rows = {("pfs", 3): replace(ROW, within=2215), ("moons", 4): "ended with 2"}
    monkeypatch.setattr(full, "observe", lambda name, seed, _: rows.get((name, seed), ROW))
    three = ["--seed", "2", "--seeds", "3", "--out", str(tmp_path)]
    assert full.main(["--instrument", "pfs", "moons", *three]) == 1
    said = capsys.readouterr().out
    assert "| pfs, seed 3 | 2394 |" in said
    assert "| moons, seed 4 | not made: ended with 2 |" in said
    assert said.endswith("\npfs: met by 2 of 3 seeds\nmoons: met by 2 of 3 seeds\n")
    assert full.main(["--instrument", "desi", *three]) == 0
    assert capsys.readouterr().out.endswith("\ndesi: met by 3 of 3 seeds\n")
    with pytest.raises(SystemExit, match="2"):
        full.main(["--seeds", "0"])
