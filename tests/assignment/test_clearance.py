"""Distances of arms against dense sampling."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom.assignment.clearance import (
    dip_mm,
    gaps_mm,
    obstacle_gap_mm,
    obstacles,
    places,
    point_segment_mm,
    segment_mm,
    sweep,
    too_near,
)
from fiberloom.instruments import FocalPlane

coordinate = st.floats(-10, 10)
segment = st.tuples(coordinate, coordinate, coordinate, coordinate)


def points_of(segment, n=200):
    t = np.linspace(0, 1, n)[:, None]
    return (1 - t) * np.array(segment[:2]) + t * np.array(segment[2:])


@given(segment, segment)
@settings(max_examples=100, deadline=None)
def test_distance_of_segments_is_that_of_their_points(a, b):
    found = float(segment_mm(np.array(a), np.array(b)))
    p, q = points_of(a), points_of(b)
    sampled = np.sqrt(((p[:, None] - q) ** 2).sum(axis=2)).min()
    # the samples are at most 20 sqrt(2) / 199 apart on each segment: half of both, at most
    assert sampled - 0.143 <= found <= sampled + 1e-9


@given(segment, segment)
def test_distance_does_not_depend_on_the_order(a, b):
    a, b = np.array(a), np.array(b)
    turned = a[[2, 3, 0, 1]]
    d = segment_mm(a, b)
    np.testing.assert_allclose([segment_mm(b, a), segment_mm(turned, b)], d, atol=1e-12)


@pytest.mark.parametrize(
    ("a", "b", "distance"),
    [
        ((0, 0, 2, 2), (0, 2, 2, 0), 0.0),
        ((0, 0, 0, 0), (3, 4, 3, 4), 5.0),
        ((0, 0, 0, 0), (-1, 1, 1, 1), 1.0),
        ((0, 0, 4, 0), (1, 1, 3, 1), 1.0),
        ((0, 0, 4, 0), (6, 0, 9, 0), 2.0),
        ((0, 0, 4, 0), (4, 0, 9, 3), 0.0),
    ],
)
def test_known_distances(a, b, distance):
    assert segment_mm(np.array(a, float), np.array(b, float)) == pytest.approx(distance, abs=1e-15)


def test_point_and_segment():
    assert point_segment_mm(np.array([1.0, 1.0]), np.array([0.0, 0, 2, 0])) == 1.0
    assert point_segment_mm(np.array([5.0, 4.0]), np.array([0.0, 0, 2, 0])) == 5.0


def random_places(plane, seed, approach_deg, n=1500):
    rng = np.random.default_rng(seed)
    rows = rng.integers(plane.n, size=n)
    goal = rng.uniform(*plane.limits_deg.T, (n, 2))
    return rows, goal, sweep(plane, rows, goal, approach_deg)


@pytest.mark.parametrize("approach_deg", [0.82, 3.0])
def test_nothing_comes_nearer_between_poses_than_the_dip(patch, approach_deg):
    rows, goal, segments = random_places(patch, 0, approach_deg)
    pairs = np.array([(i, j) for i in range(0, 1500, 2) for j in (i + 1,) if rows[i] != rows[j]])
    all_places = places(patch, rows, segments)
    at_poses = gaps_mm(all_places, pairs[:, 0], all_places, pairs[:, 1])
    dense = np.full(len(pairs), np.inf)
    steps = np.linspace(0, approach_deg, 15)
    ways = [patch.beta_segments(*(goal + s).T, index=rows) for s in steps]
    for first in ways:
        for second in ways:
            d = segment_mm(first[pairs[:, 0]], second[pairs[:, 1]])
            dense = np.minimum(dense, d - 2 * patch.collision_buffer_mm)
    # the bound is for arms at or beyond contact
    apart = dense > 0.0
    worst = (at_poses - dense)[apart].max()
    assert worst <= dip_mm(patch, approach_deg)
    # and the poses are really needed: the goal alone is off by more
    goal_only = segment_mm(segments[pairs[:, 0], 0, 0], segments[pairs[:, 1], 0, 0])
    goal_only -= 2 * patch.collision_buffer_mm
    assert (goal_only - dense).max() > dip_mm(patch, approach_deg)


@pytest.mark.parametrize("name", ["sdssv", "desi"])
@given(seed=st.integers(0, 1000), limit=st.floats(-3.0, 4.0))
@settings(max_examples=8, deadline=None)
def test_the_short_cut_gives_the_same_answer(name, seed, limit):
    plane = FocalPlane.of(name, n=19)
    rows, _, segments = random_places(plane, seed, 0.82, n=200)
    a, b = np.triu_indices(200, 1)
    all_places = places(plane, rows, segments)
    expected = gaps_mm(all_places, a, all_places, b) < limit
    np.testing.assert_array_equal(too_near(all_places, a, all_places, b, limit), expected)


def test_gap_to_fixed_bodies(patch):
    plane = patch.with_offline(patch.positioner_id[:3], [120.0, 10.0])
    bodies = obstacles(plane, margin_mm=0.2)
    assert len(bodies) == len(plane.fiducials) + 6 + 3
    rows, _, segments = random_places(plane, 4, 0.82, n=400)
    found = obstacle_gap_mm(plane, rows, segments, bodies)
    all_gaps = segment_mm(segments[:, :, 0, None], bodies[:, :4]).min(axis=1) - bodies[:, 4] - 2.0
    moving = ~plane.offline[rows]
    expected = all_gaps.min(axis=1)
    near = moving & (expected < 1.0)
    assert near.any()
    np.testing.assert_allclose(found[near], expected[near], atol=1e-12)
    # bodies far away are left out, an offline positioner does not hit itself
    assert np.all(found[moving & ~near] >= 1.0)
    assert np.all(np.isinf(found[~moving]))
    # an offline neighbour counts with its half of the margin
    assert bodies[-1, 4] == pytest.approx(2.1)
