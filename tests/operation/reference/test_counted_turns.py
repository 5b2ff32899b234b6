"""By how many motor turns counters are off, from what images show: by themselves, without a twin."""

import numpy as np
import pytest

from fiberloom.instruments import generate, load_instrument
from fiberloom.operation.reference.turns import TurnCounter, hypotheses, log_prior, told_apart_mm
from fiberloom.operation.safety.begin import TURNS

N = 61
PLANE = generate(load_instrument("sdssv"), 0, n_positioners=N)
TURN_DEG = 360.0 / 1024.0
UNFOLDED = [np.array([alpha, 90.0]) for alpha in (100.0, 215.0, 330.0)]
FOLDED = np.array([10.0, 170.0])


def images(turns, places, scatter_mm, seed=0):
    """A counter that has seen arms at these places, off by `turns` (N, 2), with errors of this size."""
    rng, counter = np.random.default_rng(seed), TurnCounter(PLANE)
    for place_deg in places:
        reported_deg = np.tile(place_deg, (N, 1))
        seen_mm = PLANE.forward(*(reported_deg + turns * TURN_DEG).T)
        counter.add(reported_deg, seen_mm + rng.normal(0.0, scatter_mm, (N, 2)))
    return counter


def some_off(of=7):
    """(N, 2) turns: one in `of` is off, by every number once and again."""
    turns = np.zeros((N, 2), dtype=int)
    ways = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, -1), (-2, 1), (5, 0), (0, -5), (3, 4)]
    for k, row in enumerate(range(0, N, of)):
        turns[row] = ways[k % len(ways)]
    return turns


def test_turns_are_told_of_unfolded_arms():
    """By 10 um, as calibrated maps miss: a turn of either motor moves these fibres by 0.09 mm."""
    turns = some_off()
    found = images(turns, UNFOLDED, 0.010).counted()
    assert found.proven.all()
    np.testing.assert_array_equal(found.turns, turns)
    assert found.scatter_mm == pytest.approx(0.010, rel=0.3)


def test_a_folded_arm_does_not_tell_two_turns_of_alpha_from_one_of_beta():
    turns = np.zeros((N, 2), dtype=int)
    turns[::7] = (-2, 1)
    assert not images(turns, [FOLDED], 0.015).counted().turns.any()
    np.testing.assert_array_equal(images(turns, [FOLDED, *UNFOLDED], 0.015).counted().turns, turns)


def test_without_light_or_with_a_layout_that_is_not_known_nothing_is_told():
    turns = some_off()
    dark = TurnCounter(PLANE)
    dark.add(np.tile(FOLDED, (N, 1)), np.full((N, 2), np.nan))
    assert not dark.counted().proven.any()
    assert not dark.counted().turns.any()
    # zeros known to 0.2 deg rms, as before a survey: most are within 0.1 mm of their place
    off = images(turns, [UNFOLDED[0]], 0.07).counted()
    assert not (off.proven & (off.turns != turns).any(axis=1)).any()
    assert (~off.proven).sum() > N / 2


def test_most_counters_have_to_be_right():
    """If most are off the scatter of the field grows, and nothing is told that is wrong."""
    turns = np.zeros((N, 2), dtype=int)
    turns[: 2 * N // 3] = (0, 1)
    found = images(turns, UNFOLDED, 0.015).counted()
    assert not (found.proven & (found.turns != turns).any(axis=1)).any()


def test_of_each_number_of_turns_there_is_one_and_the_prior_is_a_probability():
    tried = hypotheses()
    assert len(tried) == (2 * TURNS + 1) ** 2 == len({tuple(pair) for pair in tried.tolist()})
    assert tried[0].tolist() == [0, 0]
    # beyond five turns there is 1/32 of those of one axis, and some of both
    assert 0.99 < np.exp(log_prior(tried)).sum() < 1.0
    mirrored = np.array([(tried == -pair).all(axis=1).argmax() for pair in tried])
    np.testing.assert_allclose(log_prior(tried), log_prior(tried)[mirrored])


def test_what_a_place_is_worth_is_the_least_that_a_change_of_turns_moves_the_fibre():
    """Against the places themselves, of every change of up to two turns of either axis."""
    rng = np.random.default_rng(1)
    places_deg = np.column_stack([rng.uniform(0.0, 350.0, 8), rng.uniform(20.0, 150.0, 8)])
    worth_mm = told_apart_mm(PLANE, np.tile(places_deg, (N, 1, 1)))
    steps = [(a, b) for a in range(-2, 3) for b in range(-2, 3) if (a, b) not in ((0, 0), (1, -1), (-1, 1))]
    steps = [k for k in steps if k not in ((2, -2), (-2, 2))]
    for column, place_deg in enumerate(places_deg):
        here_mm = PLANE.forward(*place_deg)
        moved = [np.hypot(*(PLANE.forward(*(place_deg + np.array(k) * TURN_DEG)) - here_mm).T) for k in steps]
        # straight, not along the arc of 0.7 deg
        np.testing.assert_allclose(worth_mm[:, column], np.min(moved, axis=0), rtol=0.02)
    assert told_apart_mm(PLANE, np.tile(FOLDED, (N, 1, 1))).max() < 0.02
    assert told_apart_mm(PLANE, np.tile(UNFOLDED[0], (N, 1, 1))).min() > 0.08


def test_one_turn_of_alpha_against_one_of_beta_moves_the_fibre_alike_everywhere():
    """The beta arm keeps its direction, so the fibre goes with the elbow: l_alpha times a turn, 45 um."""
    turn_mm = PLANE.l_alpha_mm * np.deg2rad(TURN_DEG)
    for place_deg in (FOLDED, *UNFOLDED):
        moved_mm = PLANE.forward(*(place_deg + np.array([1.0, -1.0]) * TURN_DEG)) - PLANE.forward(*place_deg)
        np.testing.assert_allclose(np.hypot(*moved_mm.T), turn_mm, rtol=1e-3)


def test_of_one_that_is_off_the_likeliest_turns_are_told_though_none_would_be_likelier():
    """With a layout known to 75 um five turns of beta, folded, 0.46 mm, are as likely as none."""
    turns = np.zeros((N, 2), dtype=int)
    turns[4] = (0, 5)
    reported_deg = np.tile(FOLDED, (N, 1))
    seen_mm = PLANE.forward(*(reported_deg + turns * TURN_DEG).T)
    seen_mm += np.random.default_rng(2).normal(0.0, 0.075, (N, 2))
    counter = TurnCounter(PLANE)
    counter.add(reported_deg, seen_mm)
    told, miss_mm = counter.nearest(reported_deg, seen_mm, some=True)
    assert told.any(axis=1).all()
    assert abs(told[4, 1]) >= 3
    assert miss_mm[4] < 0.15
