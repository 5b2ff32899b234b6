"""Offset, rotation and scale from guide stars."""

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.sky.guiding import expected_um, fit_guiding

RING_MM = 328.0


def stars(n, rng=None):
    around = 2.0 * np.pi * np.arange(n) / n
    return RING_MM * np.column_stack([np.cos(around), np.sin(around)])


def moved(p, offset=(1.829, -0.4), turn_arcsec=30.0, ppm=500.0):
    turn = np.radians(turn_arcsec / 3600.0)
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return np.array(offset) + (1.0 + 1e-6 * ppm) * p @ matrix.T


def test_without_noise_the_fit_is_exact():
    p = stars(12)
    fit = fit_guiding(p, moved(p, turn_arcsec=2.0))
    assert fit.offset_mm == pytest.approx([1.829, -0.4], abs=1e-9)
    assert fit.rotation_deg == pytest.approx(2.0 / 3600.0, abs=1e-9)
    assert fit.scale == pytest.approx(1.0005, abs=1e-9)
    assert fit.applied(p) == pytest.approx(moved(p, turn_arcsec=2.0), abs=1e-9)
    assert fit.removed(fit.applied(p)) == pytest.approx(p, abs=1e-9)
    assert fit.used.all()


@pytest.mark.parametrize("n", [6, 10, 20, 40])
def test_scatter_covariance_and_formula_agree(n):
    rng, sigma_um = np.random.default_rng(n), 6.0
    p = stars(n)
    fits = [fit_guiding(p, moved(p) + 1e-3 * sigma_um * rng.standard_normal(p.shape)) for _ in range(2000)]
    offset_um = 1e3 * np.std([f.offset_mm[0] for f in fits])
    turn_um = 1e3 * RING_MM * np.radians(np.std([f.rotation_deg for f in fits]))
    scale_um = 1e3 * RING_MM * np.std([f.scale for f in fits])
    # 2000 draws tell a deviation to 2 %; clipping loses a little
    for got in (offset_um, turn_um, scale_um):
        assert got == pytest.approx(expected_um(n, sigma_um, RING_MM, 0.0), rel=0.10)
    at_rim = np.sqrt(np.mean([f.error_um(RING_MM) ** 2 for f in fits]))
    assert at_rim == pytest.approx(expected_um(n, sigma_um, RING_MM, RING_MM), rel=0.10)
    assert np.sqrt(np.mean([f.sigma_um**2 for f in fits])) == pytest.approx(sigma_um, rel=0.10)


def test_eighteen_stars_give_2_um_at_the_rim():
    assert expected_um(18, 6.0, RING_MM, RING_MM) == pytest.approx(2.0)


def test_wild_stars_are_clipped_and_others_are_not():
    p, wild, draws = stars(20), [3, 11], 100
    others = 0
    for seed in range(draws):
        seen = moved(p) + 1e-3 * 6.0 * np.random.default_rng(seed).standard_normal(p.shape)
        seen[wild] += 0.1 * np.array([[1.0, 0.0], [-0.6, 0.8]])
        fit = fit_guiding(p, seen)
        assert not fit.used[wild].any()
        others += int((~fit.used).sum()) - len(wild)
        # four sigmas of what 18 stars tell
        assert 1e3 * np.abs(fit.offset_mm - [1.829, -0.4]).max() < 4 * 6.0 / np.sqrt(18)
    # a star of normal errors is beyond 3.5 sigmas once in 460; the fit makes residuals smaller, sigma too
    assert others < 0.01 * 18 * draws


def test_two_stars_tell_offset_and_rotation_but_no_scale():
    p = stars(2)
    fit = fit_guiding(p, moved(p, ppm=0.0))
    assert fit.scale == pytest.approx(1.0, abs=1e-15)
    assert fit.rotation_deg * 3600.0 == pytest.approx(30.0, abs=1e-6)
    assert fit_guiding(p, moved(p, ppm=500.0)).scale == pytest.approx(1.0, abs=1e-15)


def test_two_stars_leave_one_number_free():
    p = stars(2)
    apart = (p[1] - p[0]) / np.hypot(*(p[1] - p[0]))
    fit = fit_guiding(p, p + np.outer([-1e-3, 1e-3], apart))
    # 4 measured numbers less offset and rotation; the two are 1 um off each
    assert fit.sigma_um == pytest.approx(np.sqrt(2.0), rel=1e-9)


def test_weights_count():
    p = stars(6)
    seen = p + 1e-3 * np.random.default_rng(0).standard_normal(p.shape)
    seen[0, 0] += 2e-3
    light, heavy = (fit_guiding(p, seen, np.where(np.arange(6) == 0, w, 1.0)) for w in (0.1, 1.0))
    assert light.offset_mm[0] < heavy.offset_mm[0]


@pytest.mark.parametrize(
    ("p", "words"),
    [
        (stars(1), "1 guide stars; offset and rotation need 2"),
        (np.zeros((4, 2)), "all guide stars are on one place"),
    ],
)
def test_too_little_to_go_by(p, words):
    with pytest.raises(InputError, match=words):
        fit_guiding(p, p)


def test_a_star_that_was_not_seen_does_not_count():
    p = stars(8)
    seen = moved(p)
    seen[2] = np.nan
    fit = fit_guiding(p, seen)
    assert not fit.used[2]
    assert fit.scale == pytest.approx(1.0005, abs=1e-9)
