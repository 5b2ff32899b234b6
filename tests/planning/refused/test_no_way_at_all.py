"""A positioner beside one that does not move: a tight way is found, and where there is none it is refused."""

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan, plan, verify

START_DEG = np.array([[25.022, 45.063], [254.061, 99.772], [315.649, 82.546]])
GOAL_DEG = np.array([[152.924, 164.841], [287.999, 37.007], [315.649, 82.546]])


def planned(start_deg) -> Plan:
    """Seed 674 of the fault campaign: 183 does not move, and 160 begins close beside it."""
    whole = FocalPlane.of("sdssv", seed=2, n=37)
    plane = whole.select(whole.index_of([160, 182, 183])).with_offline([183], start_deg[2:])
    made = plan(plane, start_deg, GOAL_DEG, seed=3)
    assert verify(plane, made).ok
    return made


def test_a_way_with_hardly_a_step_to_spare_is_found():
    """Once its search had no end, then it had no way: it has one."""
    made = planned(START_DEG)
    assert made.refused == {}
    np.testing.assert_allclose(made.end_deg, GOAL_DEG, atol=1e-8)


def test_one_without_any_way_is_refused_and_the_others_go():
    start_deg = START_DEG + np.array([[1.5, 0.0], [0.0, 0.0], [0.0, 0.0]])
    made = planned(start_deg)
    alone = "it cannot pass what stands still around it within its travel, even alone"
    assert made.refused == {160: f"positioner 160: {alone}"}
    np.testing.assert_allclose(made.end_deg[:2], [start_deg[0], GOAL_DEG[1]], atol=1e-3)
