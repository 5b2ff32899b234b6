"""Before the last correction: who moves is more likely to end within than where it stands."""

import numpy as np

import fiberloom as fl
from fiberloom.drive.desi.maps.learned import LearnedMaps
from fiberloom.drive.desi.standing import StandingPlaces

N = 60


def test_only_those_move_that_gain_by_it():
    plane = fl.FocalPlane.of("desi", seed=0, n=N)
    maps = LearnedMaps(plane, np.column_stack([np.full(N, 20.0), np.full(N, 90.0)]))
    maps.covariance *= 3e-4  # one move in a hundred ends beyond 5 um
    standing, goal_mm = StandingPlaces(maps), maps.expected_mm()
    off_um = np.linspace(3.0, 6.0, N)
    for _ in range(25):  # without noise: 0.3 um an axis is believed of each
        standing.see(goal_mm + 1e-3 * np.column_stack([off_um, np.zeros(N)]), 1.5e-3, np.ones(N, dtype=bool))
    kept = standing.best_kept(goal_mm, 5.0)
    rests = standing.arrived(goal_mm, 5.0)
    assert (kept | ~rests).all()  # who rests is kept
    assert off_um[rests].max() < off_um[kept].max() < 5.0  # and some more, but none beyond
    assert kept[off_um < 4.0].all()
    standing.went(np.ones(N, dtype=bool))
    assert not standing.best_kept(goal_mm, 5.0).any()  # nothing is known until the next image
