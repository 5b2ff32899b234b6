"""Circle fits against circles that are known."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.calibration.transmission.circle import fit_circles


def points(centre, radius, angles, noise=0.0, rng=None):
    xy = np.asarray(centre) + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return xy if rng is None else xy + rng.normal(0, noise, xy.shape)


@given(st.floats(-300, 300), st.floats(-300, 300), st.floats(1, 25), st.floats(1.5, 6.28))
def test_points_without_noise_give_their_circle(x, y, radius, arc):
    xy = points((x, y), radius, np.linspace(0.3, 0.3 + arc, 50))[None]
    fit = fit_circles(xy, np.ones((1, 50), dtype=bool))
    # coordinates of 300 mm are rounded to 6e-14 mm; a quarter arc magnifies that to 1e-11
    np.testing.assert_allclose(fit.centre_mm, [[x, y]], atol=1e-9)
    np.testing.assert_allclose(fit.radius_mm, [radius], atol=1e-9)
    assert fit.used.all()


def test_the_covariance_is_the_scatter_that_is_seen():
    rng = np.random.default_rng(3)
    angles = np.linspace(0, np.pi, 200)
    xy = np.stack([points((5, -3), 15.0, angles, 5e-4, rng) for _ in range(400)])
    fit = fit_circles(xy, np.ones(xy.shape[:2], dtype=bool))
    found = np.column_stack([fit.centre_mm, fit.radius_mm]).std(axis=0)
    told = np.sqrt(np.einsum("nii->ni", fit.covariance)).mean(axis=0)
    # 400 fits know their scatter to 3.5 %
    np.testing.assert_allclose(told, found, rtol=0.14)
    np.testing.assert_allclose(fit.rms_mm.mean(), 5e-4, rtol=0.02)


def test_outliers_and_unseen_points_do_not_move_the_circle():
    rng = np.random.default_rng(4)
    xy = points((100, 50), 15.0, np.linspace(0, 6, 200), 3e-4, rng)[None]
    use = np.ones((1, 200), dtype=bool)
    clean = fit_circles(xy, use)
    xy[0, [5, 77]] += 0.8
    xy[0, 100] = np.nan
    use[0, 150] = False
    fit = fit_circles(xy, use)
    assert np.flatnonzero(~fit.used[0]).tolist() == [5, 77, 100, 150]
    np.testing.assert_allclose(fit.centre_mm, clean.centre_mm, atol=5e-5)


def test_hopeless_rows_do_not_disturb_the_others():
    good = points((1, 2), 3.0, np.linspace(0, 6, 30))
    xy = np.stack([good, np.ones((30, 2)), np.full((30, 2), np.nan)])
    fit = fit_circles(xy, np.ones((3, 30), dtype=bool))
    np.testing.assert_allclose(fit.radius_mm[0], 3.0, atol=1e-9)
    assert np.isfinite(fit.centre_mm).all()
