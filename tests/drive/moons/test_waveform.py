"""Waveforms keep the rules of the controllers, come to their ends exactly, and stay near to their plans."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.drive.moons import broken_rule, check_waveform, waveform
from fiberloom.drive.moons.waveform import LEAST, MOST, SEGMENT_S, braking
from fiberloom.errors import InputError

legs = st.lists(st.tuples(st.floats(0.5, 4.0), st.floats(-1500.0, 1500.0)), min_size=1, max_size=6)


def way(parts, start):
    """Times in s and counts of a way of such legs: duration in s, counts a second."""
    took, speed = np.array(parts).T
    time_s = np.concatenate([[0.0], np.cumsum(took)])
    return time_s, start + np.concatenate([[0.0], np.cumsum(took * speed)])


@given(legs, st.integers(-5000, 5000))
def test_rules_are_kept_and_the_end_is_exact(parts, start):
    time_s, counts = way(parts, start)
    steps = waveform(time_s, counts, start)
    if len(steps) <= 256:
        assert broken_rule(steps) == ""
    assert start + steps.sum() == np.rint(counts[-1])


@pytest.mark.parametrize("rate", [300.0, 620.0, 1100.0, 1500.0])
def test_a_straight_way_is_followed(rate):
    """At a rate below the least of 500 a second it goes in jerks: within half a segment's least, and two more
    for the begin; above it within what it needs to gather speed."""
    time_s, counts = way([(8.0, rate)], 0)
    steps = waveform(time_s, counts, 0)
    at_s = SEGMENT_S * np.arange(1, len(steps) + 1)
    off = np.cumsum(steps) - np.interp(at_s, time_s, counts)
    gather = 0.5 * (rate * SEGMENT_S) ** 2 / 50.0
    assert np.abs(off).max() < 1.5 * LEAST + gather
    settled = off[24:-8]
    assert np.abs(settled).max() <= LEAST


def test_braking_by_hand():
    assert [braking(n) for n in (0, 62, 68, 69, 112, 118, 250)] == [0, 0, 0, 62, 62, 68, 200 + 150 + 100 + 62]


@pytest.mark.parametrize(
    ("steps", "why"),
    [
        ([62, 113], "segment 2: 113 steps are more than 68 beside a rest"),
        ([62, 112, 40, 62], "segment 3: 40 steps are not within 62 and 250"),
        ([69, 62], "segment 1: 69 steps are more than 68"),
        ([62, 113, 63], "segment 2: 113 steps change by more than 50 from 62"),
        ([62, 112, 162, 212, 251, 212, 162, 112, 62], "segment 5: 251 steps"),
        ([62] * 257, "257 segments"),
        ([62, 112, -62], "segment 2: 112 steps are more than 68 beside a rest"),
        ([62, -62, 0, 30], ""),
        ([30], ""),
        ([62, 30], ""),
    ],
)
def test_each_rule_by_itself(steps, why):
    assert why in broken_rule(np.array(steps)) if why else broken_rule(np.array(steps)) == ""


def test_a_bad_waveform_is_refused_in_one_line():
    with pytest.raises(InputError, match="waveform, beta: segment 1: 100 steps"):
        check_waveform(np.array([[62, 100]]))


def test_the_fastest_way_is_a_trapezoid():
    steps = waveform(np.array([0.0, 0.125]), np.array([0.0, 4000.0]), 0)
    assert steps[:5].tolist() == [68, 118, 168, 218, 250]
    assert steps.max() == MOST
    assert steps.sum() == 4000
