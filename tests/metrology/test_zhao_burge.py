"""The vector polynomials against their defining properties."""

import numpy as np
import pytest

from fiberloom.metrology import zhao_burge

ALL = range(zhao_burge.N_WIDE_TERMS)


def disc_quadrature():
    """Points and weights that integrate polynomials of degree 20 over the unit disc, area 1."""
    r, w = np.polynomial.legendre.leggauss(12)
    r, w = (r + 1) / 2, w / 2
    angle = np.arange(24) * 2 * np.pi / 24
    rr, aa = np.meshgrid(r, angle)
    weight = np.broadcast_to(w * r, rr.shape) * 2 / 24
    return np.column_stack([(rr * np.cos(aa)).ravel(), (rr * np.sin(aa)).ravel()]), weight.ravel()


def jacobians(xy):
    """(57, n, 2, 2) of every term by itself."""
    return np.array([zhao_burge.field_jacobian(xy, np.ones(1), [term]) for term in ALL])


def test_all_terms_are_orthonormal_on_the_disc():
    xy, weight = disc_quadrature()
    b = zhao_burge.basis(xy, ALL)
    gram = np.einsum("knc,lnc,n->kl", b, b, weight)
    np.testing.assert_allclose(gram, np.eye(len(ALL)), atol=1e-12)


def test_one_family_has_no_curl_and_the_other_no_divergence():
    xy, _ = disc_quadrature()
    j = jacobians(xy)
    gradients, turned = j[[*range(27), *range(33, 42)]], j[[*range(27, 33), *range(42, 57)]]
    # the highest derivatives of S37 are near 100
    np.testing.assert_allclose(gradients[..., 1, 0], gradients[..., 0, 1], atol=1e-11)
    np.testing.assert_allclose(turned[..., 0, 0], -turned[..., 1, 1], atol=1e-12)
    # and neither is trivially both
    assert np.abs(gradients[2:, :, 0, 0] + gradients[2:, :, 1, 1]).max() > 1
    assert np.abs(turned[..., 1, 0] - turned[..., 0, 1]).max() > 1


def test_the_jacobian_is_the_derivative():
    rng = np.random.default_rng(0)
    xy, h = rng.uniform(-0.7, 0.7, (20, 2)), 1e-5
    for axis in range(2):
        step = np.eye(2)[axis] * h
        slope = (zhao_burge.basis(xy + step, ALL) - zhao_burge.basis(xy - step, ALL)) / (2 * h)
        np.testing.assert_allclose(jacobians(xy)[..., axis], slope, atol=1e-7)


def test_a_field_is_the_sum_of_its_terms():
    rng = np.random.default_rng(1)
    xy, size, terms = rng.uniform(-0.7, 0.7, (20, 2)), rng.normal(size=4), [9, 30, 2, 56]
    terms_by_one = np.einsum("k,knc->nc", size, zhao_burge.basis(xy, terms))
    np.testing.assert_allclose(zhao_burge.field(xy, size, terms), terms_by_one, atol=1e-13)
    slopes_by_one = np.einsum("k,kncd->ncd", size, jacobians(xy)[terms])
    np.testing.assert_allclose(zhao_burge.field_jacobian(xy, size, terms), slopes_by_one, atol=1e-12)
    assert not zhao_burge.field(xy, np.zeros(0), []).any()


def test_named_terms_are_what_they_are_called():
    xy = np.array([[0.3, 0.4], [-0.6, 0.2]])
    x, y = xy.T
    shift_x, shift_y, scale, turn = zhao_burge.basis(xy, [0, 1, 2, 27])
    np.testing.assert_allclose(shift_x, [[1, 0], [1, 0]])
    np.testing.assert_allclose(shift_y, [[0, 1], [0, 1]])
    np.testing.assert_allclose(scale, np.sqrt(2) * xy)
    np.testing.assert_allclose(turn, np.sqrt(2) * np.column_stack([y, -x]))
    for radial in zhao_burge.basis(xy, [9, 20, 33]):  # radial: no component across
        np.testing.assert_allclose(radial[:, 0] * y, radial[:, 1] * x, atol=1e-14)


@pytest.mark.parametrize(
    ("j", "nm"), [(1, (0, 0)), (2, (1, 1)), (3, (1, -1)), (4, (2, 0)), (11, (4, 0)), (28, (6, 6))]
)
def test_noll_order(j, nm):
    assert zhao_burge.noll(j) == nm
