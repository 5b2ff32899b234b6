"""Moves in stages: nobody meets anybody while it rotates, turns are kept, and who finds none is named."""

from dataclasses import replace

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.drive.desi.clock import TICK_HZ, degrees_of
from fiberloom.drive.desi.paths import executed_path
from fiberloom.drive.desi.resolve import MOST_TURNS, Resolver, proven
from fiberloom.drive.desi.safe import safe_phi_deg
from fiberloom.drive.desi.stages import STAGES, Aims, Level, MoveStage, plan_of, staged, timed
from fiberloom.planning import Plan, Trajectory

N = 80
SWINGING = (1, 21)
"""Seeds of fields in which an arm sweeps over another one on its way, in either order."""


@pytest.fixture(scope="module")
def plane():
    return fl.FocalPlane.of("desi", seed=0, n=N)


def standing(plane, angles):
    robots = [
        Trajectory(int(number), np.zeros(1), at[:1], at[1:])
        for number, at in zip(plane.positioner_id, angles, strict=True)
    ]
    return Plan("desi", plane.collision_buffer_mm, tuple(robots), {}, {})


def test_retracted_arms_may_have_any_theta(plane):
    safe, rng = safe_phi_deg(plane), np.random.default_rng(0)

    def contacts(phi):
        theta = rng.uniform(-190.0, 190.0, N)
        found = fl.verify(plane, standing(plane, np.column_stack([theta, np.minimum(phi, 180.0)])))
        return sum(v.other.isdigit() for v in found.contacts)

    assert sum(contacts(safe) for _ in range(20)) == 0
    assert sum(contacts(rng.uniform(safe, 180.0)) for _ in range(20)) == 0
    # and the limit is not there for nothing
    assert sum(contacts(safe - 40.0) for _ in range(20)) > 0


def drawn(plane, seed):
    rng = np.random.default_rng(seed)
    here = np.column_stack([rng.uniform(-150, 150, N), rng.uniform(60, 180, N)])
    goal = np.column_stack([rng.uniform(-150, 150, N), rng.uniform(10, 180, N)])
    return here, goal - here


def test_stages_count_the_whole_way_and_come_one_after_another(plane):
    here, way = drawn(plane, 1)
    move = staged(plane, here, way, safe_phi_deg(plane), small=False)
    move = replace(move, turn=np.random.default_rng(2).integers(0, MOST_TURNS, move.turn.shape))
    made = timed(move)
    counted = degrees_of(made.tables.way_tenths.sum(axis=1))
    np.testing.assert_allclose(counted, way, atol=1e-3)
    # stage by stage, turn by turn, all others wait
    spans = [
        (int(made.begin_tick[k, s]), int(made.end_tick[k, s]), int(move.turn[k, s]))
        for s in range(STAGES)
        for k in range(N)
        if made.end_tick[k, s] > made.begin_tick[k, s]
    ]
    order = [(s, t) for s in range(STAGES) for t in range(MOST_TURNS)]
    ends = -1
    for stage, turn in order:
        mine = [
            (made.begin_tick[k, stage], made.end_tick[k, stage])
            for k in range(N)
            if move.turn[k, stage] == turn and made.end_tick[k, stage] > made.begin_tick[k, stage]
        ]
        if mine:
            assert min(b for b, _ in mine) > ends
            ends = max(e for _, e in mine)
            # pauses are whole milliseconds: all begin within one
            assert max(b for b, _ in mine) - min(b for b, _ in mine) <= 18
    assert len(spans) > 2 * N


def test_what_a_unit_is_said_to_do_is_what_its_path_does(plane):
    here, way = drawn(plane, 3)
    made = timed(staged(plane, here, way, safe_phi_deg(plane), small=False))
    path = executed_path(made.tables)
    for k in range(0, N, 7):
        for stage, axis in ((MoveStage.RETRACT, 1), (MoveStage.ROTATE, 0), (MoveStage.EXTEND, 1)):
            begin, end = made.begin_tick[k, stage], made.end_tick[k, stage]
            if end == begin:
                continue
            at = path.at(np.array([begin - 2, begin, begin + 0.5 * (end - begin), end]))[k, :, axis]
            assert at[0] == at[1]
            assert at[2] != at[1]
            assert made.active(k, (begin + end) / 2 / TICK_HZ) == stage


def test_one_that_swings_extends_beside_its_goal_and_ends_there_all_the_same(plane):
    here, way = drawn(plane, 3)
    move = staged(plane, here, way, safe_phi_deg(plane), small=False)
    swung = move.swung(5, 40.0).swung(5, -20.0)  # the last one counts
    made = timed(swung)
    np.testing.assert_array_equal(
        made.tables.way_tenths.sum(axis=1), timed(move).tables.way_tenths.sum(axis=1)
    )
    path = executed_path(made.tables)
    extend = made.begin_tick[5, MoveStage.EXTEND] + np.arange(2) * (
        made.end_tick[5, MoveStage.EXTEND] - made.begin_tick[5, MoveStage.EXTEND]
    )
    theta = degrees_of(path.at(extend)[5, :, 0])
    np.testing.assert_allclose(theta, way[5, 0] - 20.0, atol=0.02)
    assert made.active(5, (made.begin_tick[5, MoveStage.SWING] + 5) / TICK_HZ) == MoveStage.SWING
    # the others have no such stage
    others = np.arange(N) != 5
    np.testing.assert_array_equal(made.begin_tick[others, 3], made.end_tick[others, 3])


def test_swings_let_more_arrive(plane, monkeypatch):
    """Of goals that touch nobody, drawn without a look at the ways to them."""
    from fiberloom.drive.desi import resolve
    from fiberloom.drive.port import with_tube
    from fiberloom.targets.generate import random_targets

    here, thick, refused = plane.park_deg, with_tube(plane, np.full(N, 0.12)), []
    goals = [fl.assign(thick, random_targets(plane, 4 * N, seed=s), seed=s).goal_deg for s in SWINGING]
    for swings in (resolve.SWINGS_DEG, np.empty(0)):
        monkeypatch.setattr(resolve, "SWINGS_DEG", swings)
        moves = [staged(plane, here, goal - here, safe_phi_deg(thick), small=False) for goal in goals]
        found = [Resolver(thick, m, lambda m: Aims(here, np.zeros((N, 2)))).resolve() for m in moves]
        assert all(proven(thick, (f.plan, f.loose)).ok for f in found)
        refused.append(sum(len(f.plan.refused) for f in found))
    assert refused[0] < refused[1]


def test_a_shortened_move_ends_before_the_stage_that_it_lacks(plane):
    here, way = drawn(plane, 4)
    safe = safe_phi_deg(plane)
    move = staged(plane, here, way, safe, small=False)
    for level, ends in (
        (Level.NOT_EXTENDED, lambda: np.column_stack([way[:, 0], np.maximum(here + way, 0)[:, 1]])),
        (Level.STILL, lambda: np.zeros((N, 2))),
    ):
        less = replace(move, level=np.full(N, int(level)))
        counted = degrees_of(less.reduced.sum(axis=1))
        if level == Level.STILL:
            assert not counted.any()
            assert timed(less).tables.rows.max() == 0
        else:
            np.testing.assert_allclose(counted[:, 0], ends()[:, 0], atol=1e-3)
            phi = here[:, 1] + counted[:, 1]
            np.testing.assert_allclose(phi, np.maximum((here + way)[:, 1], safe), atol=1e-3)


@pytest.fixture(scope="module")
def resolved(plane):
    """A field of goals that do not touch, from folded."""
    from fiberloom.targets.generate import random_targets

    assigned = fl.assign(plane, random_targets(plane, 3 * N, seed=2), seed=2)
    here = plane.park_deg
    move = staged(plane, here, assigned.goal_deg - here, safe_phi_deg(plane), small=False)
    return assigned, move, Resolver(plane, move, lambda m: Aims(here, np.zeros((N, 2)))).resolve()


def test_a_resolved_move_is_proven_and_ends_at_its_goals(plane, resolved):
    assigned, _, found = resolved
    assert proven(plane, (found.plan, found.loose)).ok
    ends = found.plan.end_deg
    arrives = ~np.isin(plane.positioner_id, list(found.plan.refused))
    assert arrives.sum() >= N - 2
    np.testing.assert_allclose(ends[arrives], assigned.goal_deg[arrives], atol=1e-3)


def test_crowded_ways_are_put_into_turns_or_refused_by_name(plane):
    """Goals drawn without a look at neighbours: many touch; what is left is proven, the others are named."""
    here, rng = plane.park_deg, np.random.default_rng(5)
    goal = np.column_stack([rng.uniform(-150, 150, N), rng.uniform(0, 60, N)])
    move = staged(plane, here, goal - here, safe_phi_deg(plane), small=False)
    first = proven(plane, [plan_of(plane, timed(move), Aims(here, np.zeros((N, 2))))])
    assert len(first.collisions) > 5
    found = Resolver(plane, move, lambda m: Aims(here, np.zeros((N, 2)))).resolve()
    assert proven(plane, (found.plan, found.loose)).ok
    assert 0 < len(found.plan.refused) < N // 2
    for number, why in found.plan.refused.items():
        assert why.startswith(f"positioner {number}: it would meet")


def test_a_small_move_goes_straight(plane):
    here, _ = drawn(plane, 6)
    way = np.random.default_rng(0).uniform(-0.5, 0.5, (N, 2))
    made = timed(staged(plane, here, way, safe_phi_deg(plane), small=True))
    # 0.5 deg by creep, and 3 deg out and back
    assert made.tables.duration_s.max() < 0.187 + 2 * 1.125 + 0.02


def test_play_holds_arms_back_against_their_final_direction_and_not_at_the_end(plane):
    here, way = drawn(plane, 8)
    made = timed(staged(plane, here, way, safe_phi_deg(plane), small=False))
    tight, loose = (plan_of(plane, made, Aims(here, np.zeros((N, 2))), play) for play in ((0, 0), (2.0, 1.0)))
    np.testing.assert_allclose(tight.end_deg, loose.end_deg, atol=1e-9)
    time = np.linspace(0.0, float(tight.duration_s), 400)
    off = np.stack([b.at(time) - a.at(time) for a, b in zip(tight.robots, loose.robots, strict=True)])
    # theta ends downwards, so upwards it is late, below its count; phi the other way round
    # times are rounded to 1 us, at 176 deg/s
    assert -2.0 - 5e-4 < off[..., 0].min() < -1.9
    assert 0.9 < off[..., 1].max() < 1.0 + 5e-4
    # a corner within a leg is met to a quarter of the leg between corners
    assert off[..., 0].max() < 0.3
    assert off[..., 1].min() > -0.3


def test_wider_arms_fold_farther(plane):
    from fiberloom.drive.port import with_tube

    safe, wider = safe_phi_deg(plane), safe_phi_deg(with_tube(plane, np.full(N, 0.15)))
    assert np.all(wider >= safe)
    # a point of phi goes in by less than 4 mm a radian: 0.3 mm less on both sides are 4 deg at least
    assert np.median((wider - safe)[safe < 170.0]) > 4.0
