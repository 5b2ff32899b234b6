"""One whose grid at rest has a way that no motion can follow is refused; its search once had no end."""

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.planning import plan, verify


def test_one_without_any_path_is_refused_and_the_others_go():
    """Seed 674 of the fault campaign: 183 does not move, and 160 begins close beside it."""
    whole = FocalPlane.of("sdssv", seed=2, n=37)
    numbers = [160, 182, 183]
    start_deg = np.array([[25.022, 45.063], [254.061, 99.772], [315.649, 82.546]])
    goal_deg = np.array([[152.924, 164.841], [287.999, 37.007], [315.649, 82.546]])
    plane = whole.select(whole.index_of(numbers)).with_offline([183], start_deg[2:])
    made = plan(plane, start_deg, goal_deg, seed=3)
    assert made.refused == {160: "positioner 160: it cannot pass what stands still around it, even alone"}
    np.testing.assert_allclose(made.end_deg[:2], [start_deg[0], goal_deg[1]], atol=1e-3)
    assert verify(plane, made).ok
    assert made.statistics["searches"] < 100
