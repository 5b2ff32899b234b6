"""Places by worth: the best that is free, against dense sampling in numpy; offline positioners stay."""

import numpy as np
from fields import _lines, _segments, field

from fiberloom.planning.placing import place_by_worth

PLANE = field(19)
MARGIN_MM = 0.2


def smallest_gap_mm(plane, angles_deg):
    """Between two arms on the way down their approaches, both at the same height."""
    above = np.linspace(0.82, 0.0, 41)[:, None]
    lines = [_lines(plane, k, angles_deg[k] + above) for k in range(plane.n)]
    gaps = [_segments(lines[i], lines[j]).min() for i, j in plane.neighbour_pairs()]
    return min(gaps) - 2 * plane.collision_buffer_mm


def test_places_are_candidates_or_folded_and_keep_the_margin():
    rng = np.random.default_rng(3)
    candidates = rng.uniform([0.0, 20.0], [350.0, 170.0], (PLANE.n, 40, 2))
    placed = place_by_worth(PLANE, candidates, rng.uniform(size=(PLANE.n, 40)), 1, margin_mm=MARGIN_MM)
    assert smallest_gap_mm(PLANE, placed) >= MARGIN_MM - 1e-9
    apart = np.abs(candidates - placed[:, None]).max(axis=2).min(axis=1)
    folded = np.abs(placed - PLANE.instrument.positioner.park_deg).max(axis=1)
    assert (np.minimum(apart, folded) < 1e-9).all()
    assert (apart < 1e-9).sum() > PLANE.n / 2


def test_where_nothing_is_in_the_way_each_has_its_best():
    plane = field(7).select([0])
    candidates = np.array([[[100.0, 90.0], [200.0, 120.0], [300.0, 150.0]]])
    for best in range(3):
        worth = np.zeros((1, 3))
        worth[0, best] = 1.0
        np.testing.assert_allclose(place_by_worth(plane, candidates, worth, 0), candidates[:, best])


def test_an_offline_positioner_stays_and_its_neighbours_keep_off():
    still = [[33.0, 60.0]]
    plane = PLANE.with_offline([int(PLANE.positioner_id[0])], still)
    rng = np.random.default_rng(4)
    candidates = rng.uniform([0.0, 20.0], [350.0, 170.0], (plane.n, 40, 2))
    placed = place_by_worth(plane, candidates, rng.uniform(size=(plane.n, 40)), 2, margin_mm=MARGIN_MM)
    np.testing.assert_allclose(placed[0], still[0])
    assert smallest_gap_mm(plane, placed) >= MARGIN_MM - 1e-9
