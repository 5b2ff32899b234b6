"""The planning campaign: it resumes, mixes no builds, judges each figure, and keeps every failure."""

import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.faults.campaign import LINES
from benchmarks.planning import builds, campaign, goals, pairs
from benchmarks.planning.builds import BUILD, claim, mark_of_build
from benchmarks.planning.goals import ASKED, PAIRS, Cell, Verdict, cells, exit_code, of_count, of_figure

from fiberloom.errors import InputError
from fiberloom.planning import read_configuration

ARRAY = "hexagon 7"


def asked(folder, **more):
    given = {"pairs": "0:2", "buffer": [2.0], "array": ARRAY, "workers": 1, "deadline": 60.0, "out": folder}
    rest = {"again": None, "anew": False, "mutants": 0, "grazing": 0}
    return Namespace(**(given | rest | more))


def kept(folder):
    return [json.loads(text) for text in (folder / "hexagon-7-2mm" / LINES).read_text().splitlines()]


def test_it_goes_on_where_it_was_stopped(tmp_path, capsys):
    assert campaign.run(asked(tmp_path, pairs="0:1")) == 0  # nothing is asked of 7 positioners
    first = kept(tmp_path)
    assert [line["seed"] for line in first] == [0]
    with (tmp_path / "hexagon-7-2mm" / LINES).open("a") as file:
        file.write('{"seed": 1, "fail')  # killed while it wrote
    campaign.run(asked(tmp_path))
    both = kept(tmp_path)
    assert both[0] == first[0]  # not computed again: its CPU time would differ
    assert [line["seed"] for line in both] == [0, 1]
    assert all(not goals.failed(line) for line in both)
    assert "| 2 | 2 | 0 | 0 |" in capsys.readouterr().out


def test_an_interruption_keeps_what_is_done(tmp_path, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(campaign, "keep_failure", stop)  # called after each new line
    with pytest.raises(KeyboardInterrupt):
        campaign.run(asked(tmp_path))
    assert [line["seed"] for line in kept(tmp_path)] == [0]


def test_results_of_another_build_are_not_mixed(tmp_path):
    campaign.run(asked(tmp_path, pairs="0:1"))
    mark = tmp_path / "hexagon-7-2mm" / BUILD
    mark.write_text(json.dumps(json.loads(mark.read_text()) | {"build": "0123456789ab"}))
    with pytest.raises(InputError, match=r"another build \(0123456789ab, and this is .*--anew"):
        campaign.run(asked(tmp_path, pairs="0:1"))
    campaign.run(asked(tmp_path, pairs="0:1", anew=True))
    assert (tmp_path / "before-1-hexagon-7-2mm" / LINES).exists()
    assert len(kept(tmp_path)) == 1
    with pytest.raises(InputError, match=r"another array \(.*, and this is of other arms") as told:
        claim(tmp_path / "hexagon-7-2mm", "of other arms")
    assert "--anew" not in str(told.value)  # not every command has it


@pytest.mark.parametrize("judge", ["bodies.py", "campaign.py", "oracle.py", "pockets.py"])
def test_results_that_were_judged_otherwise_are_of_another_build(monkeypatch, judge):
    mine, read = mark_of_build(), Path.read_bytes
    path = Path(builds.__file__).with_name(judge)
    monkeypatch.setattr(Path, "read_bytes", lambda file: read(file) + b"#" * (file == path))
    assert mark_of_build.__wrapped__()["build"] != mine["build"]


def test_a_positioner_that_has_a_way_but_is_refused_is_a_failure_with_its_files(tmp_path, monkeypatch):
    made_of = pairs.made_of

    def refusing(plane, *given):
        made = made_of(plane, *given)
        return replace(made, plan=replace(made.plan, refused={int(plane.positioner_id[3]): "no will"}))

    monkeypatch.setattr(pairs, "made_of", refusing)
    campaign.run(asked(tmp_path, pairs="5:6"))
    (line,) = kept(tmp_path)
    assert list(line["failed"].values()) == ["no will"]
    assert line["rightly"] == {}
    place = tmp_path / "hexagon-7-2mm" / "failures" / "pair-5"
    reason = json.loads((place / campaign.REASON).read_text())
    assert (reason["seed"], reason["buffer_mm"]) == (5, 2.0)
    array = campaign.Array.of(ARRAY, 2.0)
    for name, angles in zip(("start", "goal"), array.ends_of(5), strict=True):
        np.testing.assert_allclose(read_configuration(place / f"{name}.csv", array.plane), angles, atol=1e-9)


# verdicts


def line(seed, **more):
    figures = {"ratio": 1.05, "cpu_s": 0.3, "points_mean": 12.0, "points_worst": 30}
    return {"seed": seed, "failed": {}, "rightly": {}, "verified": True, **figures, **more}


GOOD = [line(seed) for seed in range(PAIRS)]


def verdicts(lines, buffer_mm=2.0):
    return {cell.verdict for cell in cells(lines, ASKED[buffer_mm])} - {Verdict.NONE}


def test_a_thousand_good_pairs_meet_every_goal():
    assert verdicts(GOOD) == {Verdict.MET}
    assert exit_code(cells(GOOD, ASKED[2.0])) == 0


@pytest.mark.parametrize("n", [0, 1, PAIRS - 1])
def test_too_few_pairs_meet_nothing(n):
    assert verdicts(GOOD[:n]) == {Verdict.FEW}
    assert exit_code(cells(GOOD[:n], ASKED[2.0])) == 1


@pytest.mark.parametrize(
    ("bad", "column"),
    [
        ({"failed": {"7": "no path"}}, 1),
        ({"hang": True}, 1),
        ({"crash": "Traceback\nValueError"}, 1),
        ({"verified": False, "why": "touches"}, 1),
        ({"ratio": 1.31}, 5),
        ({"cpu_s": 2.01}, 7),
    ],
)
def test_one_bad_pair_misses_its_goal_however_many_there_are(bad, column):
    for n in (1, PAIRS):
        found = cells([line(0, **bad), *GOOD[1:n]], ASKED[2.0])
        assert found[column].verdict == Verdict.MISSED
        assert exit_code(found) == 1


def test_medians_are_held_against_their_goals():
    slow = [line(seed, ratio=1.081, cpu_s=0.51) for seed in range(PAIRS)]
    assert [cell.verdict for cell in cells(slow, ASKED[2.0])].count(Verdict.MISSED) == 2
    assert verdicts(slow[:5]) == {Verdict.FEW}
    assert verdicts(slow, 2.5) == {Verdict.MET}


def test_five_of_a_thousand_may_fail_at_three_millimetres():
    bad = [line(seed, failed={"1": "x"}) for seed in range(6)]
    assert cells([*bad[:5], *GOOD[5:]], ASKED[3.0])[1].verdict == Verdict.MET
    assert cells([*bad, *GOOD[6:]], ASKED[3.0])[1].verdict == Verdict.MISSED
    assert of_count(6, 5, 2000).verdict == Verdict.MET


def test_pairs_that_would_fail_if_motions_went_up_to_the_hard_stops_are_told():
    off = {"7": "no way alone that keeps 1 deg to the hard stops, cells of 0.5 deg"}
    lines = [line(3, rightly=off), line(4, rightly={"7": "no way alone, cells of 0.5 deg"})]
    lines += [line(5, rightly=off, failed={"8": "x"}), line(6, rightly=off)]
    said = "3 mm: 2 pairs without a failure only as motions keep off the hard stops: 3, 6"
    assert goals.only_off_the_stops(3.0, lines) == [said]
    assert goals.only_off_the_stops(3.0, lines[1:3]) == []


def test_refused_rightly_is_no_failure():
    pocket = line(0, rightly={"7": "no way alone"})
    found = cells([pocket, *GOOD[1:]], ASKED[2.0])
    assert found[2] == Cell("1")
    assert found[1].verdict == Verdict.MET


def test_a_figure_with_no_goal_has_no_verdict():
    assert of_figure([1.0, 2.0], 1.0, None, 2) == Cell("2.000")
    assert str(of_figure([], 0.5, 1.0, 0)) == "- too few pairs"
    assert goals.asked_at(2.0, 61) is None
    assert goals.asked_at(1.5, 500) is None


def test_a_range_of_pairs_is_checked():
    assert campaign.range_of("3:5") == range(3, 5)
    with pytest.raises(InputError, match="A:B"):
        campaign.range_of("3")
