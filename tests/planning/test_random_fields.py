"""Random configurations: free, uniform in area, the same from a seed; refused where there is no room."""

from dataclasses import replace

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.instruments import generate
from fiberloom.planning import fields, random_configuration, random_pair


@pytest.fixture(scope="module")
def seven(sdssv):
    return generate(sdssv, seed=0, n_positioners=7)


def test_places_lie_within_the_range_and_are_uniform_in_area(plane):
    angles = random_configuration(plane, 1)
    low, high = plane.limits_deg.T
    assert ((angles >= low) & (angles <= high)).all()
    np.testing.assert_array_equal(angles, random_configuration(plane, 1))
    assert (angles != random_configuration(plane, 2)).any()
    # the share of the patrol area inside the fibre's radius, 0 to 1: evenly, but for places that are taken
    inner = np.abs(plane.l_alpha_mm - plane.l_beta_mm)
    outer = plane.l_alpha_mm + plane.l_beta_mm
    radius = np.hypot(*(plane.forward(*angles.T, fibre="metrology") - plane.centres_mm).T)
    share = (radius**2 - inner**2) / (outer**2 - inner**2)
    assert abs(np.mean(share) - 0.5) < 0.08


def test_an_offline_positioner_stays_and_others_keep_off(seven):
    offline = np.arange(7) == 3
    stays = np.tile(seven.instrument.positioner.park_deg, (7, 1)).astype(float)
    still = replace(seven, offline=offline, offline_position_deg=stays)
    angles = random_configuration(still, 4)
    np.testing.assert_allclose(angles[3], stays[3])
    assert (angles[~offline] != stays[~offline]).any()


def test_a_crowd_makes_room_or_is_refused(seven, monkeypatch):
    # arms of 7 mm radius: a neighbour has to give way
    crowded = random_configuration(seven, 0, collision_buffer_mm=7.0)
    assert np.isfinite(crowded).all()
    monkeypatch.setattr(fields, "_DRAWS", 3)
    with pytest.raises(InputError, match=r"found no room for positioner \d+"):
        random_configuration(seven, 0, collision_buffer_mm=11.0)


def test_both_ends_of_a_pair_are_free_and_each_way_exists(seven):
    start, goal = random_pair(seven, 3)
    assert start.shape == goal.shape == (7, 2)
    again = random_pair(seven, 3)
    np.testing.assert_array_equal(start, again[0])
    np.testing.assert_array_equal(goal, again[1])
    assert (start != goal).any()
