"""Files of sag and of tilted images: there and back, and bad ones in one line."""

import numpy as np
import pytest
from tilted import PLANE, Array

from fiberloom.calibration.gravity.estimate import estimate
from fiberloom.calibration.gravity.images import TiltImages, read_tilts
from fiberloom.calibration.gravity.sag import ArmSag
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.pointing import Pointing
from fiberloom.tables import read_table, write_columns

MARKS = {"version": "0", "seed": 0, "instrument": "sdssv", "config_hash": "cafe", "utc": "2026-01-01"}


@pytest.fixture(scope="module")
def images():
    return Array().images(configurations=3)


@pytest.fixture(scope="module")
def sag(images):
    return estimate(PLANE, images)


def test_sag_is_read_as_it_was_written(sag, tmp_path):
    sag.write(tmp_path / "gravity.ecsv", MARKS)
    again = ArmSag.load(tmp_path / "gravity.ecsv", PLANE)
    np.testing.assert_allclose(again.sag_rad, sag.sag_rad, rtol=1e-9)
    np.testing.assert_allclose(again.covariance_rad2, sag.covariance_rad2, rtol=1e-9)
    assert again.n_images.tolist() == sag.n_images.tolist()
    assert repr(again) == "ArmSag(37 of 37 positioners)"


def test_rows_follow_the_plane_and_what_is_missing_does_not_turn(sag, tmp_path):
    sag.write(tmp_path / "gravity.ecsv", MARKS)
    more = FocalPlane.of("sdssv", n=61)
    here = ArmSag.load(tmp_path / "gravity.ecsv", more)
    rows = more.index_of(PLANE.positioner_id)
    np.testing.assert_allclose(here.sag_rad[rows], sag.sag_rad, rtol=1e-9)
    assert here.ok.sum() == 37
    turned = here.turns_deg(more, np.tile([30.0, 90.0], (61, 1)), Pointing(60.0, 10.0))
    assert not turned[~here.ok].any()
    assert turned[here.ok].all()


def test_refused_positioners_are_kept_with_their_reasons(images, tmp_path):
    level = TiltImages(
        images.positioner_id, images.configuration, (Pointing(),) * 18, images.angles_deg, images.xy_mm
    )
    none = estimate(PLANE, level)
    none.write(tmp_path / "gravity.ecsv", MARKS)
    assert ArmSag.load(tmp_path / "gravity.ecsv", PLANE).reason.tolist() == none.reason.tolist()


def changed(path, name, value):
    """The file with another value in the second row of a column, and a sum that fits."""
    table = read_table(path)
    columns = {key: list(table.columns[key]) for key in table.columns}
    columns[name][1] = value
    write_columns(path, columns, table.head)


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("alpha_along_urad", 2e4, "positioner .*: turns by more than 0.01 rad"),
        ("beta_across_urad", float("nan"), "or by no number"),
        ("cov_beta_along_beta_along_urad2", -5.0, "its covariance is none"),
        ("cov_alpha_across_alpha_along_urad2", float("inf"), "its covariance is none"),
    ],
)
def test_nonsense_is_refused_with_its_place(sag, tmp_path, column, value, said):
    path = tmp_path / "gravity.ecsv"
    sag.write(path, MARKS)
    changed(path, column, value)
    with pytest.raises(InputError, match=f"gravity.ecsv.*{said}"):
        ArmSag.load(path, PLANE)


def test_files_that_are_none_are_refused(sag, images, tmp_path):
    path = tmp_path / "gravity.ecsv"
    with pytest.raises(InputError, match="make one with 'fiberloom calibrate gravity'"):
        ArmSag.load(path, PLANE)
    sag.write(path, MARKS)
    text = path.read_text()
    path.write_text(text.replace(" 36 ", " 35 ").replace("\n1 ", "\n2 ") + "\n")
    with pytest.raises(InputError, match=r"gravity\.ecsv"):
        ArmSag.load(path, PLANE)
    images.write(path, MARKS)
    with pytest.raises(InputError, match="alpha_along_urad"):
        ArmSag.load(path, PLANE)
    sag.write(path, MARKS)
    table = read_table(path)
    other = dict(table.head) | {"format": "fiberloom arms"}
    write_columns(path, {key: list(table.columns[key]) for key in table.columns}, other)
    with pytest.raises(InputError, match="not a file of sag"):
        ArmSag.load(path, PLANE)
    with pytest.raises(InputError, match="of none of the 37"):
        ArmSag(sag.positioner_id + 2000, sag.sag_rad, sag.covariance_rad2, sag.n_images, sag.reason).on(PLANE)
    with pytest.raises(InputError, match="appears twice"):
        ArmSag(sag.positioner_id * 0, sag.sag_rad, sag.covariance_rad2, sag.n_images, sag.reason)


# images


def test_images_are_read_as_they_were_written(images, tmp_path):
    xy = images.xy_mm.copy()
    xy[4, 7] = np.nan
    gap = TiltImages(images.positioner_id, images.configuration, images.pointing, images.angles_deg, xy)
    gap.write(tmp_path / "images.ecsv", MARKS)
    again = read_tilts(tmp_path / "images.ecsv")
    order = np.argsort(gap.positioner_id)
    np.testing.assert_allclose(again.xy_mm, xy[order], atol=1e-9)
    assert again.pointing == images.pointing
    assert again.configuration.tolist() == images.configuration.tolist()
    assert repr(again) == "TiltImages(18 images of 37 positioners in 3 configurations)"
    whole, part = estimate(PLANE, gap), estimate(PLANE, again)
    there = [part.positioner_id.tolist().index(p) for p in whole.positioner_id.tolist()]
    np.testing.assert_allclose(part.sag_rad[there], whole.sag_rad, atol=1e-9)


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("zenith_deg", 95.0, "zenith_deg"),
        ("rotator_deg", 11.0, "rotator_deg.*is not that of the image's other rows"),
        ("configuration", 9, "configuration.*other rows"),
        ("alpha_deg", 400.0, "has moved in configuration"),
        ("x_mm", 1e9, "x_mm.*cannot be one"),
        ("beta_deg", "north", "beta_deg"),
    ],
)
def test_bad_images_are_refused_with_their_place(images, tmp_path, column, value, said):
    path = tmp_path / "images.ecsv"
    images.write(path, MARKS)
    changed(path, column, value)
    with pytest.raises(InputError, match=f"images.ecsv.*{said}"):
        read_tilts(path)


def test_an_image_holds_each_positioner_once(images, tmp_path):
    path = tmp_path / "images.ecsv"
    images.write(path, MARKS)
    table = read_table(path)
    columns = {key: [*table.columns[key], table.columns[key][0]] for key in table.columns}
    write_columns(path, columns, table.head)
    with pytest.raises(InputError, match=r"images\.ecsv.*holds this positioner a second time"):
        read_tilts(path)


def test_a_pointing_below_the_horizon_is_refused(images, tmp_path):
    path = tmp_path / "images.ecsv"
    images.write(path, MARKS)
    table = read_table(path)
    columns = {key: list(table.columns[key]) for key in table.columns}
    columns["zenith_deg"] = [100.0] * len(columns["zenith_deg"])
    write_columns(path, columns, table.head)
    with pytest.raises(InputError, match=r"images\.ecsv: zenith distance 100 deg"):
        read_tilts(path)
