"""Every command for good input, on three to seven positioners: files, words, JSON, exit codes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fiberloom.cli import app as cli_app
from fiberloom.instruments import generate, load_instrument, write_layout
from fiberloom.metrology import write_image
from fiberloom.metrology.acquisition import CameraGeometry
from fiberloom.planning import read_plans, write_configuration
from fiberloom.targets import random_targets, write_targets
from fiberloom.twin.camera.imaging import CameraModel, Detector, ImagingCamera, Light, Optics, Psf, StillScene

N, SEED = 7, 4
PLANE = ("--positioners", N, "--seed", SEED)


def folded(plane):
    return np.broadcast_to(plane.instrument.positioner.park_deg, (len(plane), 2))


@pytest.fixture(scope="module")
def plane():
    return generate(load_instrument("sdssv"), SEED, n_positioners=N)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Targets near the centre; commands leave their files here for those that follow."""
    made = tmp_path_factory.mktemp("commands")
    whole = random_targets(generate(load_instrument("sdssv"), SEED), 3000, SEED)
    write_targets(whole.select(np.flatnonzero(np.hypot(whole.x_mm, whole.y_mm) < 60.0)), made / "targets.csv")
    return made


@pytest.fixture
def maps(fl, folder):
    """Transmission maps of few points, measured once."""
    out = folder / "transmission"
    if not (out / "transmission.npz").exists():
        code, text, err = fl("calibrate", "transmission", *PLANE, "--points", 60, "--out", out)
        assert code == 0, err
        assert "calibrated" in text
        assert "calibrating transmissions" in err  # no terminal: plain lines
    return out / "transmission.npz"


def test_transmission_leaves_maps_report_and_figure(fl, maps, tmp_path):
    report = json.loads((maps.parent / "transmission.json").read_text())
    assert report["calibrated"] == N
    assert (maps.parent / "transmission.png").stat().st_size > 10_000
    code, out, err = fl(
        "calibrate", "transmission", "--positioners", 1, "--points", 8, "--json", "--out", tmp_path
    )
    told = json.loads(out)
    assert (code, told["positioners"], err) == (1 if told["refused"] else 0, 1, "")


def test_assign_plan_verify(fl, folder, plane, tmp_path):
    goal, way = tmp_path / "deep" / "goal.csv", tmp_path / "way.json"
    code, out, _ = fl("assign", folder / "targets.csv", *PLANE, "--out", goal, "--json")
    report = json.loads(out)
    assert (code, report["positioners"]) == (0, N)
    assert 0 < report["assigned"] <= N
    assert sum(report["not_assigned"].values()) == report["targets"] - report["assigned"]
    start = tmp_path / "start.csv"
    write_configuration(start, plane.positioner_id, folded(plane))
    code, out, _ = fl("plan", "--start", start, "--goal", goal, *PLANE, "--out", way)
    assert code == 0
    assert "motion s" in out
    assert len(read_plans(way, plane)) == 1
    code, out, _ = fl("verify", way, *PLANE, "--json")
    verdict = json.loads(out)
    assert (code, verdict["verified"], verdict["collisions"]) == (0, True, 0)
    assert verdict["min_clearance_mm"] > 0
    # faster than the instrument allows
    document = json.loads(way.read_text())
    for robot in document["robots"]:
        robot["time_s"] = [0.2 * t for t in robot["time_s"]]
    way.write_text(json.dumps(document))
    code, out, _ = fl("verify", way, *PLANE, "--json")
    verdict = json.loads(out)
    assert (code, verdict["verified"]) == (1, False)
    assert verdict["violations"]


def test_a_goal_that_cannot_be_reached_exits_1(fl, plane, tmp_path):
    start, goal = tmp_path / "start.csv", tmp_path / "goal.csv"
    angles = np.array(folded(plane))
    write_configuration(start, plane.positioner_id, angles)
    crossed = angles.copy()
    apart = np.hypot(*(plane.centres_mm[1:] - plane.centres_mm[0]).T)
    for one, other in ((0, 1 + apart.argmin()), (1 + apart.argmin(), 0)):  # stretched out across each other
        along = plane.centres_mm[other] - plane.centres_mm[one]
        crossed[one] = np.rad2deg(np.arctan2(along[1], along[0])) % 360.0, 0.0
    write_configuration(goal, plane.positioner_id, crossed)
    code, out, err = fl(
        "plan", "--start", start, "--goal", goal, *PLANE, "--out", tmp_path / "w.json", "--json"
    )
    assert (code, err) == (1, "")
    report = json.loads(out)
    assert report["arrived"] < N
    assert report["not_arrived"]


@pytest.fixture
def observed(fl, folder, maps):
    """An observation with faults that learns, made once."""
    out = folder / "observed"
    if not (out / "summary.json").exists():
        words = ("--camera", "noise", "--moves", 2, "--faults", "dark=1", "--calibration", maps)
        learnt = ("--adapt", "--learnt", folder / "learnt.sqlite")
        code, text, err = fl("observe", folder / "targets.csv", *PLANE, *words, *learnt, "--out", out)
        assert code == 1  # one of seven is dark
        assert "flagged dark" in text
        assert "learnt: " in text
        assert f"results in {out}/" in text.replace("\n", "")
        assert "planning" in err
    return out


def test_observe_as_json(fl, folder, maps, observed, tmp_path):
    words = ("--camera", "noise", "--moves", 1, "--calibration", maps, "--json", "--out", tmp_path)
    code, out, err = fl("observe", folder / "targets.csv", *PLANE, *words)
    summary = json.loads(out)
    assert err == ""
    assert len(summary["moves"]) == 1
    assert code == (0 if summary["n_within_requirement"] == summary["n_assigned"] else 1)
    assert summary["seed"] == json.loads((observed / "summary.json").read_text())["seed"] == SEED


def test_what_was_learnt_is_shown_and_undone(fl, folder, observed):
    learnt = folder / "learnt.sqlite"
    code, out, _ = fl("calibrate", "history", learnt, "--json")
    (first,) = json.loads(out)
    assert (code, first["generation"], first["kind"]) == (0, 1, "observe")
    assert "generation" in fl("calibrate", "history", learnt)[1]
    code, out, _ = fl("calibrate", "undo", learnt, "--to", 0, "--json")
    assert (code, json.loads(out)["generation"]) == (0, 2)
    code, _, err = fl("calibrate", "undo", learnt, "--to", 99)
    assert (code, err.count("\n")) == (2, 1)
    someone = json.loads(fl("calibrate", "history", learnt, "--json")[1])[0]["positioners"]
    assert 0 < someone < N


def test_runs_and_health_read_the_record(fl, observed, tmp_path):
    (row,) = json.loads(fl("runs", observed, "--json")[1])
    assert (row["status"], row["instrument"], row["seed"]) == ("finished", "sdssv", SEED)
    assert "finished" in fl("runs", observed / "store.sqlite")[1]
    code, out, _ = fl("health", observed, *PLANE, "--json")
    report = json.loads(out)
    assert code == (1 if report["findings"] else 0)
    assert sum(report["states"].values()) == N
    assert f"{report['moves']} moves in 1 runs" in fl("health", observed, *PLANE)[1]
    code, _, err = fl("health", observed, "--positioners", 3)
    assert code == 2
    assert "no run of this focal plane" in err
    assert "no store below" in fl("runs", tmp_path)[2]


def test_focal_plane_measures_then_fits_the_record_again(fl, maps, tmp_path):
    words = ("calibrate", "focal-plane", *PLANE, "--configurations", 5, "--calibration", maps)
    code, out, _ = fl(*words, "--out", tmp_path / "a")
    report = json.loads((tmp_path / "a" / "focal_plane.json").read_text())
    assert code == (1 if report["refused"] else 0)
    assert "fitted" in out
    assert (tmp_path / "a" / "arms.ecsv").is_file()
    again = (*words, "--measured", tmp_path / "a" / "store.sqlite", "--json", "--out", tmp_path / "b")
    _, out, err = fl(*again)
    assert err == ""
    assert json.loads(out)["calibrated"] == report["calibrated"]


@pytest.mark.parametrize(("require", "expected"), [("95%", 1), ("80%", 0)])
def test_a_focal_plane_is_calibrated_by_the_required_share(fl, maps, tmp_path, require, expected):
    """One of seven is dead and keeps the arms of the layout."""
    words = ("calibrate", "focal-plane", *PLANE, "--configurations", 6, "--calibration", maps)
    code, _, _ = fl(*words, "--faults", "dead=1", "--require", require, "--out", tmp_path)
    report = json.loads((tmp_path / "focal_plane.json").read_text())
    assert (report["calibrated"], len(report["refused"])) == (6, 1)
    assert code == expected


def test_instruments(fl):
    rows = json.loads(fl("instruments", "--json")[1])
    assert {row["name"] for row in rows} >= {"sdssv", "desi", "pfs"}
    assert {row["name"] for row in rows if row["twin_drives_it"] == "yes"} >= {"sdssv"}
    assert "sdssv" in fl("instruments")[1]
    assert json.loads(fl("instruments", "pfs", "--json")[1])["name"] == "pfs"


def test_the_file_of_an_instrument_is_printed_to_be_changed(fl, tmp_path):
    code, text, _ = fl("instruments", "desi", "--toml")
    assert code == 0
    assert "# [Q] phi ends in the positive direction" in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace('name = "desi"', 'name = "mine"'))
    assert json.loads(fl("instruments", path, "--json")[1])["name"] == "mine"
    assert fl("instruments", path, "--toml")[1] == path.read_text()
    path.write_text(text.replace("gear = 337.36", "gear = -1").replace('sees = "fibre"', "sees = 3"))
    code, _, complaint = fl("instruments", path, "--toml")
    assert code != 0
    assert "alpha.gear = -1: " in complaint
    assert "metrology.sees = 3: " in complaint
    assert "choose one of the two" in fl("instruments", "desi", "--toml", "--json")[2]
    assert "name a preset" in fl("instruments", "--toml")[2]


def test_lifetime_of_one_positioner(fl, tmp_path):
    words = ("--cycles", 1, "--positioners", 1, "--points", 8, "--targets", 2, "--out", tmp_path)
    code, out, err = fl("lifetime", *words)
    result = json.loads((tmp_path / "lifetime.json").read_text())
    assert code in (0, 1)
    assert "Blind moves" in out
    assert "1 cycles of 1 positioners" in err
    assert (tmp_path / "lifetime.png").is_file()
    code_again, out, _ = fl("lifetime", *words, "--json")
    assert code_again == code
    assert json.loads(out)["blind_rms_um"] == result["blind_rms_um"]


def test_reproduce_one_figure(fl, tmp_path):
    code, out, _ = fl("reproduce", 18, "--seeds", 1, "--out", tmp_path)
    assert code == 0
    assert "Figure 18" in out
    assert "report.html" in out
    assert (tmp_path / "report.html").is_file()


@pytest.fixture(scope="module")
def imaged(tmp_path_factory):
    """A folder with the image of a field, its layout and its configuration."""
    folder = tmp_path_factory.mktemp("imaged")
    plane = generate(load_instrument("sdssv"), 0, n_positioners=91)
    rng = np.random.default_rng(5)
    angle = rng.uniform(0, 2 * np.pi, 30)
    radius = np.concatenate([rng.uniform(20, 110, 12), np.full(18, 140.0)])
    xy = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    plane = replace(plane, fiducials=np.column_stack([xy, np.full(30, 2.0)]))
    write_layout(plane, folder / "layout")
    low, high = plane.limits_deg.T
    angles = rng.uniform(low, high, (len(plane), 2))
    model = CameraModel(
        Optics(CameraGeometry(1500, 1500, 0.2, flipped=True), 150.0),
        Psf("moffat", 3.0, beta=4.0),
        Detector(1.3, 8.0, 400.0, 60_000.0),
        Light(fibre_e=150_000.0, fiducial_e=150_000.0),
    )
    source = ImagingCamera(StillScene(plane.forward(*angles.T)), model, fiducials_mm=plane.fiducials, seed=6)
    write_image(source.expose(), folder / "image.fits")
    write_configuration(folder / "goal.csv", plane.positioner_id, angles)
    return folder


def match(fl, imaged, spots, out, *words):
    there = ("--layout", imaged / "layout", "--expected", imaged / "goal.csv", "--scale", 0.2, "--flipped")
    return fl("match", spots, *there, "--rotation", 0, "--out", out, "--json", *words)


def test_from_an_image_to_positions(fl, imaged, tmp_path):
    spots = tmp_path / "spots.csv"
    code, out, _ = fl(
        "centroid", imaged / "image.fits", "--out", spots, "--plot", tmp_path / "s.png", "--json"
    )
    assert (code, json.loads(out)["gain_e_adu"]) == (0, 1.3)
    assert json.loads(out)["spots"] >= 105
    assert (tmp_path / "s.png").stat().st_size > 10_000
    code, out, err = match(fl, imaged, spots, tmp_path / "p.csv")
    assert code == 0, err
    assert json.loads(out)["matched"] > 80
    # only where it is told to look, and nothing there
    (tmp_path / "corner.csv").write_text("x_px,y_px\n20,20\n")
    code, out, _ = fl(
        "centroid", imaged / "image.fits", "--expected", tmp_path / "corner.csv", "--extension", 0,
        "--out", tmp_path / "none.csv", "--json",
    )  # fmt: skip
    assert (code, json.loads(out)["spots"], json.loads(out)["not_found"]) == (1, 0, 1)
    code, _, err = fl("centroid", imaged / "image.fits", "--out", imaged / "layout" / "layout.toml" / "x")
    assert (code, "cannot write" in err) == (2, True)


def test_match_of_too_little_or_nothing_is_no_success(fl, imaged, tmp_path):
    spots, places = tmp_path / "spots.csv", tmp_path / "p.csv"
    assert fl("centroid", imaged / "image.fits", "--out", spots)[0] == 0
    assert match(fl, imaged, spots, places)[0] == 0
    rows = [row.split(",") for row in places.read_text().splitlines() if row[:1].isdigit()]
    mine = [",".join(row[6:8]) for row in rows if row[5] == "matched"]
    lines = spots.read_text().splitlines(keepends=True)
    few, none = tmp_path / "few.csv", tmp_path / "none.csv"
    few.write_text("".join(line for line in lines if not line.startswith(tuple(mine[10:]))))
    none.write_text("".join(line for line in lines if not line.startswith(tuple(mine))))
    code, out, _ = match(fl, imaged, few, places)
    report = json.loads(out)
    assert (code, report["matched"], report["required"]) == (1, 10, "95 % of 91")
    assert match(fl, imaged, few, places, "--require", "10%")[0] == 0
    assert match(fl, imaged, few, places, "--require", "12%")[0] == 1
    # nothing is never enough
    code, out, _ = match(fl, imaged, none, places, "--require", 0)
    assert (code, json.loads(out)["matched"]) == (1, 0)
    assert len(places.read_text().splitlines()) > 91


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [(KeyboardInterrupt(), 130, "interrupted"),
     (PermissionError(13, "Permission denied", "x.csv"), 2, "x.csv"),
     (OSError("no space"), 2, "no space")],
)  # fmt: skip
def test_what_is_raised_below_becomes_an_exit_code(fl, monkeypatch, error, code, said):
    def broken(**options):
        raise error

    monkeypatch.setattr(cli_app, "app_of", lambda words: broken)
    found, out, err = fl("runs")
    assert (found, out, err.count("\n")) == (code, "", 1)
    assert said in err


def test_the_version(fl):
    from fiberloom.version import __version__

    assert fl("--version") == (0, f"fiberloom {__version__}\n", "")
