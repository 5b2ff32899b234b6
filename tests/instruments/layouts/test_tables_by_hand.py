"""Tables of DESI, PFS and MEGARA made by hand: places that can be checked on paper, and complaints."""

import math

import numpy as np
import pytest
from tests.fuzz.valid_files import SMALL_PFS, desi_layout, megara_layout, pfs_layout, pfs_module

import fiberloom as fl
from fiberloom.drive.piezo import read_module_maps
from fiberloom.errors import InputError
from fiberloom.instruments import read_layout, write_layout

DESI, MEGARA = fl.Instrument.of("desi"), fl.Instrument.of("megara")
KINDS = {
    "desi": (desi_layout, "calib-20260101.csv", DESI),
    "pfs": (pfs_layout, "pfs_6_cobras_scalars.csv", SMALL_PFS),
    "megara": (megara_layout, "derived_megara_3_rps.csv", MEGARA),
}


def written(folder, kind):
    write, name, instrument = KINDS[kind]
    write(folder / name)
    return instrument


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_read_can_be_written_as_a_layout_of_our_own(tmp_path, kind):
    plane = read_layout(tmp_path, written(tmp_path, kind))
    write_layout(plane, tmp_path / "own")
    again = read_layout(tmp_path / "own", plane.instrument)
    assert again.config_hash() == plane.config_hash()


def test_a_petal_is_turned_and_shifted(tmp_path):
    plane = read_layout(tmp_path, written(tmp_path, "desi"))
    # of location 11 the later row; 1300 does not work
    assert plane.positioner_id.tolist() == [11, 12, 1300]
    assert plane.offline.tolist() == [False, False, True]
    assert plane.l_alpha_mm.tolist() == [3.01, 2.95, 3.0]
    # petal 0: gamma -1.885 rad, shift 0, -0.02; at 64 mm an arc of the surface is longer by 0.26 um only
    gamma = -1.885
    x, y = 60.5, 20.25
    s = math.hypot(x, y)
    r = s - 1e-9 * s**3
    turned = complex(x, y) * r / s * complex(math.cos(gamma), math.sin(gamma)) + complex(0.0, -0.02)
    np.testing.assert_allclose(plane.centres_mm[0], [turned.real, turned.imag], atol=1e-6)
    assert plane.alpha_off_rad[0] == pytest.approx(math.radians(10.0) + gamma, abs=1e-12)
    # theta to both sides of 0, phi up to 185; 3 deg of clearance, 3 of room where the last move comes from
    np.testing.assert_allclose(plane.stops_of()[0], [[-196.0, 196.0], [-6.0, 185.0]])
    np.testing.assert_allclose(plane.limits_of()[0], [[-193.0, 190.0], [0.0, 182.0]])
    # outlines widened by 5.5 deg: the widest corner of phi goes out over its long edge; a longer arm
    corner, edge = complex(3.269, 1.583), complex(-1.172 - 3.269, 1.037 - 1.583)
    turned = corner * complex(math.cos(math.radians(5.5)), math.sin(math.radians(5.5)))
    off = (turned - corner) * edge.conjugate() / abs(edge)
    assert 0.0 < off.real < abs(edge)
    phi = abs(off.imag)
    assert plane.handicaps.wider_mm[1] == pytest.approx(phi + 0.1, abs=1e-9)
    assert plane.handicaps.wider_mm[0] == pytest.approx(0.06, abs=1e-9)
    assert len(plane.fiducials) == 3


def test_cobras_by_module_and_place(tmp_path):
    plane = read_layout(tmp_path, written(tmp_path, "pfs"))
    assert plane.hole.tolist() == ["SC01P01", "SC01P02", "SC01P03", "SC02P01", "SC02P02", "SC02P03"]
    assert plane.offline.tolist() == [False] * 5 + [True]
    # half a module is the median: 29.5 px are 2.375 mm
    np.testing.assert_allclose(plane.l_alpha_mm[:3], 2.375 * np.array([29.0, 30.8, 29.5]) / 29.5)
    np.testing.assert_allclose(plane.stops_of()[0], [[0.0, 376.9], [-182.6, 1.8]])
    np.testing.assert_allclose(plane.limits_of()[0], [[0.0, 376.9], [-180.0, 0.0]])
    # the third one's homes lie on both sides of 0: 382 deg
    assert plane.stops_of()[2, 0, 1] == pytest.approx(382.0)
    assert plane.limits_of()[2, 1].tolist() == [-178.0, 0.0]
    np.testing.assert_allclose(plane.dots_mm[2], [-21.0, 3.5, 0.75])
    assert len(plane.fiducials) == 2


def test_a_fibre_of_megara_turns_backwards_with_the_steps(tmp_path):
    """theta_1 = 360 r1 / 194086.302 deg, and theta_3 = 360 |r2| / 30720 deg from the folded arm."""
    plane = read_layout(tmp_path, written(tmp_path, "megara"))
    theta_1, theta_3 = 360.0 * 40685 / 194086.302, 360.0 * 7680 / 30720
    xy = plane.forward(-theta_1, theta_3 - 180.0)[0]
    first = 0.01 - math.radians(theta_1)
    by_hand = complex(-0.019, 52.218) + 5.972 * complex(math.cos(first), math.sin(first))
    second = first + math.radians(theta_3) - math.pi
    by_hand += 5.936 * complex(math.cos(second), math.sin(second))
    np.testing.assert_allclose(xy, [by_hand.real, by_hand.imag], atol=1e-9)
    found = plane.inverse(xy, index=[0])
    assert (found.alpha_deg[0], found.beta_deg[0]) == (
        pytest.approx(-theta_1),
        pytest.approx(theta_3 - 180.0),
    )
    assert plane.offline.tolist() == [False, False, True]
    np.testing.assert_allclose(plane.limits_of()[0], [[-362.5, 2.5], [-182.5, 2.5]], atol=1e-4)


@pytest.mark.parametrize(
    ("kind", "name", "old", "new", "words"),
    [
        ("desi", "calib-20260101.csv", "4,12,", "7,12,", ["line 4: petal_id = 7 is not at place 0"]),
        (
            "desi",
            "calib-20260101.csv",
            "3.01,3.06",
            "-3.01,3.06",
            ["line 2: length_r1 = -3.01 must be above 0"],
        ),
        ("desi", "calib-20260101.csv", "60.5,", "nan,", ["line 2: offset_x = nan is not finite"]),
        ("desi", "calib-20260101.csv", "60.5,", "600.5,", ["line 2: offset_x = 600.5", "focal surface"]),
        ("desi", "calib-20260101.csv", "392.0,191.0,F", "6.0,191.0,F", ["physical_range_t = 6 deg leaves"]),
        (
            "desi",
            "calib-20260101.csv",
            "False,,0",
            "No,,0",
            ["line 2: device_classified_nonfunctional", "'no'"],
        ),
        ("desi", "petal-alignments.yaml", "gamma: -1.885", "gamma: west", ["line 7: neither"]),
        ("desi", "petal-alignments.yaml", "3:\n", "30:\n", ["petal 3: Tx is missing"]),
        ("desi", "petal-alignments.yaml", "alpha: 0.0", "alpha: 0.1", ["petal 0 is tilted"]),
        ("desi", "focal_surface_lookup.csv", "7,-0.0049", "5,-0.0049", ["line 10: R does not rise"]),
        ("desi", "fp-metrology.csv", "X_FP", "X_PTL", ["no column X_FP"]),
        (
            "pfs",
            "pfs_6_cobras_scalars.csv",
            "SC01,2",
            "SC01,1",
            ["line 3: module, positioner = SC01P01 appears"],
        ),
        ("pfs", "pfs_6_cobras_scalars.csv", "SC01,2", "SC09,2", ["line 3", "SC09P02 is in no module"]),
        ("pfs", "pfs_6_cobras_scalars.csv", "29.0,", "nan,", ["line 2: link1_px = nan is not finite"]),
        ("pfs", "black_dots_mm-2024-01-01.csv", "\n4,", "\n14,", ["no dot with spotId 4"]),
        (
            "pfs",
            "fiducial_positions_20240101.csv",
            "9.9",
            "north",
            ["line 3: y_mm = 'north' is not a number"],
        ),
        ("megara", "derived_megara_3_rps.csv", "\n2,", "\n1,", ["line 3: Id = 1 was used before, in line 2"]),
        ("megara", "derived_megara_3_rps.csv", "6.326819", "-1.0", ["line 2: theta_1max = -57.2958 deg"]),
        ("megara", "derived_megara_3_rps.csv", "5.972", "0", ["line 2: L01 = 0 must be above 0"]),
    ],
)
def test_a_complaint_says_what_and_where(tmp_path, kind, name, old, new, words):
    instrument = written(tmp_path, kind)
    text = (tmp_path / name).read_text()
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_layout(tmp_path, instrument)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / name))
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_folder_of_nothing_known(tmp_path):
    with pytest.raises(InputError, match=r"none of layout.toml \(a layout of fiberloom\), positionerTable"):
        read_layout(tmp_path, DESI)
    (tmp_path / "calib-20260101.csv").write_text("petal_id\n4\n")
    with pytest.raises(InputError, match="no column location"):
        read_layout(tmp_path, DESI)
    desi_layout(tmp_path / "calib-20260101.csv")
    (tmp_path / "petal-alignments.yaml").unlink()
    with pytest.raises(InputError, match=r"petal-alignments\.yaml: no such file"):
        read_layout(tmp_path, DESI)


def test_the_latest_calibrations_of_a_folder_count(tmp_path):
    instrument = written(tmp_path, "desi")
    text = (tmp_path / "calib-20260101.csv").read_text()
    (tmp_path / "calib-20250101.csv").write_text(text.replace("3.01", "3.02"))
    assert read_layout(tmp_path, instrument).l_alpha_mm[0] == 3.01
    (tmp_path / "calib-20270101.csv").write_text(text.replace("3.01", "3.03"))
    assert read_layout(tmp_path, instrument).l_alpha_mm[0] == 3.03


def test_maps_of_a_module(tmp_path):
    path = tmp_path / "module.xml"
    pfs_module(path)
    maps = read_module_maps(path)
    assert maps.step_deg.shape == (4, 2, 3)
    assert maps.bin_deg == pytest.approx(400.0 / 3.0)
    np.testing.assert_allclose(maps.step_deg[0, 0], [0.011, 0.012, 0.03])  # theta of the first cobra
    np.testing.assert_allclose(maps.step_deg[3, 1], [0.021, 0.022, 0.04])  # phi of the second one
    np.testing.assert_allclose(maps.pulse_us[:2], [[20.0, 20.0], [40.0, 40.0]])
    np.testing.assert_allclose(read_module_maps(path, "fast").pulse_us[0], [30.0, 30.0])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("3,200,0.011", "3,200,0.0", "cobra 1: SLOW_CALIBRATION_TABLE/Joint1_fwd_stepsizes, bin 0"),
        ("3,200,0.011", "4,200,0.011", "Joint1_fwd_stepsizes: the first number says how many"),
        ("133.3", "100.3", "SLOW_CALIBRATION_TABLE/Joint1_fwd: needs as many steps as bins"),
        ("<KINEMATICS>", "<KINETICS>", "not XML"),
        ("ARM_DATA_CONTAINER", "ARM_DATA_BOX", "no ARM_DATA_CONTAINER"),
        (">0.02<", "><", "cobra 1: no KINEMATICS/Link1_fwd_Duration_Slow"),
        (">0.02<", ">long<", "must be numbers"),
        (">0.02<", ">-1<", "must be one number above 0"),
        ("<ARM_DATA>", "<!DOCTYPE a [<!ENTITY b 'c'>]><ARM_DATA>", "declares entities"),
    ],
)
def test_what_is_wrong_with_a_module_s_file(tmp_path, old, new, words):
    path = tmp_path / "module.xml"
    pfs_module(path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new) if old.startswith("ARM") else text.replace(old, new, 1))
    with pytest.raises(InputError, match=f"{path.name}.*{words}"):
        read_module_maps(path)
