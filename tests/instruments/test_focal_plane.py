"""Kinematics over a plane, neighbours, names."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom.errors import InputError
from fiberloom.instruments import generate
from fiberloom.instruments.focal_plane import elbows_mm


def configuration(plane, seed):
    rng = np.random.default_rng(seed)
    low, high = plane.limits_deg.T
    return rng.uniform(low, high, (plane.n, 2)).T


@given(seed=st.integers(0, 10**6), fibre=st.sampled_from(["metrology", "BOSS", "APOGEE"]))
@settings(max_examples=20, deadline=None)
def test_a_fibre_at_a_solution_of_the_inverse_is_on_its_target(plane, seed, fibre):
    alpha, beta = configuration(plane, seed)
    xy = plane.forward(alpha, beta, fibre)
    found = plane.inverse(xy, fibre)
    has = plane.carries(fibre)
    np.testing.assert_array_equal(found.reachable, has)
    np.testing.assert_array_equal(np.isnan(xy).any(axis=1), ~has)
    back = plane.forward(found.alpha_deg, found.beta_deg, fibre)
    # near a straight arm the elbow moves with the square root of the rounding, the tip does not
    np.testing.assert_allclose(back[has], xy[has], atol=1e-10)
    low, high = plane.limits_deg.T
    angles = np.column_stack([found.alpha_deg, found.beta_deg])
    assert np.all((angles >= low) & (angles <= high))


def test_unreachable_targets_have_a_gap_and_no_nan(patch):
    centre = patch.centres_mm
    far = patch.inverse(centre + np.array([30.0, 0.0]), "BOSS")
    near = patch.inverse(centre + np.array([1.0, 0.0]), "BOSS")
    for found in (far, near):
        assert not found.reachable.any()
        assert np.all(found.alpha_deg == 0)
        assert np.all(found.beta_deg == 0)
    length = np.linalg.norm(patch.points["BOSS"], axis=1)
    l_alpha = patch.arms[:, 2]
    np.testing.assert_allclose(far.gap_mm, 30.0 - l_alpha - length, atol=1e-12)
    np.testing.assert_allclose(near.gap_mm, length - l_alpha - 1.0, atol=1e-12)


def test_a_missing_fibre_reaches_nothing(patch):
    found = patch.inverse(patch.centres_mm + np.array([15.0, 0.0]), "APOGEE")
    lacks = ~patch.carries("APOGEE")
    assert lacks.any()
    assert np.all(np.isinf(found.gap_mm[lacks]))
    assert not found.reachable[lacks].any()
    assert found.reachable[~lacks].all()


def test_jacobian_is_the_finite_difference(patch):
    alpha, beta = configuration(patch, 1)
    h = 1e-4
    for fibre in ("metrology", "BOSS"):
        columns = [
            (
                patch.forward(alpha + h * a, beta + h * b, fibre)
                - patch.forward(alpha - h * a, beta - h * b, fibre)
            )
            / (2 * h)
            for a, b in ((1, 0), (0, 1))
        ]
        # error of the central difference: h^2/6 of the third derivative, 22 mm (pi/180)^3 per deg^3
        jacobian = patch.jacobian(alpha, beta, fibre)
        np.testing.assert_allclose(jacobian, np.stack(columns, axis=2), atol=1e-9)


def test_index_selects_and_repeats(patch):
    xy = patch.forward([10.0, 20.0, 30.0], 90.0, index=[4, 4, 0])
    whole = [patch.forward(np.full(37, a), 90.0)[i] for a, i in ((10, 4), (20, 4), (30, 0))]
    np.testing.assert_array_equal(xy, whole)


def test_segments_lie_along_the_arm(patch):
    alpha, beta = configuration(patch, 2)
    segments = patch.beta_segments(alpha, beta)
    turn = np.exp(1j * (np.deg2rad(alpha) + patch.arms[:, 3]))
    elbow = patch.arms[:, 0] + 1j * patch.arms[:, 1] + patch.arms[:, 2] * turn
    tip = elbow + 14.7276 * turn * np.exp(1j * (np.deg2rad(beta) + patch.arms[:, 4]))
    expected = np.column_stack([elbow.real, elbow.imag, tip.real, tip.imag])
    np.testing.assert_allclose(segments, expected, atol=1e-11)


def test_neighbours_are_all_pairs_within_reach(plane):
    gap = np.linalg.norm(plane.centres_mm[:, None] - plane.centres_mm, axis=2)
    reach = plane.body_reach_mm
    near = np.argwhere(np.triu(gap < reach[:, None] + reach, 1))
    np.testing.assert_array_equal(plane.neighbour_pairs(), near)


def test_numbers_of_positioners(patch):
    ids = patch.positioner_id[[5, 0, 36]]
    np.testing.assert_array_equal(patch.index_of(ids), [5, 0, 36])
    assert patch.index_of(ids[0]) == 5
    with pytest.raises(InputError, match="positioner 9999: not in this focal plane of 37"):
        patch.index_of([int(ids[0]), 9999])


def test_unknown_fibre(patch):
    with pytest.raises(InputError, match="fibre 'SPARK': sdssv has metrology, BOSS, APOGEE"):
        patch.forward(0.0, 0.0, "SPARK")


def test_offline_positioners_stand_where_told(patch):
    who = patch.positioner_id[[3, 7]]
    off = patch.with_offline(who, [[100.0, 20.0], [200.0, 30.0]])
    np.testing.assert_array_equal(np.flatnonzero(off.offline), [3, 7])
    np.testing.assert_array_equal(off.offline_position_deg[7], [200.0, 30.0])
    assert not patch.offline.any()
    folded = patch.with_offline(who)
    np.testing.assert_array_equal(folded.offline_position_deg[3], [10.0, 170.0])


def test_the_hash_sees_every_number(patch):
    known = {patch.config_hash()}
    for name in ("arms", "fiducials", "guide_cameras", "offline_position_deg"):
        values = getattr(patch, name).copy()
        values.flat[-1] += 1e-6
        known.add(replace(patch, **{name: values}).config_hash())
    known.add(patch.with_offline(patch.positioner_id[:1]).config_hash())
    known.add(patch.select(np.arange(36)).config_hash())
    assert len(known) == 7


def test_the_camera_sees_the_science_fibre_where_there_is_no_other(sdssv):
    points = {"BOSS": sdssv.positioner.points["BOSS"]}
    positioner = sdssv.positioner.model_copy(update={"points": points})
    metrology = sdssv.metrology.model_copy(update={"sees": "BOSS"})
    plain = sdssv.model_copy(update={"positioner": positioner, "metrology": metrology})
    plane = generate(plain, 0, 7)
    np.testing.assert_array_equal(plane.points["metrology"], plane.points["BOSS"])


def test_shapes_are_checked(patch):
    with pytest.raises(InputError, match="offline has shape"):
        replace(patch, offline=np.zeros(3, dtype=bool))
    with pytest.raises(InputError, match="positioner_id must be unique"):
        replace(patch, positioner_id=np.ones(37, dtype=np.int64))


def test_the_elbow_is_where_the_fibre_turns_about(patch):
    alpha = np.linspace(0.0, 350.0, patch.n)
    elbow = patch.elbows_mm(alpha)
    assert elbow.shape == (patch.n, 2)
    for beta in (0.0, 77.0, 180.0):
        fibre = patch.forward(alpha, np.full(patch.n, beta))
        np.testing.assert_allclose(np.hypot(*(fibre - elbow).T), patch.l_beta_mm, atol=1e-12)
    np.testing.assert_allclose(np.hypot(*(elbow - patch.centres_mm).T), patch.l_alpha_mm, atol=1e-12)
    np.testing.assert_array_equal(
        patch.elbows_mm(45.0, [2, 0]), patch.elbows_mm(np.full(patch.n, 45.0))[[2, 0]]
    )
    many = elbows_mm(patch.arms, np.stack([alpha, alpha + 10.0], axis=1))
    assert many.shape == (patch.n, 2, 2)
    np.testing.assert_array_equal(many[:, :, 0], elbow)
    np.testing.assert_array_equal(many[:, :, 1], patch.elbows_mm(alpha + 10.0))


def test_columns_of_the_arms_have_names(patch):
    columns = [*patch.centres_mm.T, patch.l_alpha_mm, patch.alpha_off_rad, patch.beta_off_rad]
    np.testing.assert_array_equal(np.column_stack(columns), patch.arms)
    turn = patch.alpha_off_rad + patch.beta_off_rad + patch.metrology_phi_rad
    along = patch.forward(np.zeros(patch.n), np.zeros(patch.n)) - patch.elbows_mm(0.0)
    np.testing.assert_allclose(
        along, patch.l_beta_mm[:, None] * np.stack([np.cos(turn), np.sin(turn)], 1), atol=1e-9
    )
