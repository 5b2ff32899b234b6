"""Small moves that tell where a positioner is: safe for every place, and conclusive."""

import numpy as np
import pytest

from fiberloom.instruments import generate, load_instrument
from fiberloom.operation.safety.explore import ALPHAS, Doubt, found_place, places_of, safe_way
from fiberloom.planning import Plan, Trajectory, random_configuration, verify

PLANE = generate(load_instrument("sdssv"), 0, n_positioners=19)
HERE = random_configuration(PLANE, 5)


def moved(row, place_deg, way):
    """A plan in which one positioner makes its way from a place, the others standing."""
    robots = []
    for i, (number, angles) in enumerate(zip(PLANE.positioner_id, HERE, strict=True)):
        points = np.array([place_deg, place_deg + way]) if i == row else angles[None, :]
        time_s = np.arange(len(points), dtype=float)
        robots.append(Trajectory(int(number), time_s, *points.T.copy()))
    return Plan("sdssv", PLANE.collision_buffer_mm, tuple(robots))


@pytest.mark.parametrize("row", range(19))
def test_the_way_is_clear_wherever_the_positioner_is(row):
    rng = np.random.default_rng(row)
    places = np.vstack([HERE[row], HERE[row] + rng.uniform(-40.0, 40.0, (3, 2))])
    places = np.clip(places, PLANE.limits_deg[:, 0], PLANE.limits_deg[:, 1])
    way = safe_way(PLANE, HERE, Doubt(row, places))
    if way is None:  # one of the places is in a neighbour, where no way is safe
        assert any(verify(PLANE, moved(row, p, np.zeros(2))).contacts for p in places) or len(places) > 1
        return
    for place in places:
        found = verify(PLANE, moved(row, place, np.array(way)))
        assert not found.collisions


def test_a_place_beside_a_neighbour_forbids_the_way_into_it():
    # free as it is, so some way is found; beside the hard stop none may pass it
    row = 0
    free = safe_way(PLANE, HERE, Doubt(row, HERE[row][None, :]))
    assert free is not None
    at_stop = np.array([PLANE.hard_stops_deg[0, 0] + 1.5, HERE[row, 1]])
    way = safe_way(PLANE, HERE, Doubt(row, np.vstack([HERE[row], at_stop])))
    assert way is None or way[0] >= 0.0


def test_two_spots_and_one_that_moves():
    row = 3
    true, other = HERE[row], HERE[row] + (25.0, -12.0)
    places = np.vstack([true, other])
    way = (0.0, -6.0)
    rows = np.array([row, row])
    still = PLANE.forward(*other[:, None], index=[row])
    after = np.vstack([PLANE.forward(*(true + way)[:, None], index=[row]), still])
    found = found_place(PLANE, Doubt(row, places), way, after)
    np.testing.assert_allclose(found, true + way)
    # nothing moved as any place predicts: nothing is concluded
    before = PLANE.forward(*places.T, index=rows)
    assert found_place(PLANE, Doubt(row, places), way, before) is None
    # both moved, as two positioners may: nothing is concluded either
    both = PLANE.forward(*(places + way).T, index=rows)
    assert found_place(PLANE, Doubt(row, places), way, both) is None


def test_an_arm_folded_onto_its_axis_shows_its_alpha_when_it_unfolds():
    plane = generate(load_instrument("pfs"), 0, n_positioners=7)
    beta = plane.limits_deg[1, 1]
    reported, alpha_true = np.array([40.0, beta]), 40.0
    doubt = places_of(plane, 2, np.zeros((0, 2)), reported, folded=True)
    assert len(doubt.places_deg) <= ALPHAS + 1
    assert np.abs(doubt.places_deg[:, 0] - alpha_true).min() < 1e-9
    way = (0.0, -20.0)
    spot = plane.forward([alpha_true], [beta - 20.0], index=[2])
    found = found_place(plane, doubt, way, spot)
    assert found is not None
    np.testing.assert_allclose(found, [alpha_true, beta - 20.0])


def test_places_are_those_that_the_arm_can_reach():
    row = 4
    inside = PLANE.forward(*HERE[row][:, None], index=[row])
    far = PLANE.centres_mm[row] + [60.0, 0.0]
    doubt = places_of(PLANE, row, np.vstack([inside, far]), HERE[row], folded=False)
    # the spot within reach, the elbow on either side and alpha a turn further, and what it reports
    assert len(doubt.places_deg) == 4
    np.testing.assert_allclose(doubt.places_deg[[0, 1, 3]] % 360.0, np.tile(HERE[row], (3, 1)), atol=1e-6)
    assert doubt.places_deg[2, 1] > 180.0
    for place in doubt.places_deg:
        np.testing.assert_allclose(PLANE.forward(*place[:, None], index=[row]), inside, atol=1e-6)
