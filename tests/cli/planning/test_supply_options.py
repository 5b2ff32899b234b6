"""`plan`, `verify`, `night` with a limit on the power or on how many move at once."""

import json
from importlib.resources import files

import pytest

N = 7


@pytest.fixture
def planned(fl, ends, tmp_path):
    """Runs `plan`: exit code, report, stderr; and where the trajectories are."""

    def run(*words):
        out = tmp_path / "t.json"
        places = ("--start", ends / "start.csv", "--goal", ends / "goal.csv", "--out", out)
        code, said, err = fl("plan", *places, "--positioners", N, "--json", *words)
        return code, json.loads(said) if said else {}, err, out

    return run


def test_a_plan_keeps_the_power_and_verify_proves_it(fl, planned):
    free_s = planned()[1]["motion_s"]
    code, report, _, out = planned("--power", 0.13)
    assert code == 0
    assert 0.12 < report["peak_W"] <= report["power_W"] == 0.13
    assert report["motion_s"] > 1.3 * free_s
    words = ("verify", out, "--positioners", N, "--json")
    code, said, _ = fl(*words, "--power", 0.13)
    assert (code, json.loads(said)["verified"]) == (0, True)
    code, said, _ = fl(*words, "--power", 0.12)
    told = json.loads(said)
    assert (code, told["verified"], told["collisions"]) == (1, False, 0)
    assert "the motors take" in told["beyond_the_supply"][0]


def test_so_many_at_once_come_in_waves_and_verify_proves_it(fl, planned):
    code, report, _, out = planned("--at-once", 3)
    assert (code, report["most_at_once"], report["arrived"]) == (0, 3, N)
    words = ("verify", out, "--positioners", N, "--json")
    assert fl(*words, "--at-once", 3)[0] == 0
    code, said, _ = fl(*words, "--at-once", 2)
    assert code == 1
    assert "3 positioners move at" in json.loads(said)["beyond_the_supply"][0]


def test_the_supply_of_the_file_is_kept_by_plan_too(planned, tmp_path):
    care = "[care]\nsupply_A = 0.2\nmotor_friction_A = [0.01, 0.01]\nmotor_speed_A = [0.05, 0.01]\n"
    text = files("fiberloom.instruments.presets").joinpath("sdssv.toml").read_text().replace("[care]\n", care)
    own = tmp_path / "own.toml"
    own.write_text(text)
    code, report, err, _ = planned("--instrument", own)
    assert (code, err) == (0, "")
    assert 0.18 < report["peak_A"] <= report["supply_A"] == 0.2


def test_too_little_says_what_one_positioner_takes(fl, planned, tmp_path):
    code, _, err, _ = planned("--power", 0.001)
    assert code == 2
    assert "--power 0.001: one positioner takes 0.0" in err
    assert planned("--at-once", 0)[0] == 2
    (tmp_path / "a.csv").write_text("target_id,x_mm,y_mm\nA,10,0\n")
    queue = tmp_path / "night.toml"
    queue.write_text(
        "dawn = 2026-11-25T22:00:00Z\n[array]\npositioners = 1\npower_W = 0.001\n"
        '[[field]]\nid = "a"\ntargets = "a.csv"\n'
    )
    code, _, err = fl("night", queue, "--out", tmp_path / "runs")
    assert code == 2
    assert "one positioner takes 0.0" in err
