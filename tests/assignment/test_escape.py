"""Pockets between fiducials: places that are free but cannot be left."""

import numpy as np
import pytest
from scipy.ndimage import label

from fiberloom.assignment.clearance import obstacle_gap_mm, obstacles, sweep
from fiberloom.assignment.escape import Escape, connected
from fiberloom.instruments import generate


@pytest.fixture(scope="module")
def walled(sdssv):
    """A positioner inside a ring of posts with one gap: what is beyond it cannot be reached."""
    plane = generate(sdssv, 0, 1)
    angle = np.deg2rad(np.arange(0, 360, 15.0))
    posts = plane.centres_mm[0] + 15.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    object.__setattr__(plane, "fiducials", np.column_stack([posts, np.full(24, 0.5)]))
    return plane


def test_behind_the_ring_is_a_pocket(walled):
    escape = Escape(walled, obstacles(walled, 0.0))
    # between two posts 3.9 mm apart there is no room for an arm of 4 mm: nothing gets out
    goals = np.array([[50.0, 175.0], [200.0, 170.0]])
    rows = np.zeros(2, dtype=np.int64)
    assert escape.can_fold(rows, goals).all()
    stretched = np.array([[a, 10.0] for a in np.arange(0.0, 360.0, 10.0)])
    assert not escape.can_fold(np.zeros(36, dtype=np.int64), stretched).any()


def test_straight_folds_are_a_part_of_the_flood(plane):
    rng = np.random.default_rng(0)
    bodies = obstacles(plane, 0.2)
    row = int(np.argmin(np.linalg.norm(plane.centres_mm - plane.fiducials[20, :2], axis=1)))
    goals = rng.uniform(*plane.limits_deg.T, (400, 2))
    rows = np.full(400, row)
    gap = obstacle_gap_mm(plane, rows, sweep(plane, rows, goals, 0.82), bodies)
    goals, rows = goals[gap > 0.3], rows[gap > 0.3]
    escape = Escape(plane, bodies)
    straight = escape.folds_straight(rows, goals)
    flooded = escape.flooded(row, goals)
    assert 0 < straight.sum() < len(rows)
    # a goal beside a body may round to a cell that is not free; those away from it may not
    assert np.all(flooded[straight])
    np.testing.assert_array_equal(escape.can_fold(rows, goals), straight | flooded)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.9, 1.0])
def test_regions_hang_together_along_the_axes(share):
    free = np.random.default_rng(3).random((121, 61)) < share
    regions, (labels, count) = connected(free), label(free)
    np.testing.assert_array_equal(regions > 0, free)
    pairs = set(zip(regions[free].tolist(), labels[free].tolist(), strict=True))
    assert len(pairs) == count == len(set(regions[free].tolist()))
