"""Distances of segments against brute force, exact cases and their symmetries."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom._core import geometry

coordinate = st.floats(-30.0, 30.0).map(lambda v: round(v, 6))
segment = st.tuples(coordinate, coordinate, coordinate, coordinate)


def distance(p, q):
    return geometry.segment_distance(np.array([p], float), np.array([q], float))[0]


def closest(p, q):
    return geometry.closest_points(np.array([p], float), np.array([q], float))[0]


def brute(p, q, n=201):
    t = np.linspace(0.0, 1.0, n)[:, None]
    a = np.array(p[:2]) + t * (np.array(p[2:]) - np.array(p[:2]))
    b = np.array(q[:2]) + t * (np.array(q[2:]) - np.array(q[:2]))
    return np.hypot(*(a[:, None] - b[None]).transpose(2, 0, 1)).min()


@given(segment, segment)
def test_distance_against_brute_force(p, q):
    """Samples lie at most half a step off the nearest points, so brute force is high by that."""
    step = (np.hypot(p[2] - p[0], p[3] - p[1]) + np.hypot(q[2] - q[0], q[3] - q[1])) / 400
    d = distance(p, q)
    assert d <= brute(p, q) + 1e-9
    assert d >= brute(p, q) - step - 1e-9


@given(segment, segment)
def test_closest_points_lie_on_the_segments_at_the_distance(p, q):
    c = closest(p, q)
    for xy, s, along in ((c[:2], p, c[4]), (c[2:4], q, c[5])):
        assert 0.0 <= along <= 1.0
        on = np.array(s[:2]) + along * (np.array(s[2:]) - np.array(s[:2]))
        np.testing.assert_allclose(xy, on, atol=1e-9)
    np.testing.assert_allclose(np.hypot(*(c[:2] - c[2:4])), c[6], atol=1e-9)
    np.testing.assert_allclose(c[6], distance(p, q), atol=1e-12)


@given(segment, segment, st.floats(0, 6.2), coordinate, coordinate)
def test_distance_does_not_see_order_or_place(p, q, turn, dx, dy):
    def moved(s):
        z = (np.array([s[0], s[2]]) + 1j * np.array([s[1], s[3]])) * np.exp(1j * turn) + dx + 1j * dy
        return z[0].real, z[0].imag, z[1].real, z[1].imag

    d = distance(p, q)
    np.testing.assert_allclose(distance(q, p), d, atol=1e-12)
    np.testing.assert_allclose(distance(p[2:] + p[:2], q), d, atol=1e-12)
    # a crossing that turns into a touch by rounding moves the distance by the rounding only
    np.testing.assert_allclose(distance(moved(p), moved(q)), d, atol=1e-9)


@pytest.mark.parametrize(
    ("p", "q", "want"),
    [
        ((0, 0, 4, 0), (2, -1, 2, 1), 0.0),  # cross
        ((0, 0, 4, 0), (2, 0, 2, 5), 0.0),  # touch in the middle
        ((0, 0, 4, 0), (4, 0, 9, 9), 0.0),  # touch at the ends
        ((0, 0, 4, 0), (1, 0, 9, 0), 0.0),  # overlap on one line
        ((0, 0, 4, 0), (5, 0, 9, 0), 1.0),  # one line, apart
        ((0, 0, 4, 0), (-3, 2, 8, 2), 2.0),  # parallel
        ((0, 0, 4, 0), (7, 4, 9, 9), 5.0),  # end to end
        ((0, 0, 4, 0), (2, 3, 2, 9), 3.0),  # end to middle
        ((1, 1, 1, 1), (4, 5, 4, 5), 5.0),  # two points
        ((1, 1, 1, 1), (0, 0, 2, 2), 0.0),  # a point on a segment
    ],
)
def test_exact_distances(p, q, want):
    assert distance(p, q) == pytest.approx(want, abs=1e-15)


@given(st.floats(0, 6.28), st.floats(0, 3.14))
def test_the_beta_segment_is_two_points_of_the_arm(alpha, beta):
    arm, angles = np.array([[3.0, -4.0, 7.4, 0.3, -0.02]]), np.array([[alpha, beta]])
    s = geometry.beta_segment(arm, 0.5, 14.7276, angles)[0]
    for x, xy in ((0.5, s[:2]), (14.7276, s[2:])):
        np.testing.assert_allclose(xy, geometry.forward(arm, np.array([[x, 0.0]]), angles)[0], atol=1e-12)
