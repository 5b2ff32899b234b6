"""Small moves in a crowd: one that cannot arrive stays, and sends no other a long way round."""

import numpy as np
import pytest

from fiberloom.planning import plan, plan_corrections, random_configuration, verify
from planning.fields import field, sampled_gaps

PLANE = field(100)
APART_DEG = 1.5
"""Enough for some goals to touch."""
MOVED_DEG = 1e-6


def moves(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts that touch nothing, and goals around them of which some do."""
    start_deg = random_configuration(PLANE, seed)
    off_deg = np.random.default_rng(seed).normal(0.0, APART_DEG, start_deg.shape)
    low, high = PLANE.limits_deg.T
    return start_deg, np.clip(start_deg + off_deg, low, high)


@pytest.mark.parametrize("seed", range(8))
def test_those_that_cannot_arrive_stay_and_all_others_arrive_soon(seed):
    start_deg, goal_deg = moves(seed)
    made = plan_corrections(PLANE, start_deg, goal_deg, seed=seed)
    stays = np.isin(PLANE.positioner_id, list(made.refused))
    reached_deg = np.where(stays[:, None], start_deg, goal_deg)
    assert np.abs(made.end_deg - reached_deg).max() < MOVED_DEG
    assert verify(PLANE, made, start_deg=start_deg, goal_deg=reached_deg).ok
    assert min(sampled_gaps(PLANE, made)) > -1e-6
    # nothing folds out of the way of others: a step or two, and the approach
    assert made.duration_s <= 2.0


def test_some_are_refused_and_the_slowest_is_faster_than_with_all_planned():
    made = [plan_corrections(PLANE, *moves(seed), seed=seed) for seed in range(8)]
    planned = [plan(PLANE, *moves(seed), seed=seed) for seed in range(8)]
    told = [why for one in made for why in one.refused.values()]
    slowest_s, planned_s = (max(one.duration_s for one in plans) for plans in (made, planned))
    print(f"\n{len(told)} of 800 stay; slowest {slowest_s:.1f} s, by `plan` {planned_s:.1f} s")
    assert 5 < len(told) < 80
    assert all("it stays" in why for why in told), told
    assert slowest_s < 0.5 * planned_s


def test_one_pair_that_touches_costs_no_other_its_move():
    """The goals of two touch; without them nothing is refused."""
    start_deg, goal_deg = moves(0)
    made = plan_corrections(PLANE, start_deg, goal_deg)
    rows = PLANE.index_of(list(made.refused))
    assert len(rows) > 0
    goal_deg[rows] = start_deg[rows]
    assert plan_corrections(PLANE, start_deg, goal_deg).refused == {}
