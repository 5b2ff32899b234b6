"""Pairs of the campaign in which more are refused than the flood proves to be in pockets."""

import numpy as np
import pytest
from benchmarks.planning import pairs
from benchmarks.planning.bodies import between
from benchmarks.planning.campaign import Array
from benchmarks.planning.pockets import Way, flood

from fiberloom.planning import PlanSettings, plan

BUFFER_MM = 2.0


def test_of_two_beside_one_in_a_pocket_one_arrives():
    """Pair 198 at 2.0 mm: where 962 starts it touches the goals of 110 and 944. It is in a pocket, and
    wherever it goes in there it touches one of them: no plan lets both arrive.
    """
    folder = pairs.real_layout()
    if folder is None:
        pytest.skip(f"no {pairs.REAL} beside the checkout: its tables are not part of this project")
    array = Array.of(str(folder), BUFFER_MM)
    start_deg, goal_deg = array.ends_of(198)
    row, *others = (array.bodies.row_of(number) for number in (962, 110, 944))
    found = flood(array.bodies, row, (start_deg[row], goal_deg[row]), BUFFER_MM)
    assert found.way == Way.NONE
    at_goal = [array.bodies.lines(k, *np.radians(goal_deg[k])) for k in others]
    gaps_mm = np.array([between(*found.pocket.ends, *line) - 2.0 * BUFFER_MM for line in at_goal])
    assert (gaps_mm.max(axis=1) > 0.0).all()  # each alone could arrive
    assert (gaps_mm.min(axis=0) + found.pocket.within_mm < 0.0).all()
    settings = PlanSettings(collision_buffer_mm=BUFFER_MM)
    made = plan(array.plane, start_deg, goal_deg, seed=198, settings=settings)
    assert set(made.refused) == {962, 110}
