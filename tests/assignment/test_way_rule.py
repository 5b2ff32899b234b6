"""Targets that a drive rules out: none behind a dot, none whose way bars that of another."""

import sys
from pathlib import Path

import numpy as np

from fiberloom.assignment import AssignSettings, assign
from fiberloom.assignment.candidates import Block
from fiberloom.drive.piezo.cobras import CobraArms, stops_deg
from fiberloom.drive.way_rules import way_rule
from fiberloom.instruments import FocalPlane
from fiberloom.targets.generate import random_targets

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from support.cobras import pfs_plane

PLANE = pfs_plane(114)
TARGETS = random_targets(PLANE, 300, seed=2)


def arms_on_their_ways(assigned):
    """Arms (n, K, 4) in mm in K poses of phi from folded to the goals; (n,) which have one."""
    arms, low = CobraArms.of(PLANE), stops_deg(PLANE)[0]
    goal = assigned.goal_deg - low
    poses = [np.column_stack([goal[:, 0], share * goal[:, 1]]) for share in np.linspace(0.0, 1.0, 40)]
    return np.stack([arms.segments_mm(pose) for pose in poses], axis=1), assigned.target >= 0


def crossings(assigned):
    """Pairs of cobras with targets of which arms on their ways come nearer than they are wide."""
    from fiberloom._core.geometry import segment_distance

    ways, has = arms_on_their_ways(assigned)
    found = 0
    for i, j in PLANE.neighbour_pairs().tolist():
        if has[i] and has[j]:
            one, two = np.repeat(ways[i], 40, axis=0), np.tile(ways[j], (40, 1))
            found += segment_distance(one, two).min() < 2.0 * PLANE.collision_buffer_mm
    return found


def test_ways_out_do_not_cross_and_hardly_a_target_is_lost():
    free = assign(PLANE, TARGETS, settings=AssignSettings(ways=way_rule(PLANE)))
    any_ = assign(PLANE, TARGETS)
    assert crossings(any_) == 3
    assert crossings(free) == 0
    assert free.n_assigned >= any_.n_assigned - 4


def barred_by_parked(assigned):
    """Pairs of which the first, on its way to 6 deg beyond its target, comes too near the second, parked."""
    from fiberloom._core.geometry import segment_distance

    arms, low, has = CobraArms.of(PLANE), stops_deg(PLANE)[0], assigned.target >= 0
    goal = assigned.goal_deg - low
    beyond = np.minimum(goal[:, 1] + 6.0, arms.range_deg[:, 1])
    ways = [
        arms.segments_mm(np.column_stack([goal[:, 0], share * beyond])) for share in np.linspace(0.0, 1.0, 60)
    ]
    parked, pairs = arms.segments_mm(goal), PLANE.neighbour_pairs()
    return [
        (i, j)
        for i, j in np.vstack([pairs, pairs[:, ::-1]]).tolist()
        if has[i] and not has[j]
        if min(segment_distance(way[[i]], parked[[j]])[0] for way in ways) < 2.0 * PLANE.collision_buffer_mm
    ]


def test_the_parked_do_not_bar_ways(monkeypatch):
    """Where they are folded as the instrument says an elbow stands in a neighbour's way; so it is turned."""
    targets, ways = random_targets(PLANE, 150, seed=0), AssignSettings(ways=way_rule(PLANE))
    found = assign(PLANE, targets, settings=ways)
    assert barred_by_parked(found) == []
    monkeypatch.setattr(
        "fiberloom.assignment.park._barring", lambda p, row, goals, near, w: np.zeros((len(goals), len(near)))
    )
    before = assign(PLANE, targets, settings=ways)
    assert barred_by_parked(before) == [(76, 75)]
    assert before.n_assigned == found.n_assigned


def test_an_arm_that_stands_in_a_territory_bars_the_turns_past_it():
    """Left out by its calibration where it stood out : a neighbour was to turn past it (seed 3)."""
    i, j = PLANE.neighbour_pairs()[0]
    arms, low = CobraArms.of(PLANE), stops_deg(PLANE)[0]
    towards = arms.centre_mm[i] - arms.centre_mm[j]
    at = arms.centre_mm[j] + 4.7 * towards / np.hypot(*towards)
    out = arms.angles_deg(np.tile(at, (len(PLANE), 1)), np.zeros((len(PLANE), 2)))
    standing = PLANE.with_offline([PLANE.positioner_id[j]], (out + low)[[j]])
    # where the first link of i points at j
    there = (np.degrees(np.arctan2(*-towards[::-1])) - arms.zero_deg[i, 0]) % 360.0
    goal = low[i] + np.array([[0.3 * there, 10.0], [there + 100.0, 10.0]])
    assert 60.0 < there < 250.0
    rows = np.array([i, i])
    assert way_rule(PLANE).blocks(rows, goal).tolist() == [Block.NONE, Block.NONE]
    assert way_rule(standing).blocks(rows, goal).tolist() == [Block.NONE, Block.POCKET]


def test_a_motor_that_scatters_gets_more_room_beyond_its_target():
    """No room beyond a cobra that goes out: one of phi 0.5 has 30 deg, and meets what it would not else."""
    scatter = np.full((len(PLANE), 2), 0.05)
    wild, unknown = scatter.copy(), np.full_like(scatter, np.nan)
    wild[:, 1] = 0.5
    goal = np.column_stack([np.linspace(0.0, 350.0, len(PLANE)), np.full(len(PLANE), -60.0)])
    pairs, rows = PLANE.neighbour_pairs(), np.arange(len(PLANE))
    found = [
        int(way_rule(PLANE, how).crossing(rows, goal, *pairs.T).sum())
        for how in (None, unknown, scatter, wild)
    ]
    assert found[0] == found[1] == found[2]
    assert found[3] > found[0]


def test_no_target_is_behind_a_dot():
    assigned = assign(PLANE, TARGETS, settings=AssignSettings(ways=way_rule(PLANE)))
    has = assigned.target >= 0
    at = PLANE.forward(*assigned.goal_deg.T)
    gap = np.hypot(*(at - PLANE.dots_mm[:, :2]).T) - PLANE.dots_mm[:, 2]
    assert np.all(gap[has] > 0.0)


def test_a_cobra_that_does_not_move_bars_the_ways_over_it():
    """One that stands stretched towards a neighbour: that one gets no target beyond it."""
    i, j = PLANE.neighbour_pairs()[0]
    towards = PLANE.centres_mm[j] - PLANE.centres_mm[i]
    at = PLANE.centres_mm[i] + 4.5 * towards / np.hypot(*towards)
    stands = PLANE.inverse(np.where(np.arange(len(PLANE))[:, None] == i, at, PLANE.centres_mm + 1.0))
    angles = np.column_stack([stands.alpha_deg, stands.beta_deg])[[i]]
    still = PLANE.with_offline([int(PLANE.positioner_id[i])], angles)
    rule = way_rule(still)
    goal = np.column_stack([np.linspace(0.0, 360.0, 73), np.full(73, -40.0)])
    barred = rule.blocks(np.full(73, j), goal) == Block.POCKET
    assert barred.any()
    assert not barred.all()
    assert (way_rule(PLANE).blocks(np.full(73, j), goal)[barred] == Block.NONE).any()


def test_other_instruments_ask_nothing():
    assert way_rule(FocalPlane.of("sdssv", n=7)) is None
