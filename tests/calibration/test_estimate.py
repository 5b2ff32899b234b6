"""Least squares with standard errors, and what an Estimate says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.calibration.bench.estimate import Fitted, Residuals, estimate, least_squares, standard_errors
from fiberloom.errors import InputError


def lines(n, m, rng, correlated=1):
    """N straight lines 2 + 3 x with noise of 0.1, alike over `correlated` neighbours."""
    x = np.broadcast_to(np.linspace(-1.0, 1.0, m), (n, m))
    noise = np.repeat(rng.normal(0.0, 0.1, (n, -(-m // correlated))), correlated, axis=1)[:, :m]
    return np.stack([np.ones_like(x), x], axis=-1), 2.0 + 3.0 * x + noise


@pytest.mark.parametrize(("correlated", "lag", "off"), [(1, 0, 0.1), (1, 5, 0.1), (6, 12, 0.2)])
def test_standard_errors_are_what_scatters(correlated, lag, off):
    design, right = lines(600, 240, np.random.default_rng(1), correlated)
    fit = least_squares(design, right, lag=lag)
    scatter = fit.value.std(axis=0)
    claimed = standard_errors(fit).mean(axis=0)
    # 600 draws tell a scatter to 3 percent; Bartlett's weights lose a sixth of the error at two blocks
    np.testing.assert_allclose(claimed, scatter, rtol=off)
    assert (np.abs(fit.value.mean(axis=0) - [2.0, 3.0]) < 4 * scatter / np.sqrt(600)).all()


def test_without_the_lag_correlated_residuals_claim_too_much():
    """The test above can fail."""
    design, right = lines(600, 240, np.random.default_rng(1), 6)
    fit = least_squares(design, right)
    assert standard_errors(fit).mean() < 0.6 * fit.value.std(axis=0).mean()


def test_what_is_missing_does_not_count():
    design, right = lines(3, 40, np.random.default_rng(2))
    holes = right.copy()
    holes[:, ::3] = np.nan
    kept = np.isfinite(holes[0])
    a, b = least_squares(design, holes), least_squares(design[:, kept], right[:, kept])
    np.testing.assert_allclose(a.value, b.value, rtol=1e-12)
    np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-10)
    assert np.isnan(a.residuals[:, ::3]).all()


def test_columns_that_go_together_are_singular():
    design, right = lines(2, 40, np.random.default_rng(3))
    twice = np.concatenate([design, design[..., 1:] * 7.0], axis=-1)
    assert least_squares(twice, right).singular.all()
    assert not least_squares(design, right).singular.any()
    assert least_squares(design[:, :2], right[:, :2]).singular.all()  # as many unknowns as points


@given(st.floats(1e-12, 1e12))
def test_units_do_not_matter(scale):
    design, right = lines(1, 30, np.random.default_rng(4))
    a, b = least_squares(design, right), least_squares(design * scale, right)
    np.testing.assert_allclose(b.value * scale, a.value, rtol=1e-9)
    np.testing.assert_allclose(standard_errors(b) * scale, standard_errors(a), rtol=1e-9)
    assert not b.singular.any()


def make(value, error, systematic=0.0, reason=("", ""), freedom=np.inf):
    fitted = Fitted(np.array(value), np.array(error), systematic, freedom)
    return estimate("thing", "uNm", fitted, Residuals(np.zeros((2, 4)), "uNm"), reason)


def test_errors_add_in_squares():
    e = make([5.0, 6.0], [3.0, 0.0], systematic=[4.0, 1.0])
    assert e.standard_error.tolist() == [5.0, 1.0]
    low, high = e.interval()
    np.testing.assert_allclose(high - low, 2 * 1.95996 * e.standard_error, rtol=1e-4)


def test_few_measurements_widen_the_interval():
    low, high = make([5.0, 6.0], [1.0, 1.0], freedom=4.0).interval()
    np.testing.assert_allclose(high - low, 2 * 2.7764, rtol=1e-4)  # Student, 4 degrees of freedom
    # a systematic part is not a matter of few measurements
    low, high = make([5.0, 6.0], [0.01, 0.01], systematic=1.0, freedom=4.0).interval()
    np.testing.assert_allclose(high - low, 2 * 1.96, rtol=1e-3)


def test_who_is_refused_says_why():
    e = make([5.0, 6.0], [1.0, 1.0], reason=("", "did not move"))
    assert e.of(0) == (5.0, 1.0)
    assert np.isnan(e.value[1])
    with pytest.raises(InputError, match="thing: did not move"):
        e.of(1)
    assert e.record(1) == {"unit": "uNm", "value": None, "reason": "did not move"}
    with pytest.raises(InputError, match=r"thing: dark \(and 1 more, all refused\)"):
        make([5.0, 6.0], [1.0, 1.0], reason=("dark", "dead"))


def test_a_scale_brings_its_own_error():
    e = make([10.0, 20.0], [0.3, 0.6]).scaled(2.0, 0.02, unit="mm")
    assert e.unit == "mm"
    np.testing.assert_allclose(e.standard_error, [np.hypot(0.6, 0.4), np.hypot(1.2, 0.8)])
    np.testing.assert_allclose(e.systematic, [0.4, 0.8])
