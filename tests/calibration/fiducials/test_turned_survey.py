"""`calibrate focal-plane --rotator`: on the twin, with images; what cannot be turned is refused."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import fiberloom as fl
from fiberloom.calibration.fibres.guider import guided
from fiberloom.calibration.focal_plane.arms_file import load_arms
from fiberloom.cli.app import app
from fiberloom.errors import InputError
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.errors.sizes import TwinErrors

PLANE = fl.FocalPlane.of("sdssv", n=19)
TABLE_MM = PLANE.fiducials[:, :2]


HARDWARE = ("--bus", "cannet://127.0.0.1:1", "--camera", "alpaca://127.0.0.1:1/0")


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def off_um(fiducials_mm, seed):
    true_mm = TwinErrors.of(PLANE.instrument, "fiducial").fiducials_mm(PLANE, seed)
    every = np.ones(len(true_mm), dtype=bool)
    off = 1e3 * guided(fiducials_mm - true_mm, true_mm, every)
    return np.sqrt((off**2).sum(axis=1).mean())


@pytest.mark.slow
def test_fiducials_of_the_twin_are_found_and_kept_with_the_arms(tmp_path):
    done = run(
        *("calibrate", "focal-plane", "--positioners", 19, "--seed", 3, "--errors", "fiducial,air"),
        *("--camera", "image", "--configurations", 8, "--rotator", 360, "--out", tmp_path),
    )
    assert done.exit_code == 0, done.output
    told = json.loads((tmp_path / "focal_plane.json").read_text())["fiducials"]
    found = off_um(load_arms(tmp_path / "arms.ecsv", PLANE).fiducials[:, :2], 3)
    print(
        f"fiducials off by {off_um(TABLE_MM, 3):.2f} um, found to {found:.2f}, said {told['formal_um']:.2f}"
    )
    # 19 positioners in the middle tell little of what is the same after any turn
    assert found < 0.4 * off_um(TABLE_MM, 3)
    assert found < 1.7 * told["formal_um"]
    assert told["images"] == 8
    assert told["turned_deg"] == pytest.approx(315.0, abs=0.1)
    assert told["spot_um"] == pytest.approx(1.5, rel=0.4)  # the air that was put in


def test_a_camera_that_knows_the_fiducials_sees_where_fibres_are():
    twin = Twin(PLANE, draw_units(PLANE, 2), seed=2)
    errors = TwinErrors.of(PLANE.instrument, "fiducial=3")
    camera = NoiseCamera(twin, 0.01, 2, errors)
    true_mm = twin.fibre_xy("metrology")
    assert np.abs(camera.measure().xy_mm - true_mm).max() > 2e-3
    camera.know_fiducials(errors.fiducials_mm(PLANE, 2))
    assert np.abs(camera.measure().xy_mm - true_mm).max() < 1e-4


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--rotate", "tcs {deg}"), "needs --bus and --rotator"),
        (("--rotator", "90", *HARDWARE), "needs --rotate COMMAND"),
        (("--rotator", "90", *HARDWARE, "--rotate", "tcs"), "with {deg}"),
        (("--rotator", "90", "--camera", "noise"), "--camera image"),
        (("--rotator", "90"), "--camera image"),
    ],
)
def test_what_cannot_be_turned_is_refused(tmp_path, words, told):
    fixed = ("--positioners", 7, "--configurations", 4, "--out", tmp_path)
    refused = run("calibrate", "focal-plane", *fixed, *words).exception
    assert isinstance(refused, InputError)
    assert told in str(refused)
