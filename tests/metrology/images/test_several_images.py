"""The mean of several images of fibres that do not move: its place, and how well it is known."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.metrology import Measurement, SeveralImages

N = 400


def image(rng, sigma_um, told_um=None, seen=None, fixed_um=0.0):
    """N fibres at the origin, in an image whose noise is `sigma_um` per coordinate."""
    xy = rng.normal(0.0, sigma_um * 1e-3, (N, 2))
    seen = np.ones(N, dtype=bool) if seen is None else seen
    xy[~seen] = np.nan
    noise = None if told_um is None else np.broadcast_to((told_um * 1e-3) ** 2 * np.eye(2), (N, 2, 2))
    wide = None if noise is None else noise + (fixed_um * 1e-3) ** 2 * np.eye(2)
    return Measurement(*xy.T, seen, 7.0, wide, None, None, noise)


def several(n, sigma_um, seed=0, **kinds):
    rng = np.random.default_rng(seed)
    return SeveralImages([image(rng, sigma_um, **kinds) for _ in range(n)])


@pytest.mark.parametrize("n", [2, 3, 4, 8])
def test_the_mean_is_as_good_as_it_says(n):
    mean = several(n, 2.0).mean()
    rms_um = 1e3 * np.sqrt((mean.xy_mm**2).mean())
    said_um = 1e3 * np.sqrt(mean.noise_mm2[:, 0, 0].mean())
    assert rms_um == pytest.approx(2.0 / np.sqrt(n), rel=0.1)  # 800 numbers: 2.5 %
    assert said_um == pytest.approx(2.0 / np.sqrt(n), rel=0.1)


@pytest.mark.parametrize("told_um", [0.2, 2.0, 20.0])
def test_what_the_camera_tells_of_its_noise_is_not_believed(told_um):
    mean = several(4, 2.0, told_um=told_um, fixed_um=5.0).mean()
    assert 1e3 * np.sqrt(mean.noise_mm2[:, 0, 0].mean()) == pytest.approx(1.0, rel=0.1)
    # what is the same in every image is no smaller in the mean
    assert 1e3 * np.sqrt(mean.covariance_mm2[:, 0, 0].mean()) == pytest.approx(np.hypot(5.0, 1.0), rel=0.05)


def test_noise_of_one_image_is_found():
    assert several(2, 2.0).noise_um() == pytest.approx(2.0 * np.sqrt(2.0), rel=0.1)
    assert np.isnan(several(1, 2.0).noise_um())


def test_fibres_that_air_moves_in_each_image_otherwise_are_seen():
    """Three images of a region that the air shifts by 0, 12 and -12 um, noise 1 um: no light is another."""
    taken = several(3, 1.0)
    shifted = [
        dataclasses.replace(image, x_mm=image.x_mm + np.where(np.arange(N) < 20, shift_mm, 0.0))
        for image, shift_mm in zip(taken.images, (0.0, 0.012, -0.012), strict=True)
    ]
    mean = SeveralImages(shifted).mean()
    assert mean.seen.all()
    assert 1e3 * np.abs(mean.xy_mm[:20]).max() < 3.0


def test_two_other_lights_of_three_are_no_place():
    taken = several(3, 1.0)
    astray = [
        dataclasses.replace(image, x_mm=image.x_mm + np.where(np.arange(N) < 5, shift_mm, 0.0))
        for image, shift_mm in zip(taken.images, (0.0, 3.0, -3.0), strict=True)
    ]
    assert not SeveralImages(astray).mean().seen[:5].any()


def test_light_of_something_else_in_one_image_is_left_out():
    taken = several(4, 1.0)
    stray = dataclasses.replace(
        taken.images[2], x_mm=taken.images[2].x_mm + np.where(np.arange(N) < 5, 3.0, 0.0)
    )
    mean = SeveralImages([*taken.images[:2], stray, taken.images[3]]).mean()
    assert 1e3 * np.hypot(*mean.xy_mm[:5].T).max() < 3.0
    assert mean.noise_mm2[0, 0, 0] == pytest.approx(mean.noise_mm2[9, 0, 0] * 4 / 3)


def test_a_fibre_that_most_images_do_not_show_is_not_seen():
    rng = np.random.default_rng(1)
    dark, blinks = np.ones(N, dtype=bool), np.ones(N, dtype=bool)
    dark[0], blinks[:2] = False, False
    mean = SeveralImages([image(rng, 1.0, seen=s) for s in (dark, blinks, dark)]).mean()
    assert not mean.seen[0]
    assert np.isnan(mean.xy_mm[0]).all()
    assert mean.seen[1:].all()


def test_all_dark_is_dark():
    nothing = np.zeros(N, dtype=bool)
    mean = several(3, 1.0, seen=nothing, told_um=1.0).mean()
    assert not mean.seen.any()
    assert mean.noise_mm2 is None
    assert np.isnan(several(3, 1.0, seen=nothing).noise_um())


def test_one_image_is_left_as_it_is():
    taken = several(1, 1.0, told_um=0.5)
    assert taken.mean() is taken.images[0]


@given(n=st.integers(2, 5), shift=st.floats(-300.0, 300.0), seed=st.integers(0, 99))
def test_the_mean_moves_with_the_images(n, shift, seed):
    taken = several(n, 1.0, seed)
    moved = [dataclasses.replace(i, x_mm=i.x_mm + shift) for i in taken.images]
    one, other = taken.mean(), SeveralImages(moved).mean()
    np.testing.assert_allclose(other.xy_mm, one.xy_mm + np.array([shift, 0.0]), atol=1e-9)
    np.testing.assert_allclose(other.noise_mm2, one.noise_mm2, rtol=1e-6)
