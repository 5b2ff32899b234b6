"""How wide a step of the search is: an axis shall come to its speed in it."""

import numpy as np
import pytest

from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import PlanSettings, bound_s, plan, random_pair, verify
from fiberloom.planning.planner import GRID_DEG, WIDEST_GRID_DEG


@pytest.mark.parametrize(
    ("instrument", "grid_deg"),
    [("desi", 2.0 * (0.975 * 176.1) ** 2 / 8000.0), ("pfs", GRID_DEG), ("moons", WIDEST_GRID_DEG)],
)
def test_the_instrument_decides_it(instrument, grid_deg):
    """DESI's ramps are long: to come to full speed and stop again takes more than the usual step."""
    plane = generate(load_instrument(instrument), seed=0, n_positioners=3)
    assert PlanSettings().of(plane).grid_deg == pytest.approx(grid_deg)
    assert PlanSettings(grid_deg=4.0).of(plane).grid_deg == 4.0


def test_desi_moves_at_nearly_full_speed():
    plane = generate(load_instrument("desi"), seed=0, n_positioners=7)
    start_deg, goal_deg = random_pair(plane, seed=0)
    least_s = bound_s(plane, start_deg, goal_deg)
    usual, narrow = (
        plan(plane, start_deg, goal_deg, settings=PlanSettings(grid_deg=grid_deg))
        for grid_deg in (None, GRID_DEG)
    )
    assert usual.refused == narrow.refused == {}
    assert verify(plane, usual, start_deg=start_deg, goal_deg=goal_deg).ok
    assert usual.duration_s / least_s < 1.12 < narrow.duration_s / least_s


def test_no_axis_has_many_points_and_none_is_held_up_by_it():
    """Corners are spared where others leave room; the plan is no longer for it."""
    plane = generate(load_instrument("sdssv"), seed=0, n_positioners=91)
    start_deg, goal_deg = random_pair(plane, seed=1)
    made = plan(plane, start_deg, goal_deg, seed=1)
    points = [len(robot.corners(axis)) for robot in made.robots for axis in (0, 1)]
    assert np.mean(points) < 12
    assert max(points) <= 40
    assert made.duration_s / bound_s(plane, start_deg, goal_deg) < 1.15
