"""Pixels to focal plane: recovered, honest about its error, and not led astray."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom.errors import InputError
from fiberloom.metrology import zhao_burge
from fiberloom.metrology.transform import (
    Distortion,
    FieldTransform,
    PlaceErrors,
    Similarity,
    fit_similarity,
    fit_transform,
)
from fiberloom.twin.camera.models import camera_model

RADIUS = 330.0
TERMS = zhao_burge.DEFAULT_TERMS


def truth(flipped=True, third=0.64):
    c = np.zeros(len(TERMS))
    for term, value in {9: third, 20: 0.03, 5: 0.02, 28: 0.01}.items():
        c[TERMS.index(term)] = value
    a = 0.1215 * np.exp(0.3j)
    base = Similarity(a, -a * (3000 - 3000j if flipped else 3000 + 3000j), flipped)
    nothing = np.zeros((len(c), len(c)))
    return FieldTransform(base, RADIUS, TERMS, c, nothing, nothing)


def fiducials(n=60, seed=0):
    rng = np.random.default_rng(seed)
    r, a = 320 * np.sqrt(rng.uniform(0, 1, n)), rng.uniform(0, 2 * np.pi, n)
    return np.column_stack([r * np.cos(a), r * np.sin(a)])


@given(st.floats(-np.pi, np.pi), st.floats(0.01, 10), st.booleans())
@settings(max_examples=30)
def test_a_similarity_is_recovered(angle, scale, flipped):
    mm = fiducials(7)
    true = Similarity(scale * np.exp(1j * angle), 3 - 7j, flipped)
    found = fit_similarity(true.to_px(mm), mm, flipped=flipped)
    np.testing.assert_allclose([found.a, found.b], [true.a, true.b], rtol=1e-9, atol=1e-9)
    assert found.scale_mm_px == pytest.approx(scale)
    np.testing.assert_allclose(found.to_mm(found.to_px(mm)), mm, atol=1e-9)


@given(st.lists(st.floats(0.1, 10.0), min_size=7, max_size=7), st.booleans())
@settings(max_examples=30)
def test_weights_are_those_of_least_squares(weight, flipped):
    """Against a solver of linear equations: a, b of weight |a z + b - m|^2."""
    mm, px = fiducials(7), fiducials(7, seed=1)
    found = fit_similarity(px, mm, flipped=flipped, weight=weight)
    z, root = px @ [1, -1j if flipped else 1j], np.sqrt(weight)
    (a, b), *_ = np.linalg.lstsq(root[:, None] * np.column_stack([z, np.ones(7)]), root * (mm @ [1, 1j]))
    np.testing.assert_allclose([found.a, found.b], [a, b], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("weight", [np.zeros(7), np.ones(6), 2.0, [2.0]])
def test_weights_that_are_none_are_refused(weight):
    with pytest.raises(InputError, match="a weight for each point, and not all 0"):
        fit_similarity(fiducials(7), fiducials(7), weight=weight)


@pytest.mark.parametrize("flipped", [True, False])
def test_there_and_back(flipped):
    t, mm = truth(flipped), fiducials(200, 3)
    np.testing.assert_allclose(t.to_mm(t.to_px(mm)), mm, atol=1e-7)


def test_the_jacobian_is_the_derivative():
    t, h = truth(), 1e-3
    px = t.to_px(fiducials(20))
    for axis in range(2):
        step = np.eye(2)[axis] * h
        slope = (t.to_mm(px + step) - t.to_mm(px - step)) / (2 * h)
        np.testing.assert_allclose(t.jacobian(px)[..., axis], slope, atol=1e-9)


def test_a_distortion_is_recovered_exactly_without_noise():
    t, mm = truth(), fiducials()
    fit = fit_transform(t.to_px(mm), mm, Distortion(RADIUS), flipped=True)
    # the fit holds another similarity, and evaluates the terms there: 0.64 mm moved by 0.64 mm
    elsewhere = fiducials(300, 9)
    assert fit.rms_um < 0.5
    error_um = 1e3 * np.hypot(*(fit.transform.to_mm(t.to_px(elsewhere)) - elsewhere).T)
    assert error_um.max() < 2.0


def test_left_out_residuals_are_those_of_leaving_out():
    t, mm, rng = truth(), fiducials(40), np.random.default_rng(1)
    px = t.to_px(mm) + rng.normal(0, 0.05, mm.shape)
    whole = fit_transform(px, mm, Distortion(RADIUS), flipped=True, robust=False)
    for k in (0, 11, 39):
        keep = np.arange(len(mm)) != k
        # the same similarity: the fit is linear only with it held
        part = fit_transform(px[keep], mm[keep], Distortion(RADIUS), flipped=True, robust=False)
        left_out = mm[k] - part.transform.to_mm(px[k : k + 1])[0]
        np.testing.assert_allclose(whole.leave_one_out_mm[k], left_out, atol=2e-5)


def test_the_covariance_is_what_repeated_fits_scatter_by():
    t, mm, rng = truth(), fiducials(), np.random.default_rng(2)
    sigma_px, at = 0.02, t.to_px(fiducials(15, 5))
    cov = np.broadcast_to(np.eye(2) * sigma_px**2, (len(mm), 2, 2))
    places, stated = [], []
    for _ in range(150):
        px = t.to_px(mm) + rng.normal(0, sigma_px, mm.shape)
        fit = fit_transform(px, mm, Distortion(RADIUS), flipped=True, errors=PlaceErrors(cov))
        places.append(fit.transform.to_mm(at))
        stated.append(np.trace(fit.transform.covariance(at), axis1=1, axis2=2))
    scatter = np.var(places, axis=0).sum(axis=1)
    # 150 fits: 8 % for each place, 3 % for all together; chi2 above 1 widens by a few per cent
    ratio = np.mean(stated, axis=0) / scatter
    assert np.all((ratio > 0.7) & (ratio < 1.5))
    assert 0.93 < ratio.mean() < 1.2


def test_fiducial_errors_reach_the_fibres_by_a_third():
    t, mm, rng = truth(), fiducials(), np.random.default_rng(3)
    at, error = t.to_px(fiducials(300, 6)), []
    for _ in range(20):
        wrong = mm + rng.normal(0, 8e-3, mm.shape)
        fit = fit_transform(
            t.to_px(mm), wrong, Distortion(RADIUS), flipped=True, errors=PlaceErrors(sigma_mm=8e-3)
        )
        error.append(fit.transform.to_mm(at) - t.to_mm(at))
    factor = np.sqrt(np.mean(np.square(error))) / 8e-3
    assert factor < 0.4  # sqrt(13 / 120) = 0.33


def test_the_noise_is_what_images_differ_by_though_the_table_is_wrong():
    """The table is off by 8 um in all images; spots by 0.02 px, new in each."""
    t, mm, rng = truth(), fiducials(), np.random.default_rng(4)
    wrong = mm + rng.normal(0, 8e-3, mm.shape)
    at = t.to_px(fiducials(15, 5))
    cov, own = (np.broadcast_to(np.eye(2) * 0.02**2, (len(p), 2, 2)) for p in (mm, at))
    places, noise, stated = [], [], []
    for _ in range(150):
        px = t.to_px(mm) + rng.normal(0, 0.02, mm.shape)
        fit = fit_transform(px, wrong, Distortion(RADIUS), flipped=True, errors=PlaceErrors(cov, 8e-3))
        places.append(fit.transform.to_mm(at + rng.normal(0, 0.02, at.shape)))
        noise.append(np.trace(fit.transform.noise(at, own), axis1=1, axis2=2))
        stated.append(np.trace(fit.transform.covariance(at, own), axis1=1, axis2=2))
    scatter = np.var(places, axis=0).sum(axis=1)
    assert np.mean(np.mean(noise, axis=0) / scatter) == pytest.approx(1.0, abs=0.08)
    assert np.mean(np.mean(stated, axis=0) / scatter) > 2.0  # what the table is off by is in it


@pytest.mark.parametrize("errors", [None, PlaceErrors(sigma_mm=8e-3)])
def test_where_nothing_is_known_of_the_spots_all_may_be_noise(errors):
    t, mm = truth(), fiducials()
    px = t.to_px(mm) + np.random.default_rng(5).normal(0, 0.02, mm.shape)
    found = fit_transform(px, mm, Distortion(RADIUS), flipped=True, errors=errors).transform
    np.testing.assert_array_equal(found.noise_mm2, found.covariance_mm2)


def test_the_inverse_of_the_camera_s_distortion_is_among_the_terms():
    """Its forward map is a sum of terms; backwards the third order has a seventh, 0.6 um of it."""
    optics = camera_model("sdssv").optics
    mm = fiducials(400, 8)
    px = optics.to_px(mm)
    left = [
        fit_transform(px, mm, Distortion(RADIUS, range(n)), flipped=True, robust=False).rms_um
        for n in (33, 34)
    ]
    assert left[0] > 0.3  # less than over the whole disc: these reach 320 of 330 mm
    assert left[1] < 0.15


def test_a_term_counts_when_the_fiducials_prove_it():
    t, mm, rng = truth(), fiducials(), np.random.default_rng(4)
    cov = np.broadcast_to(np.eye(2) * 0.006**2, (len(mm), 2, 2))
    px = t.to_px(mm) + rng.normal(0, 0.006, mm.shape)
    fit = fit_transform(px, mm, Distortion(RADIUS), flipped=True, errors=PlaceErrors(cov))
    proven = set(fit.transform.significant(3.0))
    # 10 um and more against a scatter of 0.7 um over the root of 60
    assert {9, 20, 5, 28} <= proven
    assert len(proven - {0, 1, 2, 27, 9, 20, 5, 28}) <= 2


def test_a_fiducial_in_the_wrong_place_is_left_out():
    t, mm, rng = truth(), fiducials(), np.random.default_rng(4)
    px = t.to_px(mm) + rng.normal(0, 0.01, mm.shape)
    wrong = mm.copy()
    wrong[[5, 17]] += [[0.2, 0.0], [0.0, -0.1]]
    fit = fit_transform(px, wrong, Distortion(RADIUS), flipped=True)
    assert not fit.used[[5, 17]].any()
    assert fit.used.sum() >= 56
    np.testing.assert_allclose(fit.transform.to_mm(px), mm, atol=6e-3)


def test_few_fiducials_give_fewer_terms():
    t = truth()
    for n, terms in ((60, 33), (18, 13), (6, 4)):
        mm = fiducials(n)
        fit = fit_transform(t.to_px(mm), mm, Distortion(RADIUS, range(33)), flipped=True)
        assert len(fit.transform.terms) == terms


def test_too_few_are_refused():
    with pytest.raises(InputError, match="at least 3"):
        fit_transform([[0, 0], [1, 1]], [[0, 0], [1, 1]], Distortion(1.0))
    with pytest.raises(InputError, match="at least 2"):
        fit_similarity([[0, 0]], [[1, 1]])
