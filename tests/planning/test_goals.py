"""Goals that touch, against dense sampling in numpy; and what a planner without any effort gives up."""

import numpy as np
import pytest
from fields import _lines, _segments, _to_segment, field

from fiberloom._core import planning as core
from fiberloom.planning import PlanSettings, plan, random_pair, verify
from fiberloom.planning.obstacles import on_all_layers, plain_parts

RADIUS_MM = 2.0
APPROACH_DEG = 0.82
# between samples of the approach two arms move by less than this
SURE_MM = 0.02


def approach_lines(plane, row, goal_deg, samples=81):
    """Centre lines (samples, 4) from the beginning of the approach to the goal."""
    above = np.linspace(APPROACH_DEG, 0.0, samples)[:, None]
    return _lines(plane, row, goal_deg + above)


def drawn(seed, n=60):
    plane = field(n)
    rng = np.random.default_rng(seed)
    return plane, np.column_stack([rng.uniform(0, 360, n), rng.uniform(0, 180, n)])


def bodies_of(plane, discs=np.zeros((0, 3))):
    parts = plain_parts(plane.n, plane.beta_segment_mm, RADIUS_MM)
    return core.Bodies(plane.arms, parts, on_all_layers(discs[:, [0, 1, 0, 1, 2]]))


@pytest.mark.parametrize("seed", range(3))
def test_conflicts_are_the_pairs_that_touch_in_dense_samples(seed):
    plane, goal_deg = drawn(seed)
    lines = [approach_lines(plane, k, goal_deg[k]) for k in range(plane.n)]
    gaps = {
        (i, j): _segments(lines[i], lines[j]).min() - 2 * RADIUS_MM
        for i in range(plane.n)
        for j in range(i + 1, plane.n)
    }
    found = core.conflicts(bodies_of(plane), np.radians(goal_deg), np.radians(APPROACH_DEG))
    assert len(found) > 5
    assert [tuple(pair) for pair in found] == sorted(tuple(pair) for pair in found)
    told = {tuple(int(k) for k in pair) for pair in found}
    assert {pair for pair, gap in gaps.items() if gap < -SURE_MM} <= told
    assert told <= {pair for pair, gap in gaps.items() if gap < SURE_MM}


@pytest.mark.parametrize("seed", range(3))
def test_pairs_row_by_row_are_clear_where_the_conflicts_have_none(seed):
    plane, goal_deg = drawn(seed)
    goals, approach = np.radians(goal_deg), np.radians(APPROACH_DEG)
    pairs = plane.neighbour_pairs()
    bodies = bodies_of(plane)
    found = core.conflicts(bodies, goals, approach)
    told = {tuple(int(k) for k in pair) for pair in found}
    i, j = pairs.T
    clear = core.pairs_clear(bodies, i, goals[i], j, goals[j], approach)
    assert {tuple(int(k) for k in sorted(p)) for p in pairs[~clear]} == told


def test_obstacles_are_those_that_dense_samples_touch():
    plane, goal_deg = drawn(4)
    goals, approach = np.radians(goal_deg), np.radians(APPROACH_DEG)
    rng = np.random.default_rng(9)
    discs = np.column_stack([rng.uniform(-80, 80, (30, 2)), rng.uniform(0.5, 3.0, 30)])
    ok = core.static_ok(bodies_of(plane, discs), np.arange(plane.n), goals, approach)
    gaps = np.array(
        [
            min(
                _to_segment(disc[:2], approach_lines(plane, k, goal_deg[k])).min() - disc[2] for disc in discs
            )
            for k in range(plane.n)
        ]
    )
    gaps -= RADIUS_MM
    assert 5 < ok.sum() < plane.n - 5
    assert not ok[gaps < -SURE_MM].any()
    assert ok[gaps > SURE_MM].all()


@pytest.mark.parametrize("seed", range(2))
def test_without_effort_those_in_conflict_are_given_up_and_the_rest_arrives(seed):
    plane = field(60)
    start_deg, goal_deg = random_pair(plane, seed)
    made = plan(plane, start_deg, goal_deg, settings=PlanSettings(effort=0.0), seed=seed)
    assert any("no way past its neighbours was found (positioner" in why for why in made.refused.values())
    assert len(made.refused) < plane.n / 2
    assert verify(plane, made, start_deg=start_deg, approach_deg=APPROACH_DEG).ok
    arrives = ~np.isin(plane.positioner_id, list(made.refused))
    np.testing.assert_allclose(made.end_deg[arrives], goal_deg[arrives], atol=1e-8)
