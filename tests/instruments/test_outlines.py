"""Outlines of bodies: capsules cover polygons, and what an instrument may not say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from fiberloom.errors import InputError
from fiberloom.instruments import load_instrument, parse_instrument
from fiberloom.instruments.outlines import KeepOut, Outline, covered, layer_bits

DESI = load_instrument("desi")


def gaps_mm(points, capsules):
    """Of points from the nearest capsule; below 0 inside."""
    a, b = (capsules[:, k] + 1j * capsules[:, k + 1] for k in (0, 2))
    at = (points[:, 0] + 1j * points[:, 1])[:, None]
    along = b - a
    part = np.clip(((at - a) * along.conj()).real / np.maximum(np.abs(along) ** 2, 1e-300), 0.0, 1.0)
    return (np.abs(at - a - part * along) - capsules[:, 4]).min(axis=1)


def inside(hull, points):
    """By how much points are beyond the edges of a hull; at most 0 inside."""
    equations = ConvexHull(hull).equations
    return (points @ equations[:, :2].T + equations[:, 2]).max(axis=1)


corner = st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))


@given(st.lists(corner, min_size=3, max_size=8, unique=True), st.integers(0, 1000))
@settings(max_examples=8, deadline=None)
def test_all_of_a_polygon_is_covered_and_no_more_than_said(corners, seed):
    polygon = np.array(corners)
    spread = np.linalg.svd(polygon - polygon.mean(axis=0), compute_uv=False)
    if spread[-1] < 0.1:
        return
    capsules = covered(polygon, 1.0)
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(len(polygon)), 500)
    assert gaps_mm(np.vstack([weights @ polygon, polygon]), capsules).max() <= 1e-9
    turns = rng.uniform(0.0, 2.0 * np.pi, (200, 1))
    ends = capsules[rng.integers(len(capsules), size=200)]
    rim = ends[:, :2] + ends[:, 4:] * np.hstack([np.cos(turns), np.sin(turns)])
    hull = polygon[ConvexHull(polygon).vertices]
    edges = np.column_stack([hull, np.roll(hull, -1, axis=0), np.zeros(len(hull))])
    outside = inside(polygon, rim) > 0.0
    assert gaps_mm(rim[outside], edges).max(initial=0.0) <= 1.0 + 1e-9


def test_desi_has_the_published_keep_outs():
    phi, theta = DESI.bodies.parts
    assert (phi.arm, theta.arm) == ("beta", "alpha")
    assert phi.far_mm == pytest.approx(4.047, abs=1e-3)
    assert theta.far_mm == pytest.approx(5.123, abs=1e-3)
    assert np.ptp(np.array(phi.polygon_mm)[:, 1]) == pytest.approx(2 * 1.583)
    assert layer_bits(phi.layers) & layer_bits(theta.layers)
    assert phi.reach_mm == pytest.approx(phi.far_mm + phi.excess_mm)
    for part in (phi, theta):
        assert gaps_mm(np.array(part.polygon_mm), part.capsules_mm).max() <= 1e-9
        assert len(part.capsules_mm) <= 6


def test_a_rounded_polygon_is_wider_on_all_sides():
    flat = Outline(arm="beta", polygon_mm=((0, 0), (4, 0), (4, 2)), excess_mm=0.3)
    round_ = Outline(arm="beta", polygon_mm=((0, 0), (4, 0), (4, 2)), excess_mm=0.3, radius_mm=0.5)
    np.testing.assert_allclose(round_.capsules_mm[:, 4] - flat.capsules_mm[:, 4], 0.5)
    assert round_.reach_mm == flat.reach_mm + 0.5


def test_keep_outs_are_repeated_around_the_field():
    disc = KeepOut(line_mm=((3.0, 4.0),), radius_mm=1.0, copies=4).capsules_mm
    assert disc[:, :2] == pytest.approx(np.array([[3, 4], [-4, 3], [-3, -4], [4, -3]]))
    bent = KeepOut(line_mm=((0, 1), (1, 1), (1, 2)), radius_mm=0.5).capsules_mm
    assert bent.tolist() == [[0, 1, 1, 1, 0.5], [1, 1, 1, 2, 0.5]]


def test_a_keep_out_may_be_a_polygon_that_is_not_convex():
    corner = KeepOut(polygon_mm=((10, -1), (14, -1), (14, 1), (12, 0), (10, 1)), radius_mm=0.1, copies=2)
    edges = corner.capsules_mm
    assert len(edges) == 10
    assert edges[4].tolist() == [10, 1, 10, -1, 0.1]
    np.testing.assert_allclose(edges[5:, :4], -edges[:5, :4], atol=1e-12)
    places = np.array([[11.0, 0.0], [-11.0, 0.2], [9.0, 0.0], [-14.0, -3.0], [12.0, 0.8]])
    # the last one is in the notch, beside two edges that fall by 1 in 2
    assert corner.distance_mm(places) == pytest.approx([0.0, 0.0, 0.9, 1.9, 0.8 * 2 / np.sqrt(5) - 0.1])
    np.testing.assert_allclose(corner.turned(np.pi).capsules_mm[:5, :4], edges[5:, :4], atol=1e-12)


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ({"radius_mm": 1.0}, "line_mm or polygon_mm"),
        ({"line_mm": [[0, 0]]}, "radius_mm"),
        ({"polygon_mm": [[0, 0], [1, 1]], "radius_mm": 1.0}, "at least 3"),
    ],
)
def test_keep_outs_that_make_no_sense_are_refused(shape, words):
    data = DESI.model_dump(mode="json")
    data["bodies"]["keep_outs"] = [shape]
    with pytest.raises(InputError, match=words):
        parse_instrument(data, "test")


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ({"arm": "beta"}, "needs capsule_mm or polygon_mm"),
        ({"arm": "beta", "capsule_mm": [0, 0, 1, 0]}, "a capsule needs one above 0"),
        ({"arm": "beta", "polygon_mm": [[0, 0], [1, 1], [2, 2]]}, "do not lie on one line"),
        ({"arm": "beta", "polygon_mm": [[0, 0], [1, 1]]}, "at least three corners"),
        ({"arm": "gamma", "capsule_mm": [0, 0, 1, 0], "radius_mm": 1.0}, "arm"),
        ({"arm": "beta", "capsule_mm": [0, 0, 1, 0], "radius_mm": 1.0, "layers": [33]}, "layers"),
        ({"arm": "alpha", "capsule_mm": [0, 0, 3, 0], "radius_mm": 1.0}, "at least one on the beta arm"),
    ],
)
def test_parts_that_make_no_sense_are_refused(part, words):
    data = DESI.model_dump(mode="json")
    data["bodies"]["parts"] = [part]
    with pytest.raises(InputError, match=words):
        parse_instrument(data, "test")


def test_alpha_arms_that_reach_each_other_are_refused():
    data = DESI.model_dump(mode="json")
    data["bodies"]["parts"][1] = {"arm": "alpha", "capsule_mm": [0, 0, 4.3, 0], "radius_mm": 1.0}
    with pytest.raises(InputError, match=r"reaches 5.3 mm from its axis; at most half of layout.pitch_mm"):
        parse_instrument(data, "test")
