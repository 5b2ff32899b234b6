"""What an operator types wrong ends in one clear line and exit code 2."""

import subprocess
import sys

import pytest

GOOD = "target_id,x_mm,y_mm,priority,fibre\na,1,2,1,BOSS\n"


def run(*words, cwd):
    return subprocess.run(
        [sys.executable, "-m", "fiberloom.cli", *map(str, words)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def refused(result, *fragments):
    lines = result.stderr.strip().splitlines()
    assert result.returncode == 2, result.stderr
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("fiberloom: ")
    for fragment in fragments:
        assert fragment in lines[0]


def test_a_missing_target_file(tmp_path):
    refused(run("observe", "nowhere.csv", "--positioners", "7", cwd=tmp_path), "nowhere.csv")


def test_a_wrong_column_names_those_that_are_there(tmp_path):
    (tmp_path / "t.csv").write_text("target_id,x,y_mm\na,1,2\n")
    refused(run("observe", "t.csv", "--positioners", "7", cwd=tmp_path), "x_mm", "t.csv")


def test_a_number_that_is_none(tmp_path):
    (tmp_path / "t.csv").write_text("target_id,x_mm,y_mm\na,1,2\nb,east,2\n")
    refused(run("observe", "t.csv", "--positioners", "7", cwd=tmp_path), "t.csv")


def test_two_targets_for_one_positioner(tmp_path):
    (tmp_path / "t.csv").write_text("target_id,x_mm,y_mm,fibre,positioner_id\na,1,2,BOSS,1\nb,2,2,BOSS,1\n")
    refused(run("observe", "t.csv", "--positioners", "7", cwd=tmp_path), "positioner")


def test_an_unknown_instrument_lists_the_presets(tmp_path):
    (tmp_path / "t.csv").write_text(GOOD)
    refused(run("observe", "t.csv", "--instrument", "sloan", cwd=tmp_path), "sloan", "sdssv")


def test_a_layout_without_the_hole_of_a_positioner(tmp_path):
    layout = tmp_path / "layout"
    layout.mkdir()
    (layout / "positionerTable.csv").write_text(
        "holeID,positionerID,alphaArmLen,metX,metY,apX,apY,bossX,bossY,alphaOffset,betaOffset,dx,dy\n"
        "R0C1,1,7.4,14.3,0,14.96,0.37,14.96,-0.37,0,0,0,0\n"
    )
    (layout / "wokCoords.csv").write_text(
        "holeID,holeType,xWok,yWok,zWok,ix,iy,iz,jx,jy,jz,kx,ky,kz\nR0C2,Boss,0,0,0,0,-1,0,1,0,0,0,0,1\n"
    )
    (layout / "fiducialCoords.csv").write_text("id,xWok,yWok,zWok\n")
    (tmp_path / "t.csv").write_text(GOOD)
    refused(run("observe", "t.csv", "--layout", layout, cwd=tmp_path), "R0C1")


def test_an_out_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "t.csv").write_text(GOOD)
    (tmp_path / "taken").write_text("a file, not a folder")
    refused(run("observe", "t.csv", "--positioners", "7", "--out", "taken/x", cwd=tmp_path), "taken")


def test_a_word_too_many(tmp_path):
    refused(run("observe", "a.csv", "b.csv", cwd=tmp_path))


def test_trajectories_that_are_none(tmp_path):
    (tmp_path / "t.json").write_text('{"robots": ')
    refused(run("verify", "t.json", "--positioners", "7", cwd=tmp_path), "t.json")


@pytest.mark.parametrize("command", [[], ["observe"], ["calibrate"], ["calibrate", "transmission"]])
def test_every_level_has_help(command, tmp_path):
    result = run(*command, "--help", cwd=tmp_path)
    assert result.returncode == 0
    assert "Usage" in result.stdout


def test_a_twin_that_cannot_be_served(tmp_path):
    twin = ("twin", "--positioners", "3", "--stop-after", "0")
    refused(run(*twin, "--listen", "19228", cwd=tmp_path), "--listen 19228", "HOST:PORT")
    refused(run(*twin, "--faults", "lying=9", cwd=tmp_path), "--faults lying=9", "at most 3")
    refused(run(*twin, "--listen", "127.0.0.1:19399", "--speed", "0", cwd=tmp_path), "speed 0.0")


def test_an_array_that_is_calibrated_needs_bus_and_camera(tmp_path):
    sweep = ("calibrate", "transmission", "--positioners", "3")
    refused(run(*sweep, "--bus", "cannet://10.1.10.31", cwd=tmp_path), "--bus: name the camera too")
    refused(run(*sweep, "--camera", "alpaca://h/0", cwd=tmp_path), "--camera goes with --bus")
    refused(run(*sweep, "--exclude", "12", cwd=tmp_path), "--exclude goes with --bus")
    both = ("--bus", "cannet://10.1.10.31", "--camera", "alpaca://10.1.10.40:11111/0")
    refused(run(*sweep, *both, "--exclude", "x", cwd=tmp_path), "--exclude x")
