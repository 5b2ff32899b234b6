"""`fiberloom plan`: what it reports, the buffer it plans with, the film, and what it refuses."""

import json
import re

import numpy as np
import pytest

from fiberloom import planning
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import PlanSettings, random_pair, read_configuration, write_configuration
from fiberloom.report.film import film, moments

N = 7

ANGLES = ("alpha_deg", "beta_deg")


@pytest.fixture
def planned(fl, ends, tmp_path):
    """Runs the command on the two configurations: exit code, stdout, stderr."""

    def run(*words, goal=ends / "goal.csv"):
        words = (*words, "--positioners", N, "--out", tmp_path / "t.json")
        return fl("plan", "--start", ends / "start.csv", "--goal", goal, *words)

    return run


@pytest.fixture
def not_planned(monkeypatch):
    """Fails where a plan is begun."""

    def begun(*arguments, **settings):
        raise AssertionError("a plan was begun")

    monkeypatch.setattr(planning, "plan", begun)


def corners(time_s, angle_deg):
    """How often the speed changes, start and end counted."""
    speeds = np.diff(angle_deg) / np.diff(time_s)
    return 2 + np.count_nonzero(np.abs(np.diff(speeds)) > 1e-6)


def test_the_report_says_what_the_plan_comes_to(fl, planned, plane, ends, tmp_path):
    code, out, err = planned("--json")
    report = json.loads(out)
    assert (code, err) == (0, "")
    assert list(report) == [
        "robots", "arrived", "not_arrived", "own_approach", "notes", "buffer_mm", "bound_s", "motion_s",
        "motion_over_bound", "cpu_s", "points_per_axis_mean", "points_per_axis_worst", "frames", "wire_s",
        "min_clearance_mm", "verified", "most_at_once", "trajectories",
    ]  # fmt: skip
    assert (report["robots"], report["arrived"], report["not_arrived"], report["notes"]) == (N, N, [], [])
    start_deg, goal_deg = (read_configuration(ends / f, plane) for f in ("start.csv", "goal.csv"))
    # 11.7 deg/s, 0.82 deg of approach on top of the goal and down again
    bound_s = (np.abs(goal_deg + 0.82 - start_deg).max() + 0.82) / 11.7
    assert report["bound_s"] == pytest.approx(bound_s, rel=1e-9)
    assert report["motion_over_bound"] == pytest.approx(report["motion_s"] / bound_s, rel=1e-9)
    assert report["motion_over_bound"] > 1.0
    document = json.loads((tmp_path / "t.json").read_text())
    points = [corners(robot["time_s"], robot[axis]) for robot in document["robots"] for axis in ANGLES]
    assert report["points_per_axis_mean"] == pytest.approx(np.mean(points))
    assert report["points_per_axis_worst"] == max(points) > 4
    assert report["frames"] == sum(points) + 2 * N
    assert report["motion_s"] == max(robot["time_s"][-1] for robot in document["robots"])
    verdict = json.loads(fl("verify", tmp_path / "t.json", "--positioners", N, "--json")[1])
    assert report["min_clearance_mm"] == verdict["min_clearance_mm"] > 0.0
    table = planned()[1]
    for words in ("bound s", "motion over bound", "points per axis worst", "min clearance mm", "buffer mm"):
        assert f"  {words} " in table


def test_where_nothing_has_to_move_there_is_no_bound(planned, ends):
    code, out, _ = planned("--json", goal=ends / "start.csv")
    report = json.loads(out)
    assert (code, report["bound_s"], report["motion_s"], report["motion_over_bound"]) == (0, 0.0, 0.0, None)
    assert "motion over bound       -" in planned(goal=ends / "start.csv")[1]


@pytest.mark.parametrize(("buffer_mm", "note"), [(1.2, True), (2.0, False), (2.1, False)])
def test_a_buffer_is_planned_and_verified_with(planned, fl, tmp_path, monkeypatch, buffer_mm, note):
    checked_mm = []
    verify = planning.verify

    def watched(plane, plan, **rules):
        checked_mm.append(rules["limits"].collision_buffer_mm)
        return verify(plane, plan, **rules)

    monkeypatch.setattr(planning, "verify", watched)
    code, out, _ = planned("--buffer", buffer_mm, "--json")
    report = json.loads(out)
    assert (code, report["verified"], report["buffer_mm"]) == (0, True, buffer_mm)
    assert json.loads((tmp_path / "t.json").read_text())["collision_buffer_mm"] == buffer_mm
    assert checked_mm == [buffer_mm]
    below = [line for line in report["notes"] if "below the 2 mm of sdssv" in line]
    assert bool(below) == note
    # what the note says of `verify` is so
    hinted = f"--buffer {buffer_mm:g} only" in "".join(below)
    monkeypatch.undo()
    code, _, err = fl("verify", tmp_path / "t.json", "--positioners", N)
    assert (code == 2) == hinted == note, err
    assert fl("verify", tmp_path / "t.json", "--positioners", N, "--buffer", buffer_mm)[0] == 0


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf"])
def test_a_buffer_that_no_arm_can_have(planned, not_planned, value):
    code, out, err = planned("--buffer", value)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"--buffer {value}: must be a finite number above 0 mm" in err


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf"])
def test_a_budget_in_which_nothing_can_be_done(planned, not_planned, value):
    code, out, err = planned("--budget", value)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"--budget {value}: must be a finite number above 0 s" in err


def test_a_budget_that_is_used_up_is_told(planned):
    report = json.loads(planned("--budget", 1e-6, "--json")[1])
    assert report["verified"]
    assert any("the budget of 1e-06 s was used up" in line for line in report["notes"])
    assert json.loads(planned("--budget", 1000, "--json")[1])["notes"] == []


def test_arms_wider_than_the_pitch(planned):
    code, out, err = planned("--buffer", 12, "--json")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "collision_buffer_mm = 12: the arms are 24 mm wide" in err


def test_who_does_not_arrive_is_told_with_the_reason(planned, plane, ends, tmp_path):
    rows = [line.split(",") for line in (ends / "goal.csv").read_text().splitlines()]
    rows[3][1], rows[1][2] = "363.900000000", "-3.500000000"
    goal = tmp_path / "far.csv"
    goal.write_text("".join(",".join(row) + "\n" for row in rows))
    code, out, _ = planned("--json", goal=goal)
    report = json.loads(out)
    assert (code, report["arrived"]) == (1, N - 2)
    first, third = plane.positioner_id[[0, 2]]
    why = "its goal lies beyond the travel of its axes"
    assert report["not_arrived"] == [
        f"positioner {first}: {why}; beta needs -3.5 to -3.2072 deg, and has -3 to 190 deg",
        f"positioner {third}: {why}; alpha needs 363.9 to 364.193 deg, and has -3 to 363 deg",
    ]
    # who does not go has no way that counts
    assert report["motion_over_bound"] > 1.0


def test_arms_that_overlap_at_the_start_are_told_and_what_to_do(fl, tmp_path):
    plane = generate(load_instrument("sdssv"), 0, n_positioners=37)
    for name, angles_deg in zip(("start.csv", "goal.csv"), random_pair(plane, 0), strict=True):
        write_configuration(tmp_path / name, plane.positioner_id, angles_deg)
    words = ("--start", tmp_path / "start.csv", "--goal", tmp_path / "goal.csv", "--positioners", 37)
    code, out, _ = fl("plan", *words, "--buffer", 2.3, "--out", tmp_path / "t.json", "--json")
    report = json.loads(out)
    assert code == 1
    assert any(re.search(r"it touches .* before it moves", line) for line in report["not_arrived"])
    assert any(line.startswith("overlap, and stay: positioner ") for line in report["notes"])
    assert report["notes"][-1] == "a smaller --buffer may let them move"
    assert report["min_clearance_mm"] < 0.0


# the film


@pytest.fixture
def brief(monkeypatch):
    monkeypatch.setattr(moments, "FEWEST", 2)
    monkeypatch.setattr(moments, "MOST", 2)
    monkeypatch.setattr(film, "LAST_S", 0.0)


def test_a_film_is_made_and_named(planned, tmp_path, brief):
    path = tmp_path / "new" / "film.gif"
    code, out, err = planned("--animate", path, "--json")
    assert (code, err, json.loads(out)["film"]) == (0, "", str(path))
    assert path.read_bytes().startswith(b"GIF89a")
    assert [p.name for p in path.parent.iterdir()] == ["film.gif"]
    lines = planned("--animate", path)[2].splitlines()
    assert lines[-1] == "drawing the film"


def test_the_film_shows_the_refused_and_the_title_of_the_plan(planned, tmp_path, monkeypatch, brief):
    made = []
    monkeypatch.setattr(film, "write_film", lambda path, shown, title, progress: made.append((shown, title)))
    code, out, _ = planned("--animate", tmp_path / "film.gif", "--buffer", 1.9, "--json")
    ((shown, title),) = made
    report = json.loads(out)
    assert title == (
        f"{N} positioners, {report['motion_s']:.1f} s of motion, least gap "
        f"{report['min_clearance_mm']:.3f} mm beyond the buffer, verified"
    )
    assert (code, shown.bodies.radius_mm) == (0, 1.9)


@pytest.mark.parametrize(
    ("name", "said"),
    [("film.avi", "a film is a .gif or a .mp4 file"),
     ("film", "a film is a .gif or a .mp4 file"),
     ("film.mp4", "needs ffmpeg"),
     ("taken/film.gif", "cannot write there"),
     ("folder.gif", "is a folder")],
)  # fmt: skip
def test_a_film_that_cannot_be_is_refused_before_planning(
    planned, not_planned, tmp_path, monkeypatch, name, said
):
    (tmp_path / "taken").write_text("a file, not a folder")
    (tmp_path / "folder.gif").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path))
    code, out, err = planned("--animate", tmp_path / name)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "--animate" in err
    assert said in err
    assert not (tmp_path / "t.json").exists()


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--out", "start.csv"), "--out start.csv: is read by this command; give another name"),
        (("--out", "."), "--out .: cannot be written (it is a folder); give the name of a file"),
        (("--animate", "x.gif", "--out", "x.gif"), "--animate x.gif: is --out too; give another name"),
        (("--start", "."), ".: is a folder; give the name of a file"),
        (("--buffer", "wide"), "see `fiberloom plan --help`"),
    ],
)
def test_what_is_written_is_looked_at_before_planning(fl, ends, not_planned, monkeypatch, words, why):
    monkeypatch.chdir(ends)
    kept = (ends / "start.csv").read_bytes()
    code, out, err = fl("plan", "--positioners", N, "--start", "start.csv", "--goal", "goal.csv", *words)
    assert (code, out) == (2, "")
    assert err.strip().endswith(why)
    assert (ends / "start.csv").read_bytes() == kept


def test_after_ctrl_c_it_says_what_there_is(planned, tmp_path, monkeypatch, brief):
    def stopped(*arguments, **settings):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(planning, "plan", stopped)
        code, _, err = planned()
    assert (code, err.splitlines()[-1]) == (130, "fiberloom: interrupted; nothing was written")
    assert not (tmp_path / "t.json").exists()
    monkeypatch.setattr(film, "write_film", stopped)
    code, _, err = planned("--animate", tmp_path / "film.gif")
    file = tmp_path / "t.json"
    said = f"fiberloom: interrupted; the trajectories are in {file}, the film is not made"
    assert (code, err.splitlines()[-1]) == (130, said)
    assert file.exists()


def test_a_film_that_fails_takes_nothing_from_the_plan(planned, tmp_path, monkeypatch):
    def full(path, shown, title, progress):
        raise InputError(f"{path}: cannot be written (No space left on device)")

    monkeypatch.setattr(film, "write_film", full)
    code, out, err = planned("--animate", tmp_path / "film.gif", "--json")
    report = json.loads(out)
    assert (code, report["film"], report["arrived"]) == (2, "not made", N)
    assert (tmp_path / "t.json").is_file()
    assert err.endswith("film.gif: cannot be written (No space left on device)\n")


def test_a_plan_that_is_not_verified_is_neither_written_nor_filmed(planned, tmp_path, monkeypatch):
    verify = planning.verify

    def slower(plane, plan, **rules):
        limits = planning.MotionLimits(speed_deg_s=1.0)
        return verify(plane, plan, **(rules | {"limits": limits}))

    monkeypatch.setattr(planning, "verify", slower)
    code, out, _ = planned("--animate", tmp_path / "film.gif", "--json")
    report = json.loads(out)
    assert (code, report["verified"], report["trajectories"]) == (1, False, "not written")
    assert list(tmp_path.iterdir()) == []


def test_the_settings_of_the_bound_are_those_of_the_plan(plane):
    slow = PlanSettings(speed_deg_s=5.85)
    start_deg, goal_deg = random_pair(plane, 0)
    ratio = planning.bound_s(plane, start_deg, goal_deg, settings=slow) / planning.bound_s(
        plane, start_deg, goal_deg
    )
    assert ratio == pytest.approx(2.0)
