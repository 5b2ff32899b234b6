"""`fiberloom sky survey`: several exposures of a field, from a list with visits and roles."""

import csv
import json

import numpy as np
import pytest

from fiberloom.assignment.visits.survey import SurveyList, completeness, sectors_of
from fiberloom.instruments import FocalPlane

N = 60


@pytest.fixture
def survey(tmp_path):
    """Writes a survey of two exposures of a small field; `change` replaces text of survey.toml."""
    rng = np.random.default_rng(1)
    turn, off = rng.uniform(0, 2 * np.pi, N), 0.03 * np.sqrt(rng.random(N))
    ra, dec = 213.7042 + off * np.cos(turn) / np.cos(np.radians(53.08333)), 53.08333 + off * np.sin(turn)
    roles = ["sky" if k % 4 == 0 else "" for k in range(N)]
    rows = [f"{k},{ra[k]:.9f},{dec[k]:.9f},{k % 3},{1 + k % 2},{roles[k]}" for k in range(N)]
    (tmp_path / "stars.csv").write_text("\n".join(["target_id,ra,dec,priority,visits,role", *rows]) + "\n")
    (tmp_path / "field.toml").write_text(
        'ra_deg = 213.7042\ndec_deg = 53.08333\ntime = "2024-04-26T06:00:00"\ntime_scale = "utc"\n'
        "exposure_s = 900\noverhead_s = 60\n"
    )
    text = (
        'targets = "stars.csv"\nsectors = 2\n[minimum]\nsky = 1\n'
        '[[pointings]]\nfield = "field.toml"\nexposures = 2\n'
    )

    def write(before="", after=""):
        assert before in text
        (tmp_path / "survey.toml").write_text(text.replace(before, after))
        return tmp_path / "survey.toml"

    return write


def run(fl, file, out, *more):
    code, said, wrong = fl("sky", "survey", file, "--positioners", 7, "--out", out, "--json", *more)
    return code, json.loads(said) if code == 0 else {}, wrong


def read(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_exposures_are_written_as_assign_takes_them(fl, survey, tmp_path):
    code, told, wrong = run(fl, survey(), tmp_path / "out")
    assert code == 0, wrong
    assert told["proven"]
    assert told["fewest_in_a_sector"]["sky"] >= 1
    assert told["value_of_others"]["greedy"] is None or told["value_of_others"]["greedy"] <= told["bound"]
    visits = {row["target_id"]: 0 for row in read(tmp_path / "stars.csv")}
    for number in (1, 2):
        rows = read(tmp_path / "out" / f"exposure-{number:02d}.csv")
        assert len(rows) == told["assigned"][number - 1]
        goal = tmp_path / f"goal{number}.csv"
        field = tmp_path / "out" / f"field-{number:02d}.toml"
        exposure = tmp_path / "out" / f"exposure-{number:02d}.csv"
        code, _, wrong = fl("assign", exposure, "--field", field, "--positioners", 7, "--out", goal)
        assert code == 0, wrong
        taken = {
            row["target_id"]: (row["positioner_id"], row["fibre"]) for row in read(goal) if row["target_id"]
        }
        assert taken == {row["target_id"]: (row["positioner_id"], row["fibre"]) for row in rows}
        for name in taken:
            visits[name] += 1
    wanted = {row["target_id"]: int(row["visits"]) for row in read(tmp_path / "stars.csv") if not row["role"]}
    assert all(visits[name] <= most for name, most in wanted.items())
    assert "2024-04-26T06:16:00" in (tmp_path / "out" / "field-02.toml").read_text()


def test_the_same_seed_writes_the_same_bytes(fl, survey, tmp_path):
    for out in ("a", "b"):
        assert run(fl, survey(), tmp_path / out, "--seed", "3")[0] == 0
    for name in ("exposure-01.csv", "exposure-02.csv", "field-02.toml"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ("sky = 1", "sky = 9", "survey.toml: exposure 1, sector 1: 9 sky fibres are asked for, "),
        ("sky = 1", "dark = 1", "role 'sky' has no minimum; roles are dark, guide, science"),
        ("exposures = 2", "exposures = 0", "exposures"),
        ("stars.csv", "none.csv", "none.csv: no such file"),
        ("[minimum]\nsky = 1", "[minimum]\nscience = 1", "science targets have priorities, no minimum"),
        ("sectors", "sektors", "sektors"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(fl, survey, tmp_path, before, after, told):
    code, _, wrong = run(fl, survey(before, after), tmp_path / "out")
    assert code == 2
    assert told in wrong
    assert len(wrong.strip().splitlines()) == 1


def test_a_field_without_a_target_is_named(fl, survey, tmp_path):
    field = tmp_path / "field.toml"
    field.write_text(field.read_text().replace("213.7042", "200.0"))
    code, _, wrong = run(fl, survey(), tmp_path / "out")
    assert code == 2
    assert "field.toml: no target of" in wrong


def test_sectors_are_of_equal_angle_from_x_on():
    plane = FocalPlane.of("sdssv", n=7)
    around = np.degrees(np.arctan2(plane.centres_mm[:, 1], plane.centres_mm[:, 0])) % 360.0
    assert (sectors_of(plane, 4) == around // 90).all()
    assert set(sectors_of(plane, 4).tolist()) == {0, 1, 2, 3}


def test_completeness_counts_science_targets_by_priority():
    names = np.array(["a", "b", "c", "s"])
    role = np.array(["science"] * 3 + ["sky"])
    survey = SurveyList(names, np.array([1.0, 2.0, 2.0, 2.0]), np.array([1, 2, 1, 1]), role)
    rows = completeness(survey, np.array([1, 1, 1, 5]))
    assert rows[0] == {"priority": 2.0, "targets": 2, "complete": 1, "visits_wanted": 3, "visits_done": 2}
    assert rows[1] == {"priority": 1.0, "targets": 1, "complete": 1, "visits_wanted": 1, "visits_done": 1}


def test_guide_stars_are_in_the_list_of_every_exposure_that_sees_them(fl, survey, tmp_path):
    file = survey()
    with (tmp_path / "stars.csv").open("a") as stars:
        stars.write("g1,213.7,54.1,0,1,guide\ng2,213.7,60.0,0,1,guide\n")
    assert run(fl, file, tmp_path / "out")[0] == 0
    from fiberloom.targets import read_targets

    for number in (1, 2):
        field = tmp_path / "out" / f"field-{number:02d}.toml"
        listed = read_targets(tmp_path / "out" / f"exposure-{number:02d}.csv", field)
        assert listed.on_sky.guides.target_id.tolist() == ["g1"]
        assert "g1" not in listed.target_id
