"""Groups of moves: who unfolds first, and who cannot."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.drive.steppers.drive import CLOCK
from fiberloom.drive.steppers.groups import Unfolding, grouped
from fiberloom.drive.steppers.ways import ArmWays
from fiberloom.planning import Plan, Trajectory, verify

PLANE = fl.FocalPlane.of("moons", seed=0, n=2)
EAST = np.array([True, True])


def towards(row, plane=PLANE):
    """Alpha at which the arm of one of two positioners points at the other."""
    way = plane.centres_mm[1 - row] - plane.centres_mm[row]
    alpha = np.rad2deg(np.arctan2(way[1], way[0]) - plane.alpha_off_rad[row])
    return (alpha + 180.0) % 360.0 - 180.0


def unfolding(goals):
    return Unfolding(ArmWays(PLANE), np.array(goals), EAST, 180.0).ordered()


def unfolded_in_turn(goals, groups):
    """The plan in which groups unfold one after the other, 10 s each."""
    robots = []
    for row, (alpha, beta) in enumerate(goals):
        turn = next((k for k, group in enumerate(groups) if row in group), None)
        time_s = [0.0] if turn is None else [0.0, 10.0 * turn, 10.0 * turn + 10.0][int(turn == 0) :]
        beta_deg = [180.0] * (len(time_s) - 1) + [180.0 if turn is None else beta]
        alphas = np.full(len(time_s), alpha)
        time_s = np.array(time_s) - time_s[0]
        robots.append(Trajectory(int(PLANE.positioner_id[row]), time_s, alphas, np.array(beta_deg)))
    return Plan("moons", PLANE.collision_buffer_mm, tuple(robots))


def test_the_order_is_what_the_verifier_proves_and_the_reverse_often_is_not():
    """The verifier is other code: it knows nothing of who goes first."""
    rng, wrong, kept = np.random.default_rng(1), 0, 0
    for _ in range(120):
        alpha = np.array([towards(0), towards(1)]) + rng.uniform(-90.0, 90.0, 2)
        goals = np.column_stack([alpha, rng.uniform(20.0, 300.0, 2)])
        groups, why = unfolding(goals)
        if why or len(groups) < 2:
            continue
        there = unfolded_in_turn(goals, [group.tolist() for group in groups])
        assert not verify(PLANE, there, limits=CLOCK).collisions
        back = unfolded_in_turn(goals, [group.tolist() for group in groups[::-1]])
        wrong += bool(verify(PLANE, back, limits=CLOCK).collisions)
        kept += 1
    assert kept > 30
    assert wrong > 1


def test_two_that_reach_through_each_other_cannot_both():
    groups, why = unfolding([[towards(0), 10.0], [towards(1), 10.0]])
    assert len(why) + sum(map(len, groups)) == 2
    assert len(why) >= 1


def test_no_group_has_neighbours_and_stages_come_to_the_goals():
    plane = fl.FocalPlane.of("megara", seed=0, n=30)
    rng = np.random.default_rng(0)
    goal = np.column_stack([rng.uniform(-360.0, 0.0, 30), rng.uniform(-175.0, -120.0, 30)])
    here = np.column_stack([rng.uniform(-360.0, 0.0, 30), rng.uniform(-175.0, -120.0, 30)])
    made = grouped(plane, here, goal, np.ones(30, dtype=bool))
    assert not made.refused
    assert np.array_equal(made.stages[-1][1], goal)
    near = {tuple(pair) for pair in plane.neighbour_pairs().tolist()}
    before = here
    for rows, after in made.stages:
        turned = np.abs(after - before).max(axis=0)
        assert min(turned) == 0.0  # one axis at a time
        if turned[1] > 0.0:
            own = set(rows.tolist())
            assert not any(i in own and j in own for i, j in near)
        before = after


def test_a_standing_arm_in_the_way_is_named():
    goal = np.array([[towards(0), 10.0], [towards(1), 10.0]])
    here = np.array([[towards(0), 180.0], [towards(1), 10.0]])
    made = grouped(PLANE, here, np.where([[True], [False]], goal, here), np.array([True, False]))
    assert made.refused == {
        0: f"positioner {PLANE.positioner_id[1]}, which does not move, is in its way; it stays where it is"
    }


@pytest.mark.parametrize("others_deg", [[0.0, 180.0], [90.0, 180.0]])
def test_ways_are_looked_at_between_their_ends(others_deg):
    """An arm that swings over its neighbour's centre and stops behind it touches it on the way."""
    alpha = towards(0)
    corners = np.array([[[alpha - 60.0, 0.0], [alpha + 60.0, 0.0]]])
    ways, one, two = ArmWays(PLANE), np.array([0]), np.array([1])
    assert ways.hits(one, corners, two, np.array([others_deg])).all()
    for end in (0, 1):
        standing = corners[:, [end, end]]
        assert not ways.hits(one, standing, two, np.array([others_deg])).any()
