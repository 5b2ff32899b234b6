"""`fiberloom calibrate gravity`: on the twin, from recorded images, and used by `observe`."""

import json

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.calibration.gravity.sag import ArmSag
from fiberloom.cli.app import app
from fiberloom.store import Store
from fiberloom.store.calibrations import STORE
from fiberloom.targets import write_targets
from fiberloom.targets.generate import random_targets

N = 19
TILT = ["--zenith", 60, "--rotator", 20, "--turn", 150, "--swing", 5]


def run(*words):
    return app([*map(str, words)], standalone_mode=False)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gravity")
    assert not run("calibrate", "gravity", "--positioners", N, "--errors", "all", "--out", folder)
    return folder


def test_the_twin_calibrates_its_sag(made):
    report = json.loads((made / "gravity.json").read_text())
    assert report["calibrated"] == report["positioners"] == N
    assert report["refused"] == {}
    assert report["images"] == 36
    assert 0.8 < report["at_1_g_um"] < 2.0
    assert report["formal_um"] < 0.7
    assert "assumed" in report["put_in"]["gravity"]
    assert "assumed" in report["put_in"]["bundle of fibres"]
    with Store.open(made / STORE, create=False) as store:
        left = [store.calibrated(one.id) for one in store.runs()]
    assert {"gravity": N} in [{k: v for k, v in rows.items() if k == "gravity"} for rows in left]


def test_recorded_images_give_the_same(made, tmp_path, capsys):
    words = ["--positioners", N, "--images", made / "images.ecsv", "--out", tmp_path]
    assert not run("calibrate", "gravity", *words, "--json")
    assert json.loads(capsys.readouterr().out)["calibrated"] == N
    plane = fl.FocalPlane.of("sdssv", n=N)
    here, there = (ArmSag.load(folder / "gravity.ecsv", plane) for folder in (tmp_path, made))
    np.testing.assert_allclose(here.sag_rad, there.sag_rad, atol=1e-9)


def test_an_observation_uses_it(made, tmp_path, capsys):
    plane = fl.FocalPlane.of("sdssv", n=N)
    write_targets(random_targets(plane, 3 * N, 5), tmp_path / "targets.csv")
    words = ["observe", tmp_path / "targets.csv", "--positioners", N, "--camera", "noise", "--moves", 3]
    words += ["--errors", "gravity,torque", "--require", "0%", *TILT]
    left_um = []
    for name, more in (("without", []), ("with", ["--gravity", made / "gravity.ecsv"])):
        out = tmp_path / name
        run(*words, "--out", out, "--json", *more)
        summary = json.loads((out / "summary.json").read_text())
        left_um.append(summary["budget"]["gravity_um"])
    assert summary["pointing"]["turn_deg"] == 150.0
    assert left_um[0] > 1.5
    assert left_um[1] < 0.5 * left_um[0]


def test_where_nothing_is_seen_it_says_so_and_fails(tmp_path, capsys):
    words = ["calibrate", "gravity", "--positioners", N, "--out", tmp_path]
    code = run(*words, "--errors", "none", "--configurations", 2)
    assert code == 1
    assert "refused 19: no turn by gravity is seen in these images" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["calibrate", "gravity", "--images", "nothing.ecsv"], "nothing.ecsv: no such file"),
        (["calibrate", "gravity", "--require", "all"], "--require all: give a share"),
        (["observe", "targets.csv", "--turn", 20], "--turn: goes with --zenith"),
        (["observe", "targets.csv", "--zenith", 100], "zenith distance 100 deg"),
        (["observe", "targets.csv", "--zenith", 80, "--fall", 20], "zenith distance 100 deg"),
        (["observe", "targets.csv", "--zenith", 30, "--gravity", "none.ecsv"], "calibrate gravity"),
    ],
)
def test_bad_input_is_one_line(words, said, tmp_path):
    with pytest.raises(fl.InputError, match=said):
        run(*words, "--positioners", 7, "--out", tmp_path)
