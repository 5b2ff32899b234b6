"""The comparison with kaiju: its paths as plans of ours, and no comparison where there is none."""

import json
import os
import sys

import numpy as np
import pytest
from benchmarks.faults.campaign import LINES
from benchmarks.planning import __main__ as comparison
from benchmarks.planning import pairs, peer, peer_worker, rows
from benchmarks.planning.builds import BUILD

PLANE = pairs.array_of("hexagon 7")
NUMBERS = list(map(str, PLANE.positioner_id))


def leg(end_deg: float, duration_s: float):
    """From this alpha, beta 90 deg, to the lattice; alpha has a corner, beta is there early."""
    alpha = [[0.0, 1.0, duration_s], [end_deg, 50.0, 10.0]]
    beta = [[0.0, duration_s / 2, duration_s], [90.0, 170.0, 170.0]]
    return {number: {"alpha": alpha, "beta": beta} for number in NUMBERS}


def test_a_path_there_and_back_becomes_a_plan():
    made = peer.as_plan(PLANE, [leg(100.0, 4.0), leg(200.0, 6.0)], 2.0)
    assert made.duration_s == pytest.approx(10.0)
    assert made.collision_buffer_mm == 2.0
    robot = made.robots[3]
    assert robot.positioner_id == PLANE.positioner_id[3]
    assert (np.diff(robot.time_s) > 0.0).all()
    wanted = [(100.0, 90.0), (50.0, 130.0), (10.0, 170.0), (50.0, 170.0 - 80.0 * 2 / 3), (200.0, 90.0)]
    np.testing.assert_allclose(robot.at([0.0, 1.0, 4.0, 9.0, 10.0]), wanted, atol=1e-6)


def test_our_verifier_judges_its_paths():
    """All arms stretched at once in the middle: they touch on the way."""
    through = {n: {"alpha": [[0.0, 9.0], [10.0 + 50 * k, 90.0]], "beta": [[0.0, 9.0], [0.0, 0.0]]}
               for k, n in enumerate(NUMBERS)}  # fmt: skip
    answer = peer.Answer({}, 1.0, 2.0, *(peer.as_plan(PLANE, [through, through], 2.0),) * 2)
    line = comparison.theirs(PLANE, answer)
    assert not line["verified"]
    assert line["gap_um"] < 0.0
    assert line["cpu_s"] == 3.0


def test_only_points_where_the_direction_changes_are_kept_of_a_raw_path():
    alpha = [[k, a] for k, a in enumerate([1.0, 2.0, 3.0, 3.0, 3.0])]
    beta = [[k, 5.0] for k in range(5)]
    path = peer_worker.raw(zip(alpha, beta, strict=True), [0.0, 5.0], 0.5)
    assert path["alpha"] == [[0.0, 1.5, 2.5], [0.0, 3.0, 3.0]]
    assert path["beta"] == [[0.0, 1.5, 2.5], [5.0, 5.0, 5.0]]


def test_who_fails_either_way_has_failed():
    out = {"version": "x", "legs": [{"failed": [3], "reason": "late", "plan_cpu_s": 2.0}, {"failed": []}]}
    answer = peer.answer_of(PLANE, out, 2.0)
    assert answer.failed == {3: "late"}
    assert answer.sent is None
    assert "motion_s" not in comparison.theirs(PLANE, answer)


def test_why_there_is_no_peer(tmp_path):
    python = tmp_path / ".venv-kaiju" / "bin" / "python"
    assert "make kaiju" in peer.why_not(python)
    python.parent.mkdir(parents=True)
    (tmp_path / ".venv-kaiju" / "why-not.txt").write_text("kaiju cannot be built: no compiler\n")
    assert peer.why_not(python) == "kaiju cannot be built: no compiler"


@pytest.mark.parametrize(
    ("script", "limit_s", "why"),
    [
        ("exit 9", 60.0, "ended with 9"),
        ("echo oh >&2; exit 1", 60.0, "oh"),
        ("while :; do :; done", 1.0, "not ready after 1 CPU s"),
        ("exec sleep 60", 1.0, "not ready after 2 s of real time"),
    ],
)
def test_a_peer_that_dies_or_hangs_has_failed_for_all(tmp_path, monkeypatch, script, limit_s, why):
    monkeypatch.setattr(peer, "_HANGS", 2 if "sleep" in script else 60)
    python = tmp_path / "python"
    python.write_text(f"#!/bin/sh\n{script}\n")
    python.chmod(0o755)
    answer = peer.asked(PLANE, {"buffer_mm": 2.0}, limit_s, python)
    assert set(answer.failed) == set(PLANE.positioner_id.tolist())
    assert all(why in reason for reason in answer.failed.values())


@pytest.mark.parametrize(("more", "code"), [((), 3), (("--alone",), 0)])
def test_no_comparison_is_told_and_not_pretended(tmp_path, monkeypatch, capsys, more, code):
    monkeypatch.setattr(peer, "why_not", lambda: "it is not there")
    monkeypatch.setattr(pairs, "real_layout", lambda: None)
    out = tmp_path / "planning.json"
    words = ["--pairs", "1", "--hexagon", "7", "--out", str(out), *more]
    monkeypatch.setattr(sys, "argv", ["benchmarks.planning", *words])
    assert comparison.main() == code
    said = capsys.readouterr().out
    assert "no comparison with kaiju" in said
    assert "no real array" in said
    assert "| kaiju |" not in said
    report = json.loads(out.read_text())
    assert report["no_comparison"]
    assert {row["who"] for row in report["rows"]} == {"fiberloom"}


def alone(monkeypatch, folder, pair_count):
    monkeypatch.setattr(pairs, "real_layout", lambda: None)
    words = ["--alone", "--generated", "--hexagon", "7", "--pairs", str(pair_count), "--keep", str(folder)]
    monkeypatch.setattr(sys, "argv", ["benchmarks.planning", *words])
    return comparison.main()


def test_it_goes_on_where_it_was_stopped_and_mixes_no_builds(tmp_path, monkeypatch, capsys):
    assert alone(monkeypatch, tmp_path, 1) == 0
    kept = tmp_path / "hexagon-7-2mm-alone" / LINES
    first = kept.read_text()
    assert alone(monkeypatch, tmp_path, 2) == 0
    assert kept.read_text().startswith(first)  # not computed again: its CPU time would differ
    assert "| 2 of 2 | 0 of 14 |" in capsys.readouterr().out
    mark = kept.with_name(BUILD)
    mark.write_text(json.dumps(json.loads(mark.read_text()) | {"build": "0123456789ab"}))
    assert alone(monkeypatch, tmp_path, 2) == 2
    assert "another build" in capsys.readouterr().err


def test_a_pair_whose_process_dies_is_no_success(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(comparison, "ours", lambda *_: os._exit(9))
    assert alone(monkeypatch, tmp_path, 1) == 1
    said = capsys.readouterr().out
    assert "| 0 of 1 | 7 of 7 |" in said
    assert "ended with 9" in said


def line(**more):
    return {"failed": {}, "positioners": 10, "bound_s": 20.0, "verified": True, "cpu_s": 1.0, **more}


def test_rows_count_failures_and_growth_is_a_power():
    good, bad = line(motion_s=22.0, gap_um=5.0), line(failed={"3": "late"}, verified=False)
    one = rows.row("hexagon 10", 2.0, "kaiju", [good, bad])
    assert (one["solved"], one["failed"], one["of"], one["unsafe"]) == (1, 1, 20, 0)
    assert one["ratio"] == pytest.approx({"median": 1.1, "worst": 1.1})
    assert "| 1 of 2 | 1 of 20 |" in rows.show(one)
    assert rows.row("x", 2.0, "kaiju", [good | {"verified": False}])["unsafe"] == 1
    assert rows.exponent([(n, 3e-5 * n**1.5) for n in (500, 1000, 5000)]) == pytest.approx(1.5)
    sizes = [one | {"positioners": n, "cpu_s": {"median": n / 500}} for n in (500, 600, 2000)]
    assert "N^1.00" in rows.growth(sizes)[0]
    assert rows.growth(sizes[:2]) == []
    late = sizes[2] | {"solved": 0}
    assert rows.growth([*sizes[:2], late]) == []


def test_kaiju_itself():
    if reason := peer.why_not():
        pytest.skip(f"kaiju is not compared: {reason}")
    ends = pairs.ends_of(PLANE, 0, 2.0)
    answer = peer.asked(PLANE, peer.job_of(PLANE, ends, 2.0, pairs.speed_deg_s(PLANE), 0), 120.0)
    assert answer.failed == {}
    for made in (answer.sent, answer.raw):
        np.testing.assert_allclose([r.points_deg[0] for r in made.robots], ends[0], atol=1e-6)
        np.testing.assert_allclose(made.end_deg, ends[1], atol=1e-6)
    assert pairs.clear(PLANE, answer.raw).min_clearance_mm > 0.0
