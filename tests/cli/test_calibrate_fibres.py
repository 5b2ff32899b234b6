"""`fiberloom calibrate fibres`: on the twin, from recorded exposures, and used by `observe`."""

import json
from dataclasses import replace

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.calibration.fibres.exposures_file import read_exposures, write_exposures
from fiberloom.calibration.fibres.offsets import FibreOffsets
from fiberloom.cli.app import app
from fiberloom.store import Store
from fiberloom.store.calibrations import STORE
from fiberloom.targets import write_targets
from fiberloom.targets.generate import random_targets

N = 19
ERRORS = "fibre,fiducial"


def run(*words):
    return app([*map(str, words)], standalone_mode=False)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fibres")
    words = [
        "calibrate",
        "fibres",
        "--positioners",
        N,
        "--fibre",
        "BOSS",
        "--moves",
        3,
        "--fields",
        5,
        "--out",
        folder,
    ]
    run(*words, "--errors", ERRORS)
    return folder


def test_the_twin_calibrates_its_fibres(made):
    report = json.loads((made / "fibres.json").read_text())
    first, *_, together = report["fields"]
    assert first["guided_rms_um"] > 7.0
    assert together["guided_rms_um"] < 1.3
    # the shift of the whole field is the guider's: no calibration on stars can know it
    assert first["n_guided_within"] < 8
    assert together["n_guided_within"] == together["stars"]
    # 19 fibres near the middle tell little of a frame: it is made no larger than they make likely
    assert 0.0 < report["camera_frame_um"] < 3.0
    assert report["calibrated"] >= N - 1
    assert "seeing" in report["put_in"]


def test_it_leaves_a_row_of_each_positioner(made):
    with Store.open(made / STORE, create=False) as store:
        left = [store.calibrated(run.id) for run in store.runs()]
    (found,) = [rows["fibres"] for rows in left if "fibres" in rows]
    assert found == json.loads((made / "fibres.json").read_text())["calibrated"]


def test_recorded_exposures_give_the_same(made, tmp_path, capsys):
    files = sorted(made.glob("exposures-*.ecsv"))
    assert len(files) == 5
    names = [word for file in files for word in ("--exposures", file)]
    run("calibrate", "fibres", "--positioners", N, *names, "--out", tmp_path, "--json")
    capsys.readouterr()
    here, there = (FibreOffsets.load(folder / "fibres.ecsv") for folder in (tmp_path, made))
    assert here.offset_mm == pytest.approx(there.offset_mm, abs=1e-6)
    assert read_exposures(files[0]).n_exposures == 13


@pytest.mark.parametrize(("require", "code"), [("100%", 1), ("50%", 0)])
def test_the_exit_code_is_that_of_the_required_share(made, tmp_path, require, code):
    """A fibre that is dark in all fields gets no offset."""
    names = []
    for file in sorted(made.glob("exposures-*.ecsv")):
        field = read_exposures(file)
        flux = field.flux.copy()
        flux[:, 3] = np.random.default_rng(1).normal(0.0, 1.0, len(flux))
        write_exposures(tmp_path / file.name, replace(field, flux=flux), {"version": "0"})
        names += ["--exposures", tmp_path / file.name]
    words = ["calibrate", "fibres", "--positioners", N, *names, "--require", require]
    assert (run(*words, "--out", tmp_path / "out", "--json") or 0) == code


def test_observe_uses_the_offsets(made, tmp_path):
    plane = fl.FocalPlane.of("sdssv", seed=0, n=N)
    targets = random_targets(plane, 4 * N, 77)
    write_targets(fl.TargetList(
        targets.target_id, targets.x_mm, targets.y_mm, targets.priority,
        np.full(4 * N, "BOSS"), targets.positioner_id,
    ), tmp_path / "targets.csv")  # fmt: skip
    words = ["observe", tmp_path / "targets.csv", "--positioners", N, "--camera", "noise", "--moves", 3]
    errors = []
    for name, more in (("without", []), ("with", ["--fibres", made / "fibres.ecsv"])):
        out = tmp_path / name
        run(*words, "--errors", ERRORS, "--require", "0%", "--out", out, "--json", *more)
        summary = json.loads((out / "summary.json").read_text())
        errors.append(summary["moves"][-1]["guided_rms_um"])
    assert summary["fibre_calibration"]["formal_um"] < 2.0
    assert summary["budget"]["fibre_um"] < 2.5
    assert errors[0] > 7.0
    assert errors[1] < 2.0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--require", "all"], "--require all: give a share"),
        (["--fibre", "blue"], "--fibre blue: known are"),
        (["--exposures", "nothing.ecsv"], "nothing.ecsv: no such file"),
        (["--bus", "cannet://127.0.0.1"], "--exposures FILE"),
    ],
)
def test_bad_input_is_one_line(words, said, tmp_path):
    with pytest.raises(fl.InputError, match=said):
        run("calibrate", "fibres", "--positioners", 7, *words, "--out", tmp_path)
