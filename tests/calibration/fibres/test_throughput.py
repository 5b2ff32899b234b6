"""The share of a star's light in a fibre, against integrations of another kind."""

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.stats import ncx2
from stars import drawn_field

from fiberloom.calibration.fibres.model import FieldModel, FieldSettings
from fiberloom.calibration.fibres.start import _far, _shares, grid_um
from fiberloom.calibration.fibres.throughput import StarProfile, _power, light, light_share
from fiberloom.errors import InputError

CORE_UM = 120.0


@pytest.mark.parametrize("fwhm_um", [40.0, 85.0, 150.0, 400.0])
def test_a_gaussian_is_the_noncentral_chi_square(fwhm_um):
    sigma = fwhm_um / np.sqrt(8.0 * np.log(2.0))
    r = np.array([0.0, 1e-9, 3.0, 30.0, 59.9, 60.0, 60.1, 90.0, 200.0])
    exact = ncx2.cdf((0.5 * CORE_UM / sigma) ** 2, 2, (r / sigma) ** 2)
    found = light(StarProfile(np.inf), r, np.full_like(r, fwhm_um), CORE_UM).share
    assert np.abs(found - exact).max() < 1e-9


def moffat(profile, fwhm_um, x, y):
    w = fwhm_um / profile.fwhm
    return (profile.exponent - 1) / (np.pi * w**2) * (1 + (x * x + y * y) / w**2) ** -profile.exponent


@pytest.mark.parametrize("exponent", [2.5, 3.5, 4.765])
@pytest.mark.parametrize(("r", "fwhm_um"), [(0.0, 85.0), (12.0, 60.0), (60.0, 85.0), (110.0, 120.0)])
def test_a_moffat_is_its_integral_over_the_disc(exponent, r, fwhm_um):
    profile, a = StarProfile(exponent), 0.5 * CORE_UM
    exact, _ = dblquad(
        lambda angle, s: s * moffat(profile, fwhm_um, r + s * np.cos(angle), s * np.sin(angle)),
        0.0, a, 0.0, 2.0 * np.pi, epsabs=1e-9, epsrel=1e-9,
    )  # fmt: skip
    assert light(profile, np.array(r), np.array(fwhm_um), CORE_UM).share == pytest.approx(exact, abs=1e-7)


@pytest.mark.parametrize("exponent", [2.5, 3.5, np.inf])
def test_half_of_the_height_is_at_half_of_the_width(exponent):
    profile = StarProfile(exponent)
    density, _ = profile.around(np.array([0.0, (0.5 * profile.fwhm) ** 2]))
    assert density[1] / density[0] == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize("exponent", [2.5, 3.5, np.inf])
def test_derivatives_are_differences(exponent):
    profile, h = StarProfile(exponent), 1e-4
    r, w = np.meshgrid([0.0, 5.0, 45.0, 78.0, 130.0], [50.0, 85.0, 140.0])
    here = light(profile, r, w, CORE_UM)
    inside = np.abs(r - h)  # the share is even in r
    by_r = (light(profile, r + h, w, CORE_UM).share - light(profile, inside, w, CORE_UM).share) / (2 * h)
    wider, narrower = (light(profile, r, w * np.exp(s * h), CORE_UM).share for s in (1, -1))
    assert here.per_um == pytest.approx(by_r, abs=1e-9)
    assert here.per_fwhm == pytest.approx((wider - narrower) / (2 * h), abs=1e-7)
    assert (here.per_um[:, 1:] < 0).all()


def test_all_light_is_in_a_wide_fibre_and_a_moffat_has_wings():
    at, fwhm = np.array(0.0), np.array(50.0)
    assert light(StarProfile(np.inf), at, fwhm, 1000.0).share == pytest.approx(1.0, abs=1e-12)
    narrow, wide = (light(StarProfile(e), at, fwhm, CORE_UM).share for e in (2.5, 4.765))
    assert 0.75 < narrow < wide < 1.0


@pytest.mark.parametrize("exponent", [1.0, -3.0, np.nan])
def test_a_profile_without_a_core_is_refused(exponent):
    with pytest.raises(InputError, match="exponent"):
        StarProfile(exponent)


@pytest.mark.parametrize("exponent", [2.5, 3.5, np.inf])
def test_the_share_alone_has_the_same_bits(exponent):
    profile = StarProfile(exponent)
    r, w = np.meshgrid([0.0, 5.0, 60.0, 130.0], [50.0, 85.0, 140.0])  # at 60 um the rim meets the star
    whole = light(profile, r, w, CORE_UM).share
    np.testing.assert_array_equal(light_share(profile, r, w, CORE_UM), whole)


@pytest.mark.parametrize("exponent", [-0.5, -1.0, -2.5, -3.0, -5.0, -5.5, -3.765, 0.0, 1.5])
def test_a_power_is_numpys(exponent):
    """Half exponents have a way of their own."""
    base = np.geomspace(1.0, 1e6, 200)
    np.testing.assert_allclose(_power(base, exponent), base**exponent, rtol=2e-15)


def test_shares_by_trial_are_those_of_the_table():
    """For every offset that is tried; what lies beyond the table has the share of its end."""
    dither_um = np.array([[0.0, 0.0], [45.0, -20.0], [390.0, 0.0], [0.0, 900.0]])
    night = drawn_field(np.random.default_rng(3), np.zeros((5, 2)), dither_um=dither_um)
    model = FieldModel(night, FieldSettings())
    s = night.dither_um[:, None, None] + model.apart_um[None, :, None] - grid_um()
    table_um = np.arange(0.0, 401.0, 2.0)
    table = light_share(StarProfile(), table_um, np.full(201, 90.0), CORE_UM)
    expected = np.interp(np.hypot(s[..., 0], s[..., 1]), table_um, table)
    np.testing.assert_allclose(_shares(model, 90.0, _far(model)), expected, rtol=1e-12, atol=1e-15)
