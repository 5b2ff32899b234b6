"""`fiberloom plan --late`: what it reports, and what it refuses."""

import json

import pytest

from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import (
    PlanSettings,
    plan,
    random_pair,
    read_configuration,
    read_plans,
    verify_late,
    write_configuration,
)

N = 19


@pytest.fixture(scope="module")
def plane():
    return generate(load_instrument("sdssv"), 0, n_positioners=N)


@pytest.fixture
def planned(fl, plane, tmp_path):
    """Runs the command on two configurations: exit code, stdout, stderr."""
    for name, angles_deg in zip(("start.csv", "goal.csv"), random_pair(plane, 2), strict=True):
        write_configuration(tmp_path / name, plane.positioner_id, angles_deg)

    def run(*words):
        ends = ("--start", tmp_path / "start.csv", "--goal", tmp_path / "goal.csv")
        return fl("plan", *ends, "--positioners", N, "--out", tmp_path / "t.json", *words)

    return run


@pytest.mark.parametrize(("word", "late_s"), [("2", 2.0), ("inf", float("inf"))])
def test_it_says_what_it_costs_and_which_pairs_cannot_bear_it(planned, plane, tmp_path, word, late_s):
    code, out, err = planned("--late", word, "--json")
    report = json.loads(out)
    assert (code, err) == (0, "")
    (made,) = read_plans(tmp_path / "t.json", plane)
    ends_deg = [read_configuration(tmp_path / name, plane) for name in ("start.csv", "goal.csv")]
    assert made.to_json() == plan(plane, *ends_deg, settings=PlanSettings(late_s=late_s)).to_json()
    failing = verify_late(plane, made, late_s).failing_pairs
    assert report["late_s"] == (2.0 if word == "2" else "for good")
    assert report["pairs_that_cannot_bear_it"] == len(failing)
    assert report["cannot_bear_it"][:5] == [f"{i} and {j}" for i, j in failing][:5]
    assert report["motion_if_none_is_late_s"] == plan(plane, *ends_deg).duration_s
    assert report["motion_s"] == made.duration_s


def test_a_budget_is_not_spent_on_a_second_plan(planned):
    report = json.loads(planned("--late", "1", "--budget", "60", "--json")[1])
    assert "motion_if_none_is_late_s" not in report
    assert report["late_s"] == 1.0


@pytest.mark.parametrize("word", ["-1", "nan"])
def test_what_is_no_lateness_is_refused(planned, word):
    code, _, err = planned("--late", word)
    assert code == 2
    assert f"--late {word}" in err
    assert "from 0 on, or inf" in err
