"""Images of floats that no detector gives: every spot is finite, nothing crashes.

    python tests/fuzz/images.py [--seed 0] [--images 20000]

The number of an image is its seed. Four kinds in turn: any 4 bytes, any 8 bytes, and noise with spots in
which some pixels hold what no detector gives, as 4 and as 8 bytes.
"""

import argparse
import faulthandler
import sys

import numpy as np

from fiberloom.metrology import SpotSettings, find_expected, find_spots

WILD = [np.nan, np.inf, -np.inf, 1e38, -1e38, 3e38, 1e30, 1e11, -1e11, 5e4, 1e-40]
FAR = [0.0, -1.0, 40.0, 1e4, -1e9, 1e18, 1e300]


def picture(seed: int) -> np.ndarray:
    """8 to 89 pixels a side."""
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(8, 90, 2))
    if seed % 4 == 0:
        return rng.integers(0, 2**32, shape, dtype=np.uint32).view(np.float32)
    if seed % 4 == 1:
        return rng.integers(0, 2**63, shape, dtype=np.uint64).view(np.float64)
    image = rng.normal(100.0, 3.0, shape)
    y, x = np.mgrid[: shape[0], : shape[1]]
    for _ in range(rng.integers(0, 5)):
        where, width = rng.uniform(0, shape), rng.uniform(1.0, 9.0)
        image += 5000.0 * np.exp(-((x - where[1]) ** 2 + (y - where[0]) ** 2) / width)
    n = rng.integers(1, 40)
    image.flat[rng.integers(0, image.size, n)] = rng.choice(WILD, n)
    with np.errstate(over="ignore"):
        return image.astype(np.float32 if seed % 4 == 2 else np.float64)


def places(seed: int) -> np.ndarray:
    """(6, 2) px, some of them far from any image."""
    rng = np.random.default_rng([seed, 1])
    return np.vstack([rng.uniform(0, 90, (3, 2)), rng.choice(FAR, (3, 2))])


def look(seed: int) -> int:
    """Finds the spots of one image in every way; how many. AssertionError where one is not finite."""
    image = picture(seed)
    settings = SpotSettings(saturation_adu=np.inf if seed % 3 else 4000.0)
    free = find_spots(image, settings)
    guided = find_expected(image, places(seed), 6.0 if seed % 5 else 1e300, settings, profile=free.profile)
    hit = guided.spots.select(~guided.spots.has(32))
    results = [free.spots, hit, find_spots(image, settings, profile=free.profile).spots]
    if image.dtype == np.float32:
        stored = np.ascontiguousarray(image.byteswap().view(np.uint32))
        results.append(find_spots(stored, settings, fits_bytes=True).spots)
        np.testing.assert_array_equal(results[-1].xy_px, free.spots.xy_px)
    for spots in results:
        for name in ("x_px", "y_px", "covariance_px2", "flux_e", "flux_err_e", "background_adu", "chi2"):
            assert np.isfinite(getattr(spots, name)).all(), f"image {seed}: {name}"
        assert (spots.covariance_px2[:, [0, 1], [0, 1]] > 0).all(), f"image {seed}: covariance"
    return len(free.spots)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0, help="the first image")
    parser.add_argument("--images", type=int, default=20_000)
    asked = parser.parse_args()
    faulthandler.enable()  # a crash tells where
    spots = sum(look(seed) for seed in range(asked.seed, asked.seed + asked.images))
    print(f"{asked.images} images from {asked.seed} on: {spots} spots, all finite, no crash")
    return 0


if __name__ == "__main__":
    sys.exit(main())
