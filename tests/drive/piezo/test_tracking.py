"""Poses from places: hidden fibres, turns of theta, left-over spots."""

import dataclasses
import sys
from pathlib import Path

import numpy as np

from fiberloom.drive.piezo import LearningLaw, MotorMaps
from fiberloom.drive.piezo.cobras import CobraArms
from fiberloom.drive.piezo.loose import pair_loose
from fiberloom.drive.piezo.tracking import Tracker

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from support.cobras import pfs_plane

PLANE = pfs_plane(57)
ARMS = CobraArms.of(PLANE)
N = len(ARMS)
MAPS = MotorMaps(np.full((2 * N, 2, 112), 0.07), 400.0 / 112, np.full((2 * N, 2), 40.0))


def tracker_at(place_deg, sigma_deg=0.1, dots_mm=None):
    law = LearningLaw(MAPS, np.tile([88.0, 72.0], N))
    tracker = Tracker(ARMS, law, dots_mm)
    tracker.believe(place_deg, sigma_deg)
    return tracker


def moved(tracker, way_deg):
    """Tells motors to go, and returns the order."""
    goal = tracker.place_deg + way_deg
    order = tracker.law.order(goal.ravel(), np.ones(2 * N, dtype=bool))
    tracker.law.take(order)


def test_a_turn_that_was_taken_for_another_is_put_right():
    """Theta 5 and 365 deg look alike. A cobra that cannot go on backwards was at 5: it had not moved."""
    still = np.tile([5.0, 60.0], (N, 1))
    tracker = tracker_at(still)
    law = tracker.law
    law.settings = dataclasses.replace(law.settings, most_steps=9000.0)
    moved(tracker, np.array([355.0, 0.0]))
    tracker.see(ARMS.xy_mm(still), 1.0)
    assert np.all(tracker.place_deg[:, 0] > 360.0)
    for _ in range(2):
        moved(tracker, np.array([-150.0, 0.0]))  # runs into the stop at 0
        tracker.see(ARMS.xy_mm(np.tile([0.0, 60.0], (N, 1))), 1.0)
    assert np.abs(tracker.place_deg[:, 0]).max() < 1.0


def behind_dots(dots_mm):
    """Angles at which fibres are behind their dots."""
    return ARMS.angles_deg(dots_mm[:, :2].copy(), np.full((N, 2), 90.0))


def test_a_fibre_behind_its_dot_is_hidden_and_comes_back():
    dots = PLANE.dots_mm
    hidden = behind_dots(dots)
    tracker = tracker_at(hidden - np.array([0.0, 18.0]), 1.0, dots)
    moved(tracker, np.array([0.0, 17.0]))
    tracker.see(np.full((N, 2), np.nan), 1.0)
    assert tracker.hidden.all()
    assert not tracker.lost.any()
    assert np.abs(tracker.place_deg - hidden).max() < 12.0
    moved(tracker, np.array([0.0, -30.0]))
    out = hidden - np.array([0.0, 26.0])
    tracker.see(ARMS.xy_mm(out), 1.0)
    assert not tracker.hidden.any()
    assert np.abs(tracker.place_deg - out).max() < 0.5


def test_a_fibre_that_is_not_seen_far_from_its_dot_is_lost():
    dots = PLANE.dots_mm
    away = behind_dots(dots) + np.array([90.0, 0.0])
    tracker = tracker_at(np.clip(away, 5.0, 360.0), 0.1, dots)
    tracker.see(np.full((N, 2), np.nan), 1.0)
    assert tracker.lost.mean() > 0.9


def test_left_over_spots_go_to_those_that_can_have_come_there():
    rng = np.random.default_rng(0)
    expected = np.column_stack([rng.uniform(100.0, 260.0, N), np.full(N, 60.0)])
    sigma = np.tile([25.0, 8.0], (N, 1))
    true = expected + np.clip(rng.standard_normal((N, 2)), -2.0, 2.0) * sigma
    unseen = np.zeros(N, dtype=bool)
    unseen[[3, 20, 41]] = True
    spots = ARMS.xy_mm(true)[unseen][[2, 0, 1]]
    found = pair_loose(ARMS, expected, sigma, unseen, spots)
    got = np.isfinite(found).all(axis=1)
    assert got.sum() >= 2
    np.testing.assert_allclose(found[got], ARMS.xy_mm(true)[got], atol=1e-9)
    # a spot that nobody can reach stays left over
    nobody = pair_loose(ARMS, expected, sigma, unseen, np.array([[500.0, 500.0]]))
    assert not np.isfinite(nobody).any()


def test_of_a_nearly_straight_arm_the_fibre_is_believed_where_it_is_seen():
    """Phi 3 deg short of straight: each angle is seen to 0.3 deg at best, the fibre to a micrometre."""
    straight = -ARMS.zero_deg[:, 1] - 3.0
    start = np.column_stack([np.full(N, 100.0), straight - 6.0])
    rng, tracker = np.random.default_rng(3), tracker_at(start, 0.3)
    at = start.copy()
    for way in ((2.0, 4.0), (-1.0, 1.0), (0.5, -0.5)):
        moved(tracker, np.array(way))
        told = tracker.law.expected_deg().reshape(-1, 2)
        at = at + (told - tracker.place_deg) * (1.0 + 0.2 * rng.standard_normal((N, 2)))
        tracker.see(ARMS.xy_mm(at) + 0.001 * rng.standard_normal((N, 2)), 1.0)
    off_um = 1e3 * np.hypot(*(ARMS.xy_mm(tracker.place_deg) - ARMS.xy_mm(at)).T)
    assert np.median(off_um) < 2.0
    assert np.percentile(off_um, 95) < 6.0
    off_sigma = np.abs(tracker.place_deg - at) / tracker.sigma_deg
    assert np.mean(off_sigma < 2.0) > 0.9  # what is not seen of the angles is said


def test_images_of_a_straight_arm_that_stands_tell_no_more_of_its_angles():
    """The sum of both is what is seen: however often, it does not tell theta from phi."""
    place = np.column_stack([np.full(N, 100.0), -ARMS.zero_deg[:, 1] - 0.5])
    tracker = tracker_at(place, 0.5)
    for _ in range(6):
        moved(tracker, np.zeros(2))
        tracker.see(ARMS.xy_mm(place), 1.0)
    assert np.all(tracker.sigma_deg[:, 1] > 0.3)


def test_images_of_a_fibre_that_stands_are_averaged():
    """Nine images of 2 um: the last one alone would be off by 2.5 um in the median, their mean by a third."""
    place = np.column_stack([np.full(N, 120.0), 0.5 * ARMS.range_deg[:, 1]])
    rng, tracker = np.random.default_rng(5), tracker_at(place, 0.5)
    for _ in range(9):
        moved(tracker, np.zeros(2))
        tracker.see(ARMS.xy_mm(place) + 0.002 * rng.standard_normal((N, 2)), 2.0)
    off_um = 1e3 * np.hypot(*(ARMS.xy_mm(tracker.place_deg) - ARMS.xy_mm(place)).T)
    assert np.median(off_um) < 1.2
