"""Ways round the zero of alpha, and ways of which an image tells no angles."""

import numpy as np
import pytest
from visits import Visits

from fiberloom.health.monitor import HealthMonitor, ObservedMove
from fiberloom.instruments import generate, load_instrument

PLANE = generate(load_instrument("sdssv"), seed=0, n_positioners=3)
ALL = np.ones(len(PLANE), dtype=bool)


def moved(monitor, before_deg, believed_deg, true_deg):
    """One move of every positioner, from, to where they believe, and where their fibres are."""
    before, believed, true = (np.tile(a, (len(PLANE), 1)) for a in (before_deg, believed_deg, true_deg))
    seen = PLANE.forward(*true.T, "metrology")
    monitor.update(ObservedMove(before, believed, seen, ALL, ALL))


def test_a_miss_across_the_zero_of_alpha_is_a_small_one():
    monitor = HealthMonitor(PLANE)
    # 0.7 deg is beyond what is linear: both angles are solved anew, alpha as 0.2 deg
    moved(monitor, [350.0, 90.0], [359.5, 90.0], [360.2, 90.0])
    np.testing.assert_allclose(monitor._seen_deg[:, 0], 360.2, atol=1e-6)
    np.testing.assert_allclose(monitor._seen_deg[:, 1], 90.0, atol=1e-6)


def test_five_degrees_of_a_way_of_250_are_none():
    """Less than 3 % of the way, but more than 3 % of its chord: the angles tell, the places do not."""
    monitor = HealthMonitor(PLANE)
    moved(monitor, [40.0, 90.0], [40.0, 90.0], [40.0, 90.0])
    moved(monitor, [40.0, 90.0], [290.0, 90.0], [45.0, 90.0])
    np.testing.assert_array_equal(monitor.stills_in_a_row, [[1, 0]] * len(PLANE))


def test_a_fibre_that_rests_tells_even_where_its_angles_cannot_be_told():
    """Beta 5 deg: sin 5 deg is below the least sine. The way of alpha is 95 deg, none of it was gone."""
    monitor = HealthMonitor(PLANE)
    moved(monitor, [100.0, 5.0], [100.0, 5.0], [100.0, 5.0])
    moved(monitor, [100.0, 5.0], [5.0, 5.0], [100.0, 5.0])
    np.testing.assert_array_equal(monitor.stills_in_a_row, [[1, 0]] * len(PLANE))


def test_a_fibre_that_is_to_stay_and_stays_is_no_fault():
    monitor = HealthMonitor(PLANE)
    for _ in range(5):
        moved(monitor, [100.0, 5.0], [100.0, 5.0], [100.0, 5.0])
    assert monitor.still.score.max() == 0.0


def test_torque_that_all_need_more_of_is_the_weather():
    monitor = HealthMonitor(PLANE)
    for k, move in enumerate(Visits(PLANE, seed=1).run(20)):
        # once every habit is learnt (20 moves) it grows cold: all need seven steps of the chart more
        effort = np.tile([0.1, 0.3], (len(PLANE), 1)) + (1.0 if k >= 30 else 0.0)
        parts = (move.before_deg, move.believed_deg, move.seen_mm, move.asked, move.arrived)
        monitor.update(ObservedMove(*parts, effort=effort))
    assert monitor.friction.score.max() == 0.0


@pytest.mark.parametrize(("miss_at_next_deg", "alarms"), [(1.5, 1.1), (0.0, 0.0)])
def test_a_jump_is_a_slip_if_it_stays_and_none_if_it_goes(miss_at_next_deg, alarms):
    monitor = HealthMonitor(PLANE)
    moved(monitor, [40.0, 90.0], [40.0, 90.0], [40.0, 90.0])
    moved(monitor, [40.0, 90.0], [100.0, 90.0], [101.5, 90.0])
    moved(monitor, [100.0, 90.0], [160.0, 90.0], [160.0 + miss_at_next_deg, 90.0])
    np.testing.assert_allclose(monitor.slip.score, [[alarms * monitor.settings.alarm, 0.0]] * len(PLANE))


@pytest.mark.parametrize("way_deg", [-60.0, 60.0])
@pytest.mark.parametrize(("share", "side"), [(0.95, 0), (1.05, 1)])
def test_ways_too_short_and_too_long_have_charts_of_their_own(way_deg, share, side):
    monitor = HealthMonitor(PLANE)
    moved(monitor, [180.0, 90.0], [180.0, 90.0], [180.0, 90.0])
    moved(monitor, [180.0, 90.0], [180.0 + way_deg, 90.0], [180.0 + share * way_deg, 90.0])
    alpha = monitor.scale.score[:, 0, int(way_deg > 0.0)]
    assert (alpha[:, side] > 0.0).all()
    assert (alpha[:, 1 - side] == 0.0).all()
