"""The benchmark of ways apart: it goes on where it was stopped, and says what did not end well."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.untangle import __main__ as benchmark
from benchmarks.untangle import judge, starts

from fiberloom.planning import Trajectory, random_pair, untangle


def run(monkeypatch, *words: str) -> int:
    monkeypatch.setattr(sys, "argv", ["untangle", "--positioners", "7", *words])
    return benchmark.main()


def stopped(monkeypatch, folder, stops: int, *more: str) -> int:
    words = ("--stops", str(stops), "--off", "0.1", "0.3", "--out", str(folder), *more)
    return run(monkeypatch, *words)


def test_stops_are_folded_and_those_that_are_known_are_not_tried_again(monkeypatch, tmp_path, capsys):
    assert stopped(monkeypatch, tmp_path, 1) == 0
    kept = tmp_path / "results.jsonl"
    first = kept.read_text().splitlines()
    assert len(first) == 4  # at rest and displaced, by two errors
    kept.write_text("\n".join(first[:2]) + "\n" + first[2][:70])  # killed while it wrote
    capsys.readouterr()
    assert stopped(monkeypatch, tmp_path, 2) == 0
    again = kept.read_text().splitlines()
    assert len(again) == 8
    assert again[:2] == first[:2]  # not computed again: the CPU time would differ
    table = capsys.readouterr().out
    assert table.count("| 2 of 2 | 2 of 2 | 0 |") == 4


def test_plans_with_another_margin_are_not_mixed(monkeypatch, tmp_path, capsys):
    stopped(monkeypatch, tmp_path, 1)
    assert stopped(monkeypatch, tmp_path, 1, "--in-hand", "0") == 2
    assert "results of another array" in capsys.readouterr().err


@pytest.mark.parametrize(
    "bad", [{"free": False}, {"verified": False}, {"contacts": 1}, {"away": 1, "whole": True}]
)
def test_what_is_not_in_a_safe_place_is_told(monkeypatch, capsys, bad):
    good = judge.Judged(1, True, True, 0, 0, 2, 30.0, 0.1, (0.2,))
    monkeypatch.setattr(benchmark, "after_crash", lambda case: good)
    assert run(monkeypatch, "--seeds", "1", "--kinds", "knot") == 0
    monkeypatch.setattr(benchmark, "after_crash", lambda case: replace(good, **bad))
    assert run(monkeypatch, "--seeds", "1", "--kinds", "knot") == 1
    assert "hexagon 7, knot, 0.1 deg, seed 0" in capsys.readouterr().err


def test_a_collision_on_the_way_is_seen_where_the_arms_really_are():
    plane = starts.plane_of("hexagon 7")
    start_deg, _ = random_pair(plane, 0)
    found = untangle(plane, start_deg)
    nothing = np.zeros((7, 2))
    assert judge.judge(plane, found, nothing).good
    assert judge.new_contacts(plane, found.stages[0].plan, nothing) == 0
    times = np.array([0.0, 30.0])
    turning = [
        Trajectory(r.positioner_id, times, r.alpha_deg[0] + 3.0 * k * times, np.array([60.0, 60.0]))
        for k, r in enumerate(found.stages[0].plan.robots)
    ]
    blind = replace(found.stages[0].plan, robots=tuple(turning))
    assert judge.new_contacts(plane, blind, nothing) > 0
    assert not judge.verified(plane, replace(found, stages=(replace(found.stages[0], plan=blind),)))
