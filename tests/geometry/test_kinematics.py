"""Kronig 2020, Eq. 1 and 2, against complex arithmetic and against themselves."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fiberloom._core import geometry

FULL = np.array([[0.0, 2 * np.pi], [-np.pi, np.pi]])
ARM = np.array([[3.0, -4.0, 7.4, 0.3, -0.02]])
POINT = np.array([[14.965, -0.376]])

angle = st.floats(0.0, 2 * np.pi)
elbow = st.floats(-np.pi, np.pi)


def forward(alpha, beta, arm=ARM, point=POINT):
    return geometry.forward(arm, point, np.array([[alpha, beta]]))[0]


@given(angle, elbow)
def test_forward_is_the_sum_of_two_turned_vectors(alpha, beta):
    z = 3.0 - 4.0j + 7.4 * np.exp(1j * (alpha + 0.3))
    z += (14.965 - 0.376j) * np.exp(1j * (alpha + 0.3 + beta - 0.02))
    np.testing.assert_allclose(forward(alpha, beta), [z.real, z.imag], atol=1e-13)


@given(angle, elbow)
def test_a_solution_of_the_inverse_is_the_angle_that_was_put_in(alpha, beta):
    xy = forward(alpha, beta)
    angles, count, gap = geometry.inverse(ARM, POINT, xy[None], FULL)
    assert gap[0] == 0.0
    assert count[0] >= 1
    found = [forward(*angles[0, k]) for k in range(count[0])]
    np.testing.assert_allclose(found, np.broadcast_to(xy, (count[0], 2)), atol=1e-12)
    turns = np.exp(1j * angles[0, : count[0]])
    here = np.exp(1j * np.array([alpha, beta]))
    # near a straight arm the elbow moves with the square root of the rounding
    assert np.min(np.abs(turns - here).max(axis=1)) < 1e-6


@given(angle, st.floats(0.0, 0.5))
def test_beyond_reach_is_a_distance_and_not_a_nan(direction, beyond):
    reach = 7.4 + np.hypot(*POINT[0]) + 1e-6 + beyond
    xy = ARM[0, :2] + reach * np.array([np.cos(direction), np.sin(direction)])
    angles, count, gap = geometry.inverse(ARM, POINT, xy[None], FULL)
    assert count[0] == 0
    np.testing.assert_allclose(gap[0], beyond + 1e-6, rtol=1e-6)
    assert np.isfinite(angles).all()


@given(angle)
def test_the_edge_of_the_annulus_is_reachable(alpha):
    psi = np.arctan2(POINT[0, 1], POINT[0, 0])
    for beta in (-psi + 0.02, np.pi - psi + 0.02):  # stretched, folded
        _, count, gap = geometry.inverse(ARM, POINT, forward(alpha, beta)[None], FULL)
        assert count[0] >= 1
        assert gap[0] == 0.0


def test_limits_keep_one_elbow_and_every_turn_of_alpha():
    xy = forward(0.5, 1.0)[None]
    right = np.array([[0.0, 2 * np.pi], [0.0, np.pi]])
    assert geometry.inverse(ARM, POINT, xy, right)[1][0] == 1
    assert geometry.inverse(ARM, POINT, xy, FULL)[1][0] == 2
    wide = np.array([[-0.1, 2 * np.pi + 0.6], [0.0, np.pi]])
    angles, count, _ = geometry.inverse(ARM, POINT, xy, wide)
    assert count[0] == 2
    np.testing.assert_allclose(angles[0, :2, 0], [0.5, 0.5 + 2 * np.pi])
    none = np.array([[0.6, 0.7], [0.0, np.pi]])
    _, count, gap = geometry.inverse(ARM, POINT, xy, none)
    assert (count[0], gap[0]) == (0, 0.0)


@given(angle, elbow)
def test_the_jacobian_is_the_derivative(alpha, beta):
    h = 1e-6
    numeric = np.column_stack(
        [
            (forward(alpha + h, beta) - forward(alpha - h, beta)) / (2 * h),
            (forward(alpha, beta + h) - forward(alpha, beta - h)) / (2 * h),
        ]
    )
    exact = geometry.jacobian(ARM, POINT, np.array([[alpha, beta]]))[0]
    np.testing.assert_allclose(exact, numeric, atol=1e-7)


def test_more_turns_of_alpha_than_are_kept_are_left_out():
    wide = np.array([[0.0, 7 * 2 * np.pi], [-np.pi, np.pi]])
    xy = forward(1.0, 1.2)
    angles, count, gap = geometry.inverse(ARM, POINT, xy[None], wide)
    assert gap[0] == 0.0
    assert count[0] == geometry.MAX_SOLUTIONS == 4
    np.testing.assert_allclose([forward(*a) for a in angles[0]], np.broadcast_to(xy, (4, 2)), atol=1e-12)


def test_a_folded_or_straight_arm_has_one_elbow():
    # arms of 8 and 15 mm along x, without offsets: exact numbers, so that the edges are met to the bit
    arm, point = np.array([[0.0, 0.0, 8.0, 0.0, 0.0]]), np.array([[15.0, 0.0]])
    once = np.array([[0.0, 6.0], [-np.pi, np.pi]])
    for x, beta in ((23.0, 0.0), (-7.0, np.pi)):
        angles, count, gap = geometry.inverse(arm, point, np.array([[x, 0.0]]), once)
        assert (count[0], gap[0]) == (1, 0.0)
        assert abs(abs(angles[0, 0, 1]) - beta) < 1e-12
        np.testing.assert_allclose(forward(*angles[0, 0], arm, point), [x, 0.0], atol=1e-12)
