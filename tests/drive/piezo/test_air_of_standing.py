"""What fibres that stand tell of the air over those that moved."""

import numpy as np
import pytest

from fiberloom.drive.piezo.air import FEWEST, air_mm

PLACES_MM = np.stack(np.meshgrid(np.arange(10.0), np.arange(10.0)), axis=-1).reshape(-1, 2) * 8.0
SHIFT_MM = np.array([0.004, -0.002])
ALL = np.ones(len(PLACES_MM), dtype=bool)


def test_the_share_of_neighbours_is_taken_for_air():
    found = air_mm(PLACES_MM + SHIFT_MM, PLACES_MM, ALL)
    # so many neighbours against three that say nothing
    assert found / SHIFT_MM == pytest.approx(np.broadcast_to(found[:, :1] / SHIFT_MM[0], found.shape))
    assert (found / SHIFT_MM > 0.8).all()
    assert (found / SHIFT_MM < 1.0).all()


def test_one_alone_does_not_tell_of_its_own_air():
    seen = PLACES_MM.copy()
    seen[44] += SHIFT_MM
    found = air_mm(seen, PLACES_MM, ALL)
    assert found[44] == pytest.approx([0.0, 0.0], abs=1e-15)
    assert np.hypot(*found[45]) > 0.0


@pytest.mark.parametrize("beside_mm", [0.5, np.nan])
def test_taken_for_another_or_not_seen_tells_nothing(beside_mm):
    seen = PLACES_MM.copy()
    seen[44] += beside_mm
    assert (air_mm(seen, PLACES_MM, ALL) == 0.0).all()


def test_one_that_stands_is_weighed_against_the_belief_of_no_air():
    stands = ~ALL
    stands[44] = True
    found = air_mm(PLACES_MM + SHIFT_MM, PLACES_MM, stands)
    assert found[45] == pytest.approx(SHIFT_MM / (1.0 + FEWEST), rel=0.06)
    assert (air_mm(PLACES_MM + SHIFT_MM, PLACES_MM, ~ALL) == 0.0).all()
