"""Arms of cobras: angles and places are each other's inverse, and as the focal plane has them."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.drive.piezo.cobras import CobraArms

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from support.cobras import pfs_plane

PLANE = pfs_plane(57)
ARMS = CobraArms.of(PLANE)


def drawn(seed, low=3.0):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(low, 370.0, 57), rng.uniform(low, 176.0, 57)])


@given(seed=st.integers(0, 10_000))
def test_places_are_those_of_the_focal_plane(seed):
    angle = drawn(seed)
    expected = PLANE.forward(*ARMS.arm_deg(PLANE, angle).T)
    np.testing.assert_allclose(ARMS.xy_mm(angle), expected, atol=1e-9)


@given(seed=st.integers(0, 10_000))
def test_angles_come_back_with_their_turn(seed):
    angle = drawn(seed)
    near = angle + np.random.default_rng(seed).uniform(-100.0, 100.0, angle.shape)
    np.testing.assert_allclose(ARMS.angles_deg(ARMS.xy_mm(angle), near), angle, atol=1e-5)


def test_all_poses_put_the_fibre_where_it_is():
    angle = drawn(3)
    angle[:20, 1] = 183.0  # beyond stretched: two elbows
    angle[20:40, 0] = 8.0  # theta once more a turn farther
    at = ARMS.xy_mm(angle)
    poses = ARMS.poses_deg(at)
    for k in range(4):
        there = np.isfinite(poses[:, k]).all(axis=1)
        np.testing.assert_allclose(ARMS.xy_mm(poses[:, k])[there], at[there], atol=1e-9)
    count = np.isfinite(poses).all(axis=2).sum(axis=1)
    assert np.all(count[:40] >= 2)
    closest = np.nanmin(np.abs(poses - angle[:, None]).max(axis=2), axis=1)
    assert closest.max() < 1e-5


def test_errors_of_angles_by_finite_differences():
    angle, camera_um = drawn(5, low=30.0), 2.0
    angle[:, 1] = np.minimum(angle[:, 1], 160.0)  # beyond, an arm is nearly stretched: errors are not linear
    told = ARMS.sigma_deg(angle, camera_um)
    rng, found = np.random.default_rng(0), []
    for _ in range(600):
        seen = ARMS.xy_mm(angle) + 1e-3 * camera_um * rng.standard_normal((57, 2))
        found.append(ARMS.angles_deg(seen, angle))
    spread = np.std(found, axis=0)
    for axis in (0, 1):
        assert np.median(spread[:, axis] / told[:, axis]) == pytest.approx(1.0, abs=0.05)
        assert np.all(np.abs(spread[:, axis] / told[:, axis] - 1.0) < 0.2)  # 600 draws: 3 %, seven of these


def test_phi_within_a_reach():
    reach = np.full(57, 2.5)
    phi = ARMS.phi_within_deg(reach)
    np.testing.assert_allclose(ARMS.reach_mm(phi), reach, atol=1e-9)
    assert np.all(ARMS.reach_mm(phi - 5.0) < reach)


def test_the_jacobian_is_that_of_finite_differences():
    here, step_deg = 0.4 * ARMS.range_deg, 1e-4
    for axis in (0, 1):
        more = here + step_deg * (np.arange(2) == axis)
        by_steps = (ARMS.xy_mm(more) - ARMS.xy_mm(here)) / np.deg2rad(step_deg)
        assert np.abs(by_steps - ARMS.jacobian_mm(here)[:, :, axis]).max() < 1e-4
