"""Turbulence taken off: how much is left, and whether it is known how much."""

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.metrology import zhao_burge
from fiberloom.metrology.turbulence import AirSize, FittedTerms, remove_turbulence, rms_um
from fiberloom.metrology.zhao_burge import N_TERMS
from fiberloom.twin.camera.air import air_shift_mm


def disc(rng, n, radius=400.0):
    r, a = radius * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    return np.column_stack([r * np.cos(a), r * np.sin(a)])


def scene(seed, n_standing=700, n=1500, noise_um=1.0):
    rng = np.random.default_rng([seed, 1])
    at = disc(rng, n_standing + n)
    true = air_shift_mm(at, 5.0, 50.0, rng)
    seen = true[:n_standing] + rng.normal(0, noise_um * 1e-3, (n_standing, 2))
    return at[:n_standing], seen, at[n_standing:], true[n_standing:]


def test_the_field_of_the_twin_is_what_it_says():
    rng = np.random.default_rng(0)
    at = np.array([[0.0, 0.0], [50.0, 0.0], [200.0, 100.0]])
    draws = np.array([air_shift_mm(at, 5.0, 50.0, rng) for _ in range(3000)]) * 1e3
    # 3000 draws: 2 % on a variance
    np.testing.assert_allclose(draws.var(axis=0), 25.0, rtol=0.1)
    np.testing.assert_allclose((draws[:, 0] * draws[:, 1]).mean(axis=0), 25 * np.exp(-0.5), rtol=0.12)
    np.testing.assert_allclose((draws[:, 0] * draws[:, 2]).mean(axis=0), 0, atol=1.5)


def test_what_is_left_is_small_and_known():
    standing, seen, places, true = scene(3)
    air = remove_turbulence(standing, seen, 1e-3, places)
    left = true - air.shift_mm
    assert rms_um(true) > 5.5
    assert rms_um(left) < 1.3
    assert 3 <= air.amplitude_um <= 8
    assert 35 <= air.length_mm <= 70
    pull = np.sqrt(np.mean(left**2 / air.variance_mm2[:, None]))
    assert 0.8 < pull < 1.25


def test_one_that_moved_after_all_is_left_out():
    standing, seen, places, true = scene(4)
    seen[[10, 200, 500]] += [[0.3, 0.0], [0.0, 0.05], [2.0, 2.0]]
    air = remove_turbulence(standing, seen, 1e-3, places)
    assert not air.used[[10, 200, 500]].any()
    assert air.used.sum() > 690
    assert rms_um(true - air.shift_mm) < 1.3


def test_calm_air_is_left_alone():
    rng = np.random.default_rng(1)
    at, places = disc(rng, 300), disc(rng, 300)
    air = remove_turbulence(at, rng.normal(0, 1e-3, (300, 2)), 1e-3, places)
    assert rms_um(air.shift_mm) < 0.5


def test_far_from_all_that_stands_nothing_is_claimed():
    standing, seen, _, _ = scene(5)
    air = remove_turbulence(standing, seen, 1e-3, [[5000.0, 0.0]], size=AirSize(5.0, 50.0))
    np.testing.assert_allclose(air.shift_mm, 0, atol=1e-12)
    np.testing.assert_allclose(np.sqrt(air.variance_mm2), 5e-3)


def test_too_few_are_refused():
    with pytest.raises(InputError, match="at least 3"):
        remove_turbulence(np.zeros((2, 2)), np.zeros((2, 2)), 1e-3, np.zeros((1, 2)))


def edge_of_a_fit(seed):
    """Standing points within 400 mm and 300 places beyond them, in air, as a transform leaves them.

    What is left at both, and the terms of the transform.
    """
    rng = np.random.default_rng(seed)
    standing = disc(rng, 400, 400.0)
    angle = rng.uniform(0.0, 2 * np.pi, 300)
    places = 408.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    air = air_shift_mm(np.vstack([standing, places]), 5.0, 50.0, rng)
    seen = air[: len(standing)] + rng.normal(0, 1e-3, standing.shape)
    trend = FittedTerms(*(zhao_burge.basis(at / 410.0, range(N_TERMS)) for at in (standing, places)))
    terms = trend.standing.transpose(1, 2, 0).reshape(seen.size, -1)
    fitted = np.linalg.lstsq(terms, seen.ravel(), rcond=None)[0]
    left = [np.einsum("k,knc->nc", fitted, fields) for fields in (trend.standing, trend.places)]
    return standing, seen - left[0], places, air[len(standing) :] - left[1], trend


def test_what_a_fit_has_taken_up_is_told_at_the_edge():
    pulls = {True: [], False: []}
    for seed in range(6):
        standing, shift, places, true, trend = edge_of_a_fit(seed)
        for with_terms, found in pulls.items():
            air = remove_turbulence(standing, shift, 1e-3, places, trend=trend if with_terms else None)
            left = true - air.shift_mm
            found.append(np.mean(left**2 / air.variance_mm2[:, None]))
    assert 0.8 < np.sqrt(np.mean(pulls[True])) < 1.25
    # or this test could not see it
    assert np.sqrt(np.mean(pulls[False])) > 1.3


def test_terms_do_not_hide_the_size_of_the_air():
    found = []
    for seed in range(6):
        standing, shift, places, _, trend = edge_of_a_fit(seed)
        found.append(remove_turbulence(standing, shift, 1e-3, places, trend=trend).amplitude_um)
    assert 4.5 < np.mean(found) < 5.6


def test_terms_that_no_point_tells_apart_change_nothing():
    """A determinant of 0 would make any air the likeliest."""
    standing, shift, places, _, trend = edge_of_a_fit(0)
    twice = FittedTerms(*(np.concatenate([fields, fields[:1]]) for fields in (trend.standing, trend.places)))
    one, other = (remove_turbulence(standing, shift, 1e-3, places, trend=terms) for terms in (trend, twice))
    assert (one.amplitude_um, one.length_mm) == (other.amplitude_um, other.length_mm)
    np.testing.assert_allclose(other.shift_mm, one.shift_mm, atol=1e-9)
    np.testing.assert_allclose(other.variance_mm2, one.variance_mm2, rtol=1e-6)
