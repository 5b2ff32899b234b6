"""Pairs of the campaign in which a positioner is refused that may have a way."""

import pytest
from benchmarks.planning import pairs
from benchmarks.planning.campaign import Array

from fiberloom.planning import PlanSettings, plan


@pytest.mark.xfail(strict=True, reason="25 November 2026: the pocket of 962 is not left to both")
def test_two_beside_one_in_a_pocket_arrive():
    """Pair 198 at 2.0 mm: 962 is in a pocket, by the flood; the goals of 110 and 944 touch its start."""
    folder = pairs.real_layout()
    if folder is None:
        pytest.skip(f"no {pairs.REAL} beside the checkout: its tables are not part of this project")
    array = Array.of(str(folder), 2.0)
    made = plan(array.plane, *array.ends_of(198), seed=198, settings=PlanSettings(collision_buffer_mm=2.0))
    assert set(made.refused) == {962}
