"""FITS of every kind that cameras write, and spots as tables."""

import numpy as np
import pytest
from astropy.io import fits

from fiberloom.errors import InputError
from fiberloom.metrology import (
    CameraImage,
    Flag,
    SpotSettings,
    find_spots,
    read_image,
    read_spots,
    write_image,
    write_spots,
)
from fiberloom.metrology.images import trouble


@pytest.fixture(scope="module")
def frame():
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:160, 0:200]
    light = sum(9000 * np.exp(-0.3 * ((x - a) ** 2 + (y - b) ** 2)) for a, b in [(50.2, 60.7), (140.5, 99.1)])
    return rng.poisson(light + 200).astype(np.uint16)


def found(image):
    return find_spots(image.pixels, fits_bytes=image.fits_bytes).spots


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_a_plain_file_is_read_in_place(frame, tmp_path, dtype):
    image = CameraImage(frame.astype(dtype), gain_e_adu=2.5, saturation_adu=60000.0, exposure_s=3.0)
    write_image(image, tmp_path / "a.fits")
    read = read_image(tmp_path / "a.fits")
    assert read.fits_bytes
    assert isinstance(read.pixels, np.memmap)
    np.testing.assert_array_equal(read.array(), image.pixels)
    assert (read.gain_e_adu, read.saturation_adu, read.exposure_s) == (2.5, 60000.0, 3.0)
    np.testing.assert_array_equal(found(read).xy_px, found(image).xy_px)


def kinds(frame):
    scaled = fits.ImageHDU(frame.astype(np.float32))
    scaled.scale("int16", bscale=0.5, bzero=16000)
    return {
        "compressed": fits.CompImageHDU(frame, compression_type="RICE_1"),
        "gzip tiles": fits.CompImageHDU(frame.astype(np.int32), compression_type="GZIP_2"),
        "int16": fits.ImageHDU(frame.astype(np.int16)),
        "int32": fits.ImageHDU(frame.astype(np.int32)),
        "float64": fits.ImageHDU(frame.astype(np.float64)),
        "scaled": scaled,
    }


@pytest.mark.parametrize("kind", ["compressed", "gzip tiles", "int16", "int32", "float64", "scaled"])
def test_every_kind_of_pixel_gives_the_same_spots(frame, tmp_path, kind):
    path = tmp_path / "a.fits"
    fits.HDUList([fits.PrimaryHDU(), kinds(frame)[kind]]).writeto(path)
    spots = found(read_image(path))
    np.testing.assert_allclose(spots.xy_px, found(CameraImage(frame)).xy_px, atol=2e-4)


def test_a_gzipped_file_and_a_named_extension(frame, tmp_path):
    path = tmp_path / "a.fits.gz"
    hdus = [fits.PrimaryHDU(), fits.ImageHDU(frame[:80], name="TOP"), fits.ImageHDU(frame, name="ALL")]
    fits.HDUList(hdus).writeto(path)
    assert read_image(path, extension="ALL").shape == frame.shape
    assert read_image(path).shape == (80, 200)
    with pytest.raises(InputError, match="1 TOP"):
        read_image(path, extension="OTHER")


def test_the_caller_knows_better_than_the_header(frame, tmp_path):
    write_image(CameraImage(frame, gain_e_adu=2.0), tmp_path / "a.fits")
    assert read_image(tmp_path / "a.fits", gain_e_adu=1.5).gain_e_adu == 1.5


def test_bad_files_are_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_image(tmp_path / "none.fits")
    (tmp_path / "text.fits").write_text("no picture")
    with pytest.raises(InputError, match=r"text\.fits: cannot be read"):
        read_image(tmp_path / "text.fits")
    fits.PrimaryHDU(np.zeros((2, 3, 4))).writeto(tmp_path / "cube.fits")
    with pytest.raises(InputError, match="no image of two dimensions"):
        read_image(tmp_path / "cube.fits")


def test_spots_survive_their_table(frame, tmp_path):
    spots = found(CameraImage(frame))
    write_spots(spots, tmp_path / "spots.csv", {"version": "x"})
    again = read_spots(tmp_path / "spots.csv")
    # five decimals
    np.testing.assert_allclose(again.xy_px, spots.xy_px, atol=6e-6)
    np.testing.assert_allclose(again.x_err_px, spots.x_err_px, atol=6e-6)
    np.testing.assert_array_equal(again.flags, spots.flags)


def test_a_table_of_another_make_is_read(tmp_path):
    (tmp_path / "s.csv").write_text("x_px,y_px\n1.5,2.5\n3,4\n")
    assert read_spots(tmp_path / "s.csv").xy_px.tolist() == [[1.5, 2.5], [3.0, 4.0]]
    (tmp_path / "t.csv").write_text("x,y\n1,2\n")
    with pytest.raises(InputError, match="x_px"):
        read_spots(tmp_path / "t.csv")


def test_a_file_cut_short_is_named_and_not_read_as_dark(frame, tmp_path):
    write_image(CameraImage(frame), tmp_path / "whole.fits")
    fits.CompImageHDU(frame).writeto(tmp_path / "packed.fits")
    for name in ("whole", "packed"):
        content = (tmp_path / f"{name}.fits").read_bytes()
        (tmp_path / f"half-{name}.fits").write_bytes(content[: len(content) // 2])
        with pytest.raises(InputError, match=rf"half-{name}\.fits: is cut short: \d+ of \d+ bytes"):
            read_image(tmp_path / f"half-{name}.fits")
    (tmp_path / "header.fits").write_bytes(content[:1500])
    with pytest.raises(InputError, match=r"header\.fits: cannot be read as FITS"):
        read_image(tmp_path / "header.fits")


def test_pixels_that_are_no_numbers_hide_no_spots(frame):
    whole = found(CameraImage(frame))
    holed = frame.astype(np.float32)
    holed[:, 100] = np.nan  # a dead column between the spots
    holed[10:20, 10:30] = np.nan
    holed[150, 50] = np.inf
    spots = found(CameraImage(holed))
    np.testing.assert_allclose(spots.xy_px, whole.xy_px, atol=1e-3)


def test_saturated_spots_are_kept_and_flagged_even_where_all_are(frame):
    whole = found(CameraImage(frame))
    top = int(frame.max()) // 2
    spots = find_spots(np.minimum(frame, top), SpotSettings(1.0, top)).spots
    assert spots.has(Flag.SATURATED).all()
    # the tops are gone, and there is nothing to measure the profile on
    np.testing.assert_allclose(spots.xy_px, whole.xy_px, atol=0.05)


@pytest.mark.parametrize(
    ("pixels", "words"),
    [
        (np.zeros((100, 100), np.uint16), "every pixel is 0: shutter closed"),
        (np.full((100, 100), 65535, np.uint16), "every pixel is 65535"),
        (np.full((100, 100), np.nan, np.float32), "no pixel is a number"),
        (np.where(np.arange(10000).reshape(100, 100) % 3, 65535, 9).astype(np.uint16), "67 % of the pixels"),
        (np.random.default_rng(0).poisson(100, (100, 100)).astype(np.uint16), "back-illumination"),
    ],
)
def test_an_image_without_spots_says_why(pixels, words):
    image = CameraImage(pixels, saturation_adu=65535.0)
    assert len(find_spots(pixels, SpotSettings(1.0, 65535.0)).spots) == 0
    assert words in trouble(image)
