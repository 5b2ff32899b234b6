"""What the camera's side refuses: value, rule, and what to do."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits

from fiberloom.errors import InputError
from fiberloom.instruments import load_instrument
from fiberloom.metrology import one_image
from fiberloom.metrology.images import CameraImage, read_image, trouble, write_image
from fiberloom.metrology.matching import match_spots
from fiberloom.metrology.spots import SpotSettings, find_expected, find_spots, read_spots, write_spots
from fiberloom.twin.camera.imaging import Psf
from fiberloom.twin.camera.models import camera_model, misaligned, model_for, model_of

FIELD = np.random.default_rng(3).normal(100.0, 3.0, (40, 60)).astype(np.float32)


def with_spot():
    y, x = np.mgrid[:40, :60]
    return FIELD + (4000.0 * np.exp(-((x - 30.25) ** 2 + (y - 20.5) ** 2) / 4.0)).astype(np.float32)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: SpotSettings(gain_e_adu=0.0), "gain 0.0 e-/ADU: must be above 0"),
        (lambda: SpotSettings(gain_e_adu=np.nan), "gain nan e-/ADU: must be above 0"),
        (lambda: SpotSettings(threshold=2.9), "threshold 2.9: must be at least 3 times the noise"),
        (lambda: find_spots(FIELD[0]), "image: 1 dimensions, 2 are needed"),
        (lambda: find_spots(FIELD[:7]), "image: 60 x 7 px is too small, 8 x 8 needed"),
        (lambda: find_expected(FIELD, [[1.0, np.nan]], 3.0), r"an array \(n, 2\) of finite pixel"),
        (lambda: find_expected(FIELD, [1.0, 2.0], 3.0), r"an array \(n, 2\) of finite pixel"),
        (lambda: find_expected(FIELD, [[1.0, 2.0]], 0.0), "search radius 0.0 px: must be above 0"),
        (lambda: match_spots(np.zeros((3, 3)), np.zeros((2, 2)), np.zeros((2, 2)), 1.0), r"spots \(n, 2\)"),
        (lambda: match_spots(np.zeros((3, 2)), np.zeros((1, 2)), np.zeros((2, 2)), 1.0), r"centres \(N, 2\)"),
        (lambda: Psf(fwhm_px=0.0), "psf: fwhm_px 0.0 must be above 0"),
        (
            lambda: camera_model("hubble"),
            "camera 'hubble': known are workspace, close-up, desi, lamost, pfs, sdssv",
        ),
    ],
)
def test_what_cannot_be_is_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()


def asking(**camera):
    sdssv = load_instrument("sdssv")
    return sdssv.model_copy(update={"twin": {**sdssv.twin, "camera": camera}})


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        ({"colour": 1}, "sdssv: twin.camera.colour: no such key; known are average, optics, psf"),
        ({"psf": {"width": 1}}, "twin.camera.psf.width: no such key; known are kind, fwhm_px"),
        ({"psf": {"kind": 3}}, "twin.camera.psf.kind = 3: must be a name"),
        ({"psf": {"fwhm_px": "wide"}}, "twin.camera.psf.fwhm_px = 'wide': must be a number"),
        ({"psf": {"fwhm_px": True}}, "twin.camera.psf.fwhm_px = True: must be a number"),
        ({"optics": {"field_radius_mm": 3.0}}, r"optics.field_radius_mm: belongs into \[camera\]"),
        ({"optics": {"distortion_mm": {"x": 1.0}}}, "distortion_mm.x: terms are numbered 0 to"),
        ({"optics": {"distortion_mm": {"999": 1.0}}}, "distortion_mm.999: terms are numbered 0 to"),
    ],
)
def test_a_camera_in_a_file_is_refused_by_its_key(camera, words):
    with pytest.raises(InputError, match=words):
        model_of(asking(**camera))


def test_a_camera_in_a_file_is_as_written():
    psf = {"kind": "moffat", "beta": 2.5}
    model = model_of(asking(psf=psf, average=4, optics={"distortion_mm": {"9": 0.2}}))
    assert (model.psf.kind, model.psf.beta, model.average) == ("moffat", 2.5, 4)
    assert model.optics.distortion_mm == {9: 0.2}


def test_a_plane_without_a_camera_is_seen_whole(patch):
    bare = replace(patch, instrument=patch.instrument.model_copy(update={"camera": None}))
    model = model_for(bare)
    geometry = model.optics.geometry
    reach = np.hypot(*bare.centres_mm.T).max() + bare.body_reach_mm.max()
    assert 0.5 * geometry.width_px * geometry.scale_mm_px >= reach
    assert model_for(patch) == model_of(patch.instrument)
    turned = misaligned(model, 1).optics.geometry
    assert turned != geometry
    assert turned == misaligned(model, 1).optics.geometry
    assert abs(turned.scale_mm_px / geometry.scale_mm_px - 1.0) < 5e-3


def test_the_scale_and_the_fiducials_of_one_image(patch):
    sdssv = patch.instrument
    with pytest.raises(InputError, match=r"--scale 0\.0: must be above 0 mm per pixel"):
        one_image.camera_geometry(sdssv, (100, 80), 0.0)
    own = one_image.camera_geometry(sdssv, (100, 80))
    other = one_image.camera_geometry(sdssv, (100, 80), 0.25)
    assert (other.width_px, other.height_px, other.scale_mm_px) == (100, 80, 0.25)
    assert (other.flipped, other.rotation_deg) == (own.flipped, own.rotation_deg)
    bare = one_image.camera_geometry(sdssv.model_copy(update={"camera": None}), (100, 80), 0.25)
    assert not bare.flipped
    with pytest.raises(InputError, match="has 3 fiducials; at least 4 are needed"):
        one_image.require_fiducials(replace(patch, fiducials=patch.fiducials[:3]))


def test_a_source_is_an_image_or_a_table_and_never_empty(tmp_path):
    path = tmp_path / "a.fits"
    write_image(CameraImage(with_spot(), gain_e_adu=2.0, saturation_adu=6e4, exposure_s=1.5), path)
    spots, width, height = one_image.read_source(path)
    assert (width, height, len(spots)) == (60, 40, 1)
    np.testing.assert_allclose(spots.xy_px, [[30.25, 20.5]], atol=0.02)
    header = fits.getheader(path)
    assert (header["GAIN"], header["SATURATE"], header["EXPTIME"]) == (2.0, 6e4, 1.5)
    write_spots(spots, tmp_path / "s.csv", {"key": "value"})
    assert (tmp_path / "s.csv").read_text().startswith("# key: value\nx_px,y_px,")
    again, width, height = one_image.read_source(tmp_path / "s.csv")
    np.testing.assert_allclose(again.xy_px, spots.xy_px, atol=1e-5)
    assert (width, height) == (31, 21)
    with pytest.raises(InputError, match="no such file"):
        one_image.read_source(tmp_path / "none.csv")
    (tmp_path / "e.csv").write_text("x_px,y_px,flags\n1,2,32\n")
    with pytest.raises(InputError, match=r"e\.csv: no spots"):
        one_image.read_source(tmp_path / "e.csv")


def test_a_table_with_two_columns_has_usual_errors(tmp_path):
    (tmp_path / "s.csv").write_text("x_px,y_px\n1,2\n3,4\n")
    spots = read_spots(tmp_path / "s.csv")
    np.testing.assert_allclose(spots.x_err_px, 0.01)
    np.testing.assert_array_equal(spots.flux_e, 1.0)
    assert not spots.flags.any()


def test_spots_of_an_image_are_reported_with_their_sharpness(tmp_path):
    image = CameraImage(with_spot(), gain_e_adu=2.0)
    table = tmp_path / "wanted.csv"
    table.write_text("x_px,y_px\n30,20\n10,30\n")
    free = one_image.spots_report(image, one_image.spots_of_image(image))
    assert (free["image_px"], free["spots"], free["gain_e_adu"]) == ([60, 40], 1, 2.0)
    # a Gaussian with exp(-r^2 / 4): FWHM 4 sqrt(ln 2) px
    assert free["fwhm_px"] == pytest.approx(4 * np.sqrt(np.log(2)), rel=0.05)
    assert "not_found" not in free
    wanted = one_image.spots_report(image, one_image.spots_of_image(image, expected=table))
    assert (wanted["spots"], wanted["not_found"]) == (1, 1)
    dark = CameraImage(FIELD)
    none = one_image.spots_report(dark, one_image.spots_of_image(dark))
    assert none["spots"] == 0
    assert none["note"] == "nothing exceeds the noise: is the back-illumination on?"
    assert "fwhm_px" not in none
    assert list(one_image.image_marks(image)) == ["version", "image", "utc", "gain_e_adu"]


@pytest.mark.parametrize(
    ("pixels", "ceiling", "words"),
    [
        (np.full((9, 9), np.nan), np.inf, "no pixel is a number"),
        (np.full((9, 9), 7.0), np.inf, "every pixel is 7: shutter closed"),
        (np.arange(100.0).reshape(10, 10), 50.0, "50 % of the pixels are saturated: is a light on?"),
        (np.arange(100.0).reshape(10, 10), 98.0, "2 pixels are saturated: shorten the exposure"),
        (np.arange(100, dtype=np.uint16).reshape(10, 10), 65535.0, "nothing exceeds the noise"),
    ],
)
def test_why_an_image_shows_no_spot(pixels, ceiling, words):
    assert words in trouble(CameraImage(pixels, saturation_adu=ceiling))


def hdu_list(path, *arrays):
    more = [fits.ImageHDU(a, name=f"E{k}") for k, a in enumerate(arrays[1:])]
    fits.HDUList([fits.PrimaryHDU(arrays[0]), *more]).writeto(path)
    return path


def test_the_extension_that_is_asked_for(tmp_path):
    path = hdu_list(tmp_path / "a.fits", None, FIELD, np.zeros((2, 3, 4), np.float32), FIELD + 1)
    np.testing.assert_array_equal(read_image(path).array(), FIELD)
    np.testing.assert_array_equal(read_image(path, extension="E2").array(), FIELD + 1)
    np.testing.assert_array_equal(read_image(path, extension=3).array(), FIELD + 1)
    for name in ("E9", 9):
        with pytest.raises(InputError, match=f"no extension {name}; there are 0 PRIMARY, 1 E0, 2 E1, 3 E2"):
            read_image(path, extension=name)
    with pytest.raises(InputError, match="extension E1 holds no image of two dimensions"):
        read_image(path, extension="E1")
    cube = hdu_list(tmp_path / "cube.fits", np.zeros((2, 3, 4), np.float32))
    with pytest.raises(InputError, match="no image of two dimensions in any extension"):
        read_image(cube)


def test_a_key_of_the_header_that_is_no_number_is_named(tmp_path):
    hdu = fits.PrimaryHDU(FIELD)
    hdu.header["EGAIN"] = "high"
    hdu.writeto(tmp_path / "a.fits")
    with pytest.raises(InputError, match="EGAIN = 'high' is not a number"):
        read_image(tmp_path / "a.fits")
    assert read_image(tmp_path / "a.fits", gain_e_adu=3.0).gain_e_adu == 3.0
    (tmp_path / "b.fits").write_text("no FITS")
    with pytest.raises(InputError, match=r"b\.fits: cannot be read as FITS: "):
        read_image(tmp_path / "b.fits")
