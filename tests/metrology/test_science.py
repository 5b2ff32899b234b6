"""The science fibre from the metrology fibre: exact, with the covariance that repeated images scatter by."""

import numpy as np

from fiberloom.instruments import METROLOGY
from fiberloom.metrology import science_positions


def arms(plane, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform([5.0, 20.0], [355.0, 160.0], (len(plane), 2))


def test_the_science_fibre_is_where_the_arm_holds_it(patch):
    angles = arms(patch)
    seen = patch.forward(*angles.T, METROLOGY)
    for fibre in patch.science_fibres:
        xy, _ = science_positions(patch, seen, np.zeros((len(patch), 2, 2)), fibre)
        has = patch.carries(fibre)
        np.testing.assert_allclose(xy[has], patch.forward(*angles.T, fibre)[has], atol=1e-9)
        assert np.isnan(xy[~has]).all()


def test_the_covariance_is_what_repeated_images_scatter_by(patch):
    angles, rng = arms(patch, 1), np.random.default_rng(2)
    at = patch.forward(*angles.T, METROLOGY)
    shape = np.array([[1.0, 0.4], [0.4, 0.5]]) * 1e-6
    covariance = np.tile(shape, (len(patch), 1, 1))
    draws = [
        science_positions(patch, at + rng.multivariate_normal([0, 0], shape, len(patch)), covariance, "BOSS")[
            0
        ]
        for _ in range(600)
    ]
    stated = science_positions(patch, at, covariance, "BOSS")[1]
    scatter = np.array([np.cov(np.array(draws)[:, i].T) for i in range(len(patch))])
    # 600 draws: 6 % on a variance, for 37 positioners each
    ratio = np.trace(scatter, axis1=1, axis2=2) / np.trace(stated, axis1=1, axis2=2)
    assert np.all((ratio > 0.75) & (ratio < 1.3))
    assert abs(ratio.mean() - 1) < 0.04
    # the lever: farther out than the metrology fibre, so a little more than what was seen
    assert np.trace(stated, axis1=1, axis2=2).mean() > 1.5e-6


def test_what_is_not_seen_or_cannot_be_is_not_claimed(patch):
    at = patch.forward(*arms(patch).T, METROLOGY)
    at[3] = np.nan
    at[5] = patch.centres_mm[5] + 40.0
    xy, covariance = science_positions(patch, at, np.tile(1e-6 * np.eye(2), (len(patch), 1, 1)), "BOSS")
    assert np.isnan(xy[[3, 5]]).all()
    assert np.isnan(covariance[[3, 5]]).all()
    assert np.isfinite(xy[[0, 1, 2]]).all()
