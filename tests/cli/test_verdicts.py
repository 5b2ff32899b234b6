"""What a command says of its own success: exit codes, counts against what was assigned, hints."""

import csv
import json

import numpy as np
import pytest
from astropy.table import Table

from fiberloom.cli.options import RequireOptions
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import random_pair, read_configuration, write_configuration
from fiberloom.targets import random_targets, write_targets

N, SEED = 7, 4
PLANE = ("--positioners", N, "--seed", SEED)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("verdicts")
    plane = generate(load_instrument("sdssv"), SEED, n_positioners=N)
    write_targets(random_targets(plane, 40, SEED), made / "targets.csv")
    (made / "far.csv").write_text("target_id,x_mm,y_mm\na,900,900\nb,901,900\n")
    return made


def observe(fl, targets, out, *words):
    noise = ("--camera", "noise", "--moves", 3, "--pages", "none", "--out", out)
    return fl("observe", targets, *PLANE, *noise, *words)


# observe


def test_a_list_out_of_reach_is_no_success(fl, folder, tmp_path):
    code, out, _ = observe(fl, folder / "far.csv", tmp_path)
    assert code == 1
    assert "not assigned: 2 out of reach of every positioner" in out
    assert "no target was assigned" in out
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert (summary["n_assigned"], summary["share_within_requirement"]) == (0, 0.0)


def test_what_is_dead_counts_against_what_was_assigned(fl, folder, tmp_path):
    code, out, _ = observe(fl, folder / "targets.csv", tmp_path, "--faults", "dead=3")
    summary = json.loads((tmp_path / "summary.json").read_text())
    on = summary["n_within_requirement"]
    assert code == 1
    assert summary["n_assigned"] == N
    assert summary["not_on_target"]["dead"] == 3
    assert sum(summary["not_on_target"].values()) == N - on
    assert f"below what is required: {on} of {N} (" in out
    assert "not on target: 3 dead" in out
    assert f"{on}/{N}" in out.split("correction 2")[1].splitlines()[0]
    # who asks for less gets by, nobody by nothing
    less = ("--faults", "dead=3", "--require", f"{on / N:.3f}"[:-1])
    assert observe(fl, folder / "targets.csv", tmp_path / "less", *less)[0] == 0
    none = ("--faults", f"dead={N}", "--require", "0")
    assert observe(fl, folder / "targets.csv", tmp_path / "none", *none)[0] == 1


@pytest.mark.parametrize(
    ("text", "share"), [("0.95", 0.95), ("95%", 0.95), ("100%", 1.0), ("1", 1.0), ("0", 0.0)]
)
def test_a_share_is_a_number_or_per_cent(text, share):
    assert RequireOptions(require=text).required_share == pytest.approx(share)


@pytest.mark.parametrize("text", ["95", "-1", "101%", "all", "nan"])
def test_a_share_that_could_be_misread_is_refused(text):
    with pytest.raises(InputError, match=r"--require .*0\.95, 95%"):
        _ = RequireOptions(require=text).required_share


def test_the_share_is_of_all_that_were_assigned():
    asked = RequireOptions(require="95%")
    assert asked.met(95, 100)
    assert not asked.met(94, 100)
    assert not RequireOptions(require="0").met(0, 0)


# assign


def test_assign_says_who_takes_what_and_what_was_left_out(fl, folder, tmp_path):
    goal = tmp_path / "goal.csv"
    code, out, err = fl("assign", folder / "targets.csv", *PLANE, "--out", goal, "--json")
    report = json.loads(out)
    assert (code, err) == (0, "")
    targets = {row["target_id"]: row for row in csv.DictReader(_lines(folder / "targets.csv"))}
    rows = list(csv.DictReader(goal.read_text().splitlines()))
    assert list(rows[0]) == ["positioner_id", "alpha_deg", "beta_deg", "target_id", "fibre", "priority"]
    taken = [row for row in rows if row["target_id"]]
    assert len(taken) == report["assigned"]
    plane = generate(load_instrument("sdssv"), SEED, n_positioners=N)
    angles = read_configuration(goal, plane)
    for row in taken:
        target = targets[row["target_id"]]
        at = int(plane.index_of(int(row["positioner_id"])))
        xy = plane.forward(angles[at : at + 1, 0], angles[at : at + 1, 1], row["fibre"], index=[at])[0]
        np.testing.assert_allclose(xy, [float(target["x_mm"]), float(target["y_mm"])], atol=1e-5)
        assert float(row["priority"]) == float(target["priority"])
    left = Table.read(tmp_path / "unassigned.ecsv")
    assert left.colnames == ["target_id", "reason"]
    assert set(left["target_id"]) == set(targets) - {row["target_id"] for row in taken}
    assert all(left["reason"])
    assert left.meta["seed"] == SEED
    # kinds, not one line for each
    assert sum(report["not_assigned"].values()) == len(left)
    assert not any(word.isdigit() for kind in report["not_assigned"] for word in kind.split())
    assert len(report["not_assigned"]) < 6
    code, _, err = fl("assign", folder / "targets.csv", *PLANE, "--out", goal)
    assert "choosing for 7 positioners" in err


def test_assign_from_a_start_tells_of_the_motion(fl, folder, tmp_path):
    plane = generate(load_instrument("sdssv"), SEED, n_positioners=N)
    start, goal = tmp_path / "start.csv", tmp_path / "goal.csv"
    write_configuration(start, plane.positioner_id, random_pair(plane, 1)[0], {})
    asked = ("assign", folder / "targets.csv", *PLANE, "--start", start, "--out", goal, "--json")
    code, out, _ = fl(*asked, "--strict")
    report = json.loads(out)
    assert code == 0
    assert report["motion_s"] > report["bound_s"] > 0.0
    assert report["motion_without_swaps_s"] >= report["motion_s"]
    assert report["not_arrived"] == []
    assert 1 <= report["plans"] <= 5
    # the same plan as of the two files
    code, out, _ = fl(
        "plan", "--start", start, "--goal", goal, *PLANE, "--json", "--out", tmp_path / "t.json"
    )
    assert code == 0
    assert json.loads(out)["motion_s"] == report["motion_s"]
    code, out, _ = fl(*asked, "--no-swap")
    assert "motion_s" not in json.loads(out)
    assert json.loads(out)["bound_s"] > 0.0
    assert fl("assign", folder / "targets.csv", *PLANE, "--start", tmp_path / "none.csv")[0] == 2


def test_nothing_left_out_is_an_empty_table(fl, folder, tmp_path):
    one = tmp_path / "one.csv"
    one.write_text("".join(_lines(folder / "targets.csv")[:2]))
    assert fl("assign", one, *PLANE, "--out", tmp_path / "goal.csv")[0] == 0
    left = Table.read(tmp_path / "unassigned.ecsv")
    assert (left.colnames, len(left)) == (["target_id", "reason"], 0)


def test_assign_of_a_list_out_of_reach_exits_1(fl, folder, tmp_path):
    assert fl("assign", folder / "far.csv", *PLANE, "--out", tmp_path / "goal.csv")[0] == 1


@pytest.mark.parametrize(
    ("factor", "unit"), [(1e-3, "m"), (1e3, "um"), (1 / 217.7, "deg"), (3600 / 217.7, "arcsec")]
)
def test_coordinates_in_another_unit_are_noticed(fl, folder, tmp_path, factor, unit):
    whole = random_targets(generate(load_instrument("sdssv"), SEED), 300, SEED)
    lines = [f"{k},{x},{y}\n" for k, (x, y) in enumerate(factor * whole.xy_mm)]
    other = tmp_path / "other.csv"
    other.write_text("target_id,x_mm,y_mm\n" + "".join(lines))
    _, out, _ = fl("assign", other, "--seed", SEED, "--out", tmp_path / "goal.csv", "--json")
    (note,) = (n for n in json.loads(out)["notes"] if "look like" in n)
    assert unit in note.split("look like ")[1].split(";")[0].split(" or ")
    assert "must be mm" in note


def test_millimetres_raise_no_doubt(fl, folder, tmp_path):
    _, out, _ = fl("assign", folder / "targets.csv", *PLANE, "--out", tmp_path / "goal.csv", "--json")
    assert "look like" not in out


def test_a_list_for_the_whole_instrument_raises_no_doubt_with_a_part_of_it(fl, tmp_path):
    whole = random_targets(generate(load_instrument("sdssv"), SEED), 300, SEED)
    rows = [f"{k},{x},{y}\n" for k, (x, y) in enumerate(whole.xy_mm)]
    (tmp_path / "all.csv").write_text("target_id,x_mm,y_mm\n" + "".join(rows))
    _, out, _ = fl(
        "assign", tmp_path / "all.csv", "--positioners", 37, "--out", tmp_path / "goal.csv", "--json"
    )
    assert "look like" not in out


def _lines(path):
    return [line for line in path.read_text().splitlines(keepends=True) if not line.startswith("#")]


# words at the terminal


@pytest.mark.parametrize("words", [(), ("-h",), ("--help",)])
def test_help_is_no_error(fl, words):
    code, out, err = fl(*words)
    assert (code, err) == (0, "")
    assert "Usage:" in out
    assert "observe" in out


@pytest.mark.parametrize("words", [("calibrate",), ("calibrate", "-h"), ("exclude",), ("verify", "-h")])
def test_help_of_groups_and_commands_is_no_error(fl, words):
    code, out, err = fl(*words)
    assert (code, err) == (0, "")
    assert "Usage:" in out


def test_runs_can_be_told_apart_at_80_columns(fl, folder, tmp_path, monkeypatch):
    deep = tmp_path / "a" / "rather" / "long" / "name" / "of" / "a" / "folder" / "of" / "an" / "observatory"
    for night in ("monday", "tuesday"):
        assert observe(fl, folder / "targets.csv", deep / night)[0] == 0
    monkeypatch.setenv("COLUMNS", "80")
    _, out, _ = fl("runs", deep)
    assert max(map(len, out.splitlines())) <= 80
    for night in ("monday", "tuesday"):
        (line,) = (line for line in out.splitlines() if night in line)
        assert line.split()[0] == "1"
        assert "finished" in line
        assert len([word for word in line.split() if word.count(":") == 2]) == 1  # a whole time
    rows = json.loads(fl("runs", deep, "--json")[1])
    assert {row["store"] for row in rows} == {str(deep / n / "store.sqlite") for n in ("monday", "tuesday")}


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_other_delimiters_are_read(fl, folder, tmp_path, delimiter):
    other = tmp_path / "other.csv"
    other.write_text("".join(_lines(folder / "targets.csv")).replace(",", delimiter))
    reports = []
    for file in (folder / "targets.csv", other):
        code, _, err = fl("assign", file, *PLANE, "--out", tmp_path / "goal.csv", "--json")
        assert code == 0, err
        reports.append((tmp_path / "goal.csv").read_text())
    assert reports[0] == reports[1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("target_id x_mm y_mm\na 1 2\n", "divided by commas, semicolons or tabs"),
        ("target_id,x_m,y_m\na,0.1,0.2\n", "'x_m' is not read: give x_mm, in mm"),
        ("target_id,x,y\na,0.1,0.2\n", "'x' is not read: give x_mm, in mm"),
        ("target_id,x_mm,y_mm,fibre\na,1,2,LAMOST\n", "fibre 'LAMOST' is unknown"),
        ("target_id,x_mm,y_mm,positioner_id\na,1,2,9999\n", "9999"),
    ],
)
@pytest.mark.parametrize("command", ["assign", "observe"])
def test_a_complaint_names_the_file(fl, tmp_path, text, said, command):
    file = tmp_path / "list.csv"
    file.write_text(text)
    code, _, err = fl(command, file, *PLANE, "--out", tmp_path / "out")
    assert code == 2
    assert said in err
    assert f"{file}:" in err
    assert err.strip().count("\n") <= 1
