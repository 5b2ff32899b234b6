"""Images of the twin: painted in bands as in one go, and noise that is that of photons and electronics."""

import numpy as np
import pytest
from scipy.special import ndtr

from fiberloom._core import metrology

GAIN, READ_E, BIAS = 1.3, 10.0, 500.0
DETECTOR = (GAIN, READ_E, BIAS, 60_000.0)
MOFFAT = 1
RNG = np.random.default_rng(3)


def spots(n, shape):
    at = RNG.uniform(-20.0, np.array(shape[::-1]) + 20.0, (n, 2))
    flux = RNG.uniform(1e4, 4e5, n)
    return np.column_stack([at, flux, np.full(n, 9.0), np.full(n, 0.5), np.full(n, 8.0), np.full(n, 3.0)])


def exposed(shape, level_e, seed, slope_x_e=0.0, threads=1):
    nothing = metrology.Lights(np.zeros((0, 7)), MOFFAT, 50.0, np.zeros(0, np.int64), np.zeros(0, np.float32))
    return metrology.expose_lights(nothing, shape, (level_e, slope_x_e, 0.0), DETECTOR, seed, threads)


@pytest.mark.parametrize("sky", [(100.0, 0.01, 0.0), (60.0, 0.0, 0.1), (30.0, 0.2, 0.0), (5.0, 0.0, 0.0)])
@pytest.mark.parametrize("threads", [1, 3])
def test_lights_painted_in_bands_are_those_painted_in_one_go(sky, threads):
    shape = (150, 333)
    table, pixels = spots(12, shape), RNG.integers(0, 150 * 333, 60)
    pixels = np.concatenate([pixels, pixels[:5], [0, 150 * 333 - 1]])
    electrons = RNG.exponential(3000.0, len(pixels)).astype(np.float32)
    whole = np.zeros(shape, np.float32)
    metrology.render_spots(whole, table, MOFFAT, 50.0)
    np.add.at(whole.reshape(-1), pixels, electrons)
    lights = metrology.Lights(table, MOFFAT, 50.0, pixels, electrons)
    in_bands = metrology.expose_lights(lights, shape, sky, DETECTOR, seed=7, threads=threads)
    np.testing.assert_array_equal(in_bands, metrology.expose(whole, sky, DETECTOR, 7))
    assert in_bands.max() > 5000


def shares(mean_e, top=1200):
    """Of each value in ADU: a normal number with the skewness of Poisson's distribution (Cornish-Fisher)."""
    variance = mean_e + READ_E**2
    third = mean_e / (6.0 * variance)
    edges_e = (np.arange(top + 1) - 0.5 - BIAS) * GAIN - mean_e
    # third z^2 + sqrt(variance) z - third = edge; far below the vertex of it there is nothing
    root = np.sqrt(np.maximum(variance + 4.0 * third * (third + edges_e), 0.0))
    return np.diff(ndtr((root - np.sqrt(variance)) / (2.0 * third)))


@pytest.mark.parametrize("mean_e", [100.0, 400.0])
def test_dark_pixels_have_every_value_as_often_as_they_should(mean_e):
    adu = exposed((3000, 2000), mean_e, seed=5)
    expected = shares(mean_e) * adu.size
    counts = np.bincount(adu.ravel(), minlength=1200)[:1200]
    often = expected > 100
    deviation = (counts - expected)[often] / np.sqrt(expected[often])
    assert abs(deviation).max() < 4.5
    assert np.mean(deviation**2) == pytest.approx(1.0, abs=0.35)
    assert adu.mean() == pytest.approx(BIAS + mean_e / GAIN, abs=5.0 * adu.std() / 2450.0)
    # rounding adds 1/12, and the square of the skewness a little
    third = mean_e / (6.0 * (mean_e + READ_E**2))
    variance = (mean_e + READ_E**2 + 2.0 * third**2) / GAIN**2 + 1.0 / 12.0
    assert adu.var() == pytest.approx(variance, rel=5.0 * np.sqrt(2.0 / adu.size))


def test_the_tails_of_the_noise_are_not_cut_off():
    """What lies so far out makes a camera see spots where there are none."""
    adu = np.concatenate([exposed((3000, 4000), 100.0, seed).ravel() for seed in (1, 2, 3)])
    share = shares(100.0)
    for low, high in ((0, 528), (528, 536), (616, 625), (625, 1200)):
        found, expected = np.count_nonzero((adu >= low) & (adu < high)), share[low:high].sum() * adu.size
        assert abs(found - expected) < 4.5 * np.sqrt(expected), (low, high)


def test_pixels_know_nothing_of_their_neighbours():
    adu = exposed((2048, 2048), 100.0, seed=11) - (BIAS + 100.0 / GAIN)
    for other in (adu[:, 1:], adu[1:], adu[1:, 1:], adu[:, 8:], adu[:, 32:], adu[:, 64:], adu[16:]):
        here = adu[: other.shape[0], : other.shape[1]]
        correlation = np.mean(here * other) / adu.var()
        assert abs(correlation) < 5.0 / np.sqrt(other.size)
    again = exposed((2048, 2048), 100.0, seed=12) - (BIAS + 100.0 / GAIN)
    assert abs(np.mean(again * adu)) < 5.0 * adu.var() / 2048.0


def test_a_sky_that_grows_along_a_row_has_the_mean_and_the_noise_of_each_place():
    adu = exposed((3000, 1000), 100.0, seed=2, slope_x_e=0.3).astype(np.float64)
    mean_e = 100.0 + 0.3 * np.arange(1000)
    np.testing.assert_allclose(adu.mean(axis=0), BIAS + mean_e / GAIN, atol=4.5 * 22.4 / GAIN / np.sqrt(3000))
    variance = (mean_e + READ_E**2) / GAIN**2 + 1.0 / 12.0
    np.testing.assert_allclose(adu.var(axis=0), variance, rtol=4.5 * np.sqrt(2.0 / 3000))


def test_an_image_that_is_kept_is_not_written_into_again():
    first = exposed((1500, 2000), 100.0, seed=1)
    kept = first.copy()
    exposed((1500, 2000), 100.0, seed=2)
    part = exposed((1500, 2000), 100.0, seed=3)[:10]
    wanted = part.copy()
    exposed((1500, 2000), 100.0, seed=4)
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(part, wanted)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shape": (0, 10)}, "at least 1 x 1"),
        ({"pixels": np.array([200])}, "outside of the image"),
        ({"pixels": np.array([-1])}, "outside of the image"),
        ({"electrons": np.zeros(2, np.float32)}, "a number for each pixel"),
        ({"kind": 3}, "0 Gaussian, 1 Moffat, 2 disc"),
    ],
)
def test_lights_that_are_none(change, message):
    asked = {
        "spots": np.zeros((0, 7)), "kind": MOFFAT, "radius_q": 50.0, "pixels": np.array([3]),
        "electrons": np.zeros(1, np.float32),
    }  # fmt: skip
    shape = change.pop("shape", (20, 10))
    with pytest.raises(ValueError, match=message):
        metrology.expose_lights(metrology.Lights(**(asked | change)), shape, (9.0, 0.0, 0.0), DETECTOR, 1)
