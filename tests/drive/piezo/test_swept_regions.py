"""Swept regions against a dense search, and the stages that are chosen by them."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fiberloom._core.geometry import segment_distance
from fiberloom.drive.piezo.cobras import CobraArms
from fiberloom.drive.piezo.stages import PHI, THETA, CobraStage, Stages
from fiberloom.drive.piezo.swept import SweptCheck, box_of

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from support.cobras import pfs_plane

PLANE = pfs_plane(114)
ARMS = CobraArms.of(PLANE)
N = len(ARMS)


def motors_at(place_deg, share=0.2, sigma_deg=0.1):
    """Motors whose moves end within a share of their way."""
    variance = np.full(2 * N, sigma_deg**2)
    return SimpleNamespace(
        place_deg=place_deg.ravel(),
        place_variance=variance,
        aimed_deg=lambda way: way / (1.0 + share**2),
        limited_deg=lambda way: np.clip(way, -200.0, 200.0),
        tube_deg=lambda way, sigmas: sigmas * np.sqrt(variance + (share * way) ** 2),
    )


def poses_in(box, rng, count):
    return box[:, 0] + rng.random((count, 2)) * (box[:, 1] - box[:, 0])


def test_boxes_meet_where_a_dense_search_finds_it():
    rng = np.random.default_rng(1)
    check = SweptCheck.of(ARMS, PLANE.fiducials[:0])
    low = np.column_stack([rng.uniform(0.0, 300.0, N), rng.uniform(0.0, 150.0, N)])
    boxes = box_of(low, low + rng.uniform(0.0, 60.0, (N, 2)))
    said = check.meeting(boxes[:, None], boxes[:, None])
    wrong = 0
    for (i, j), meets in zip(check.pairs.tolist(), said.tolist(), strict=True):
        first, second = poses_in(boxes[i], rng, 500), poses_in(boxes[j], rng, 500)
        gap = segment_distance(
            ARMS.segments_mm(first, np.full(500, i)), ARMS.segments_mm(second, np.full(500, j))
        )
        found = bool((gap < 2.0).any())
        assert meets or not found, (i, j)  # what is found is said
        wrong += meets and not found and gap.min() > 2.2
    assert said.sum() > 20
    assert wrong < 0.05 * said.sum()


def test_poses_that_do_not_touch_do_not_meet():
    angle = np.column_stack([np.full(N, 40.0), np.full(N, 5.0)])
    check = SweptCheck.of(ARMS, PLANE.fiducials[:0])
    assert not check.meeting(box_of(angle, angle)[:, None], box_of(angle, angle)[:, None]).any()
    # stretched arms of all directions do
    out = np.column_stack([np.linspace(0.0, 360.0, N), np.full(N, 179.5)])
    assert check.meeting(box_of(out, out)[:, None], box_of(out, out)[:, None]).any()


def test_whatever_theta_does_arms_in_their_territory_do_not_meet():
    stages = Stages.of(ARMS, PLANE.fiducials)
    boxes = np.zeros((N, 1, 2, 2))
    boxes[:, 0, THETA] = [0.0, 380.0]
    boxes[:, 0, PHI, 1] = stages.phi_in_deg
    assert not stages.check.meeting(boxes, boxes).any()
    boxes[:, 0, PHI, 1] += 15.0
    assert stages.check.meeting(boxes, boxes).any()


def chosen_from(place, goal, active=None, share=0.2):
    stages = Stages.of(ARMS, PLANE.fiducials, dots_mm=PLANE.dots_mm)
    return stages, stages.choose(
        motors_at(place, share), goal, np.ones(N, dtype=bool) if active is None else active
    )


def drawn(seed):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(10.0, 360.0, N), rng.uniform(20.0, 170.0, N)])


def folded(seed):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(10.0, 360.0, N), rng.uniform(5.0, 50.0, N)])


@pytest.mark.parametrize("seed", range(4))
def test_what_is_chosen_cannot_meet(seed):
    stages, chosen = chosen_from(folded(seed), drawn(seed + 100))
    moves = np.append(chosen.stage != CobraStage.STAY, np.zeros(len(PLANE.fiducials), dtype=bool))
    pairs = np.flatnonzero(moves[stages.check.pairs].any(axis=1))
    assert not stages.check.meeting(chosen.boxes_deg, chosen.boxes_deg, pairs).any()
    assert (chosen.stage != CobraStage.STAY).sum() > 0.9 * N


def test_poses_of_boxes_hold_the_ways_of_both_orders():
    """A pose of the L-shaped way, at any time and within its tube, is in one of the boxes."""
    place, goal = folded(2), drawn(7)
    _, chosen = chosen_from(place, goal)
    rng = np.random.default_rng(0)
    for _ in range(50):
        miss = 1.0 + 0.2 * rng.uniform(-2.9, 2.9, (N, 2))
        end = np.clip(place + (chosen.target_deg - place) * miss, 0.0, ARMS.range_deg)
        share = rng.random((N, 1))
        first_leg = rng.random(N) < 0.5
        at = place.copy()
        phi_first = chosen.phi_first
        for axis, first in ((THETA, ~phi_first), (PHI, phi_first)):
            moving = place[:, axis] + share[:, 0] * (end - place)[:, axis]
            now = np.where(first == first_leg, moving, np.where(first, end[:, axis], place[:, axis]))
            at[:, axis] = now
        inside = [
            np.all((at >= b[..., 0] - 1e-9) & (at <= b[..., 1] + 1e-9), axis=1)
            for b in chosen.boxes_deg.transpose(1, 0, 2, 3)
        ]
        moves = chosen.stage != CobraStage.STAY
        assert np.all((inside[0] | inside[1])[moves])


def test_who_does_not_move_stays():
    active = np.arange(N) % 2 == 0
    _, chosen = chosen_from(folded(3), drawn(4), active)
    assert np.all(chosen.stage[~active] == CobraStage.STAY)


def test_targets_that_touch_are_named():
    stages, angle = Stages.of(ARMS, PLANE.fiducials), folded(5)
    assert len(stages.touching(angle)) == 0
    i, j = stages.check.pairs[0]
    middle = 0.5 * (ARMS.centre_mm[i] + ARMS.centre_mm[j])
    at = ARMS.xy_mm(angle)
    at[[i, j]] = middle
    both = ARMS.angles_deg(at, angle)
    assert [i, j] in stages.touching(both).tolist()


def test_a_cobra_that_must_turn_far_does_so_in_its_territory():
    place, goal = folded(6), drawn(6)
    goal[:, THETA] = np.clip(place[:, THETA] + 170.0, 0.0, 370.0)
    stages, chosen = chosen_from(place, goal)
    turning = np.abs(goal - place)[:, THETA] > 120.0
    assert np.all(np.isin(chosen.stage[turning], [CobraStage.TURN, CobraStage.STAY]))
    turned = turning & (chosen.stage == CobraStage.TURN)
    assert np.all(chosen.boxes_deg[turned, :, PHI, 1] <= stages.phi_in_deg[turned, None] + 1e-6)


def test_a_turn_opens_phi_as_far_as_its_tube_stays_within_the_territory():
    """A folded fibre shows nothing of theta, and a motor that stands nothing of its gain."""
    place, goal = np.zeros((N, 2)), drawn(8)
    goal[:, PHI] = 150.0
    stages = Stages.of(ARMS, PLANE.fiducials)
    for share in (0.05, 0.2, 0.4):
        chosen = stages.choose(motors_at(place, share), goal, np.ones(N, dtype=bool))
        turns = chosen.stage == CobraStage.TURN
        top = chosen.boxes_deg[turns, 1, PHI, 1]
        assert turns.sum() > N / 2
        assert np.all(top <= stages.phi_in_deg[turns] + 1e-6)
        # target + 3.5 share target = most, but for the raster of phi
        assert np.all(chosen.target_deg[turns, PHI] > stages.phi_in_deg[turns] / (1.0 + 3.5 * share) - 13.0)


def test_of_two_that_could_meet_the_one_that_scatters_more_goes_first():
    """It needs more moves; chance decides between equals, anew each time."""
    stages, wild = Stages.of(ARMS, PLANE.fiducials), np.arange(N) % 3 == 0
    motors = motors_at(folded(1), np.repeat(np.where(wild, 0.4, 0.1), 2))
    ranks = [stages._rank(motors, seed) for seed in (1, 2)]
    for rank in ranks:
        assert sorted(rank) == list(range(N))
        assert rank[wild].max() < rank[~wild].min()
    assert (ranks[0] != ranks[1]).any()


@pytest.mark.parametrize(
    ("share", "left_deg", "most"), [(0.4, 120.0, None), (0.4, 15.0, 0.65), (0.02, 60.0, 0.65)]
)
def test_a_wild_motor_goes_as_far_as_its_tube_keeps_within_the_room_beyond_its_target(share, left_deg, most):
    """Quiet ones, and wild ones that are near, have the fixed share."""
    stages, left = Stages.of(ARMS, PLANE.fiducials), np.column_stack([np.zeros(N), np.full(N, left_deg)])
    motors = motors_at(folded(1), share, sigma_deg=1e-3)
    way = motors.aimed_deg(left)
    found = stages._shares(motors, left, way)[CobraStage.MOST]
    ends = found * way[:, PHI] * (1.0 + 3.5 * share)
    if most is None:
        np.testing.assert_allclose(ends, left_deg + 60.0 * share, atol=0.01)
    else:
        assert (found == most).all()
