"""Layouts from folders: our own, and the calibration tables of SDSS-V."""

import csv

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.instruments import read_layout, write_layout

POSITIONERS = [
    "holeID",
    "positionerID",
    "alphaArmLen",
    "metX",
    "metY",
    "apX",
    "apY",
    "bossX",
    "bossY",
    "alphaOffset",
    "betaOffset",
    "dx",
    "dy",
]
HOLES = ["holeID", "holeType", "xWok", "yWok", *(a + c for a in "ijk" for c in "xyz")]
FIDUCIALS = ["xWok", "yWok"]
CAMERAS = ["xWok", "yWok", "ix", "iy", "jx", "jy"]
UNIT = {"alphaArmLen": 7.41, "metX": 14.3, "metY": 0.01, "apX": 14.9, "apY": 0.37, "bossX": 14.95,
        "bossY": -0.38, "alphaOffset": 1.5, "betaOffset": -0.5, "dx": 0.2, "dy": -0.1}  # fmt: skip


def frame(angle_deg, k=(0, 0, 1)):
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    values = [c, s, 0, -s, c, 0, *k]
    return dict(zip(HOLES[4:], values, strict=True))


class Folder:
    """A small SDSS-V folder that a test can spoil before it is read."""

    def __init__(self, path):
        self.path = path
        self.positioners = [
            {"holeID": "A", "positionerID": 11, **UNIT},
            {"holeID": "B", "positionerID": 7, **UNIT, "dx": 0.0, "dy": 0.0},
        ]
        self.holes = [
            {"holeID": "A", "holeType": "ApogeeBoss", "xWok": 100.0, "yWok": 50.0, **frame(30.0)},
            {"holeID": "B", "holeType": "Boss", "xWok": 122.4, "yWok": 50.0, **frame(-90.0)},
            {"holeID": "F", "holeType": "Fiducial", "xWok": 200.0, "yWok": 50.0, **frame(-90.0)},
        ]
        self.fiducials = [{"xWok": 10.0, "yWok": 20.0}]
        self.cameras = None

    def read(self, instrument):
        self.write("positionerTable.csv", POSITIONERS, self.positioners)
        self.write("wokCoords.csv", HOLES, self.holes)
        self.write("fiducialCoords.csv", FIDUCIALS, self.fiducials)
        if self.cameras is not None:
            self.write("gfaCoords.csv", CAMERAS, self.cameras)
        return read_layout(self.path, instrument)

    def write(self, name, columns, rows):
        with (self.path / name).open("w", newline="") as file:
            writer = csv.DictWriter(file, columns, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(rows)


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path)


def test_offsets_and_frames(folder, sdssv):
    plane = folder.read(sdssv)
    np.testing.assert_array_equal(plane.positioner_id, [11, 7])
    np.testing.assert_array_equal(plane.hole, ["A", "B"])
    # by complex numbers: the base shifts in the frame of the hole, alpha counts from its i axis
    i = np.exp(1j * np.deg2rad(30.0))
    centre = 100.0 + 50.0j + (0.2 - 0.1j) * i
    alpha, beta = 40.0, 70.0
    turn = i * np.exp(1j * np.deg2rad(alpha + 1.5))
    boss = centre + 7.41 * turn + (14.95 - 0.38j) * turn * np.exp(1j * np.deg2rad(beta - 0.5))
    xy = plane.forward([alpha], [beta], "BOSS", index=[0])[0]
    np.testing.assert_allclose(xy, [boss.real, boss.imag], atol=1e-12)
    np.testing.assert_array_equal(plane.carries("APOGEE"), [True, False])
    np.testing.assert_array_equal(plane.fiducials, [[10.0, 20.0, 3.0]])


def test_guide_cameras(folder, sdssv):
    assert len(folder.read(sdssv).guide_cameras) == 6
    nominal = folder.read(sdssv).guide_cameras[1]
    chip = {"xWok": 0.3, "yWok": 327.6, "ix": 1, "iy": 0.006, "jx": -0.006, "jy": 1}
    folder.cameras = [chip, {**chip, "yWok": 340.0, "ix": 1, "iy": 0, "jx": 0, "jy": 1}]
    near, moved = folder.read(sdssv).guide_cameras
    np.testing.assert_array_equal(near, nominal)
    y = 340.0 - (328.0 - 276.23)
    np.testing.assert_allclose(moved, [0.3 - 56.54, y, 0.3 + 56.54, y, 3.0], atol=1e-9)


def spoil_hole(key, value):
    return lambda f: f.holes[0].__setitem__(key, value)


def spoil_unit(key, value):
    return lambda f: f.positioners[1].__setitem__(key, value)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (spoil_unit("holeID", "Z"), ["positionerTable.csv, line 3: holeID = Z", "wokCoords.csv"]),
        (spoil_unit("holeID", "A"), ["positionerTable.csv, line 3: holeID = A", "line 2"]),
        (spoil_unit("holeID", "F"), ["line 3: holeID = F is the hole of a fiducial"]),
        (spoil_unit("positionerID", 11), ["line 3: positionerID = 11 was used before"]),
        (spoil_unit("positionerID", "x"), ["line 3: positionerID = 'x' is not a whole number"]),
        (spoil_unit("metX", "long"), ["line 3: metX = 'long' is not a number"]),
        (spoil_unit("metX", ""), ["line 3: metX = '' is not a number"]),
        (spoil_unit("dx", "nan"), ["line 3: dx = nan is not finite"]),
        (spoil_unit("alphaArmLen", -7.4), ["line 3: alphaArmLen = -7.4 must be positive"]),
        (spoil_hole("ix", 2.0), ["wokCoords.csv, line 2", "hole A are not three orthogonal"]),
        (lambda f: f.holes[0].update(frame(30, (0, 0, -1))), ["line 2", "left-handed"]),
        (lambda f: f.holes[0].update(ix=1, iy=0, jx=0, jy=0, jz=1, kx=0, ky=-1, kz=0),
         ["line 2", "only flat woks"]),
        (lambda f: f.holes.append(dict(f.holes[0])), ["line 5: holeID = A was used before"]),
        (lambda f: f.positioners.clear(), ["positionerTable.csv: no rows below the header"]),
        (lambda f: f.fiducials.append({"xWok": 1.0, "yWok": "?"}),
         ["fiducialCoords.csv, line 3: yWok = '?'"]),
    ],
)  # fmt: skip
def test_what_is_wrong_and_where(folder, sdssv, spoil, words):
    spoil(folder)
    with pytest.raises(InputError) as caught:
        folder.read(sdssv)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize("name", ["wokCoords.csv", "fiducialCoords.csv", "positionerTable.csv"])
def test_missing_or_empty_files(folder, sdssv, name):
    folder.read(sdssv)
    (folder.path / name).write_text("")
    with pytest.raises(InputError, match=f"{name}: the file is empty"):
        read_layout(folder.path, sdssv)
    (folder.path / name).unlink()
    with pytest.raises(InputError, match=r"positionerTable\.csv|no such file"):
        read_layout(folder.path, sdssv)


def test_missing_column(folder, sdssv):
    folder.read(sdssv)
    folder.write("positionerTable.csv", POSITIONERS[:-1], folder.positioners)
    with pytest.raises(InputError, match="no column dy; the columns are holeID, positionerID"):
        read_layout(folder.path, sdssv)


def test_no_such_folder(tmp_path, sdssv):
    with pytest.raises(InputError, match="no such directory"):
        read_layout(tmp_path / "none", sdssv)
    with pytest.raises(InputError, match=r"none of layout.toml .*, positionerTable.csv"):
        read_layout(tmp_path, sdssv)


def test_a_folder_of_another_instrument(folder, sdssv):
    points = {k: p for k, p in sdssv.positioner.points.items() if k != "APOGEE"}
    positioner = sdssv.positioner.model_copy(update={"points": points})
    other = sdssv.model_copy(update={"name": "other", "positioner": positioner})
    with pytest.raises(InputError, match="instrument 'other' has no point APOGEE"):
        folder.read(other)


def test_own_layout_there_and_back(tmp_path, patch, sdssv):
    plane = patch.with_offline(patch.positioner_id[:2], [123.25, 45.5])
    write_layout(plane, tmp_path / "mine")
    back = read_layout(tmp_path / "mine", sdssv)
    assert back.config_hash() == plane.config_hash()
    # deg in the file, rad in memory: one rounding each way
    np.testing.assert_allclose(back.arms, plane.arms, rtol=4e-16)
    np.testing.assert_array_equal(back.points["APOGEE"], plane.points["APOGEE"])
    np.testing.assert_array_equal(back.offline, plane.offline)


def test_own_layout_without_cameras(tmp_path, patch, sdssv):
    from dataclasses import replace

    plane = replace(patch, guide_cameras=np.empty((0, 5)), fiducials=np.empty((0, 3)))
    write_layout(plane, tmp_path)
    back = read_layout(tmp_path, sdssv)
    assert back.guide_cameras.shape == (0, 5)
    assert back.fiducials.shape == (0, 3)


def test_own_layout_of_another_version(tmp_path, patch, sdssv):
    write_layout(patch, tmp_path)
    (tmp_path / "layout.toml").write_text("format = 99")
    with pytest.raises(InputError, match="format = 99, this version reads format = 1"):
        read_layout(tmp_path, sdssv)
    (tmp_path / "layout.toml").write_text("format")
    with pytest.raises(InputError, match="not valid TOML"):
        read_layout(tmp_path, sdssv)
