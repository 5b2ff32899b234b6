"""The law of steppers against a ramp written down from its rules alone, and the search of the datum."""

import itertools
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom._core import firmware as fw

MOONS = np.array([250, 62, 250, 50, 4], np.int32)
"""A tick is 0.5 ms, so that the fastest, 2000 steps/s, is one a tick."""
SQUARE = np.array([10, 10, 10, 1, 4], np.int32)
POSITION, SEGMENT, FIELD, DONE = range(4)
ramps = st.tuples(
    st.integers(1, 12), st.integers(0, 60), st.integers(1, 25), st.integers(0, 40), st.sampled_from([4, 32])
).map(lambda r: np.array([r[0] + r[1] + r[3], r[0], r[0] + r[1], r[2], r[4]], np.int32))


def ramp_by_rule(config, way):
    """Segments by search: as many as the rules allow, from which rest can still be reached."""
    _, start, most, change, _ = config.tolist()

    @cache
    def needs(n):
        """The least that is gone after a segment of n before it may rest."""
        return 0 if n <= start else (least := max(n - change, 1)) + needs(least)

    left, before, out = way, 0, []
    while left:
        top = start if before == 0 else min(most, before + change)
        bottom = max(before - change, 1) if before > start else 0
        before = max(n for n in range(bottom, min(top, left) + 1) if needs(n) <= left - n)
        out.append(before)
        left -= before
    return out


def segments_of(trace, config):
    every = trace[config[0] - 1 :: config[0], POSITION]
    steps = np.diff(every, prepend=0)
    return np.trim_zeros(steps, "b").tolist()


@given(ramps, st.integers(-900, 900))
@settings(max_examples=60)
def test_segments_are_those_of_the_rules(config, goal):
    want = ramp_by_rule(config, abs(goal))
    trace = fw.steps_trace(config, 0, goal, int(config[0]) * (len(want) + 1))
    assert segments_of(trace, config) == [int(np.sign(goal)) * n for n in want]
    assert trace[-1].tolist() == [goal, 0, goal % config[4], 1]


@pytest.mark.parametrize("goal", [20, 1000, -6000])
def test_a_waveform_of_moons_keeps_the_rules_of_its_driver(goal):
    trace = fw.steps_trace(MOONS, 0, goal, 250 * 60)
    n = np.abs(segments_of(trace, MOONS))
    assert n.sum() == abs(goal)
    assert n[0] <= 62
    assert n[-1] <= 62
    assert n.max() <= 250
    assert np.abs(np.diff(n)).max(initial=0) <= 50
    # what a trapezoid of one segment fewer can go, by the rules
    k = np.arange(len(n) - 1)
    assert np.minimum(62 + 50 * np.minimum(k, k[::-1]), 250).sum() < abs(goal)


def test_steps_are_spread_evenly_over_a_segment():
    trace = fw.steps_trace(MOONS, 0, 40, 251)
    ticks = np.flatnonzero(np.diff(trace[:, POSITION], prepend=0))
    assert set(np.diff(ticks)) == {6, 7}
    assert ticks[-1] == 249
    assert trace[248:250, DONE].tolist() == [0, 1]


def test_a_square_profile_has_no_ramp():
    trace = fw.steps_trace(SQUARE, 0, -57, 60)
    assert trace[:57, POSITION].tolist()[:50] == list(range(-1, -51, -1))
    assert trace[-1, POSITION] == -57


@given(ramps, st.integers(200, 900), st.integers(0, 400))
@settings(max_examples=60)
def test_a_stop_brakes_by_the_same_rules(config, goal, tick):
    _, start, _, change, _ = config.tolist()
    trace = fw.steps_trace(config, 0, goal, int(config[0]) * 950, tick)
    n = segments_of(trace, config)
    assert trace[-1, DONE] == 1
    assert trace[-1, POSITION] <= goal
    assert not n or n[-1] <= start
    assert all(a - b <= change for a, b in itertools.pairwise(n) if a > start)
    at = trace[tick, SEGMENT]
    assert trace[-1, POSITION] - trace[tick, POSITION] <= at * (2 + at // change)


@given(st.integers(1, 3000), st.integers(-2000, 2000))
def test_a_search_tells_what_was_lost_and_counts_anew(true_at, lost):
    found, slip, position = fw.steps_seek(MOONS, true_at + lost, lost, -5000)
    assert (found, slip, position) == (True, lost, 0)


def test_a_search_without_a_switch_ends_and_says_so():
    found, slip, position = fw.steps_seek(MOONS, 3000, 0, -500)
    assert (found, slip, position) == (False, 0, 2500)


@pytest.mark.parametrize(
    ("config", "goal", "match"),
    [
        ([250, 0, 250, 50, 4], 1, "start <= most"),
        ([100, 62, 250, 50, 4], 1, "as many ticks"),
        ([250, 62, 250, 0, 4], 1, "change"),
        ([250, 62, 250, 50, 4], 2**30, "below"),
    ],
)
def test_what_the_law_cannot_run_is_refused(config, goal, match):
    with pytest.raises(ValueError, match=match):
        fw.steps_trace(np.array(config, np.int32), 0, goal, 1)
