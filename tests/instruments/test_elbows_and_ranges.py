"""Both elbows, turns of alpha, and ranges of single units, in kinematics and in files."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, read_layout, write_layout
from fiberloom.instruments.axis import Ranges

PLANES = {name: FocalPlane.of(name, n=19) for name in ("sdssv", "desi", "pfs", "moons", "megara", "lamost")}
SHARES = st.lists(st.floats(0.0, 1.0), min_size=38, max_size=38)


def inside(plane, shares):
    """(N, 2) deg within the limits of each positioner."""
    low, high = np.moveaxis(plane.limits_of(), -1, 0)
    return low + np.reshape(shares, (-1, 2)) * (high - low)


@pytest.mark.parametrize("name", PLANES)
@given(shares=SHARES)
@settings(max_examples=25, deadline=None)
def test_the_angles_that_made_a_place_are_among_its_solutions(name, shares):
    plane = PLANES[name]
    angles = inside(plane, shares)
    xy = plane.forward(*angles.T)
    found = plane.solutions(xy)
    rows, which = np.nonzero(np.arange(found.angles_deg.shape[1]) < found.count[:, None])
    for_all = found.angles_deg[rows, which]
    # all of them lead there, within the limits
    assert np.abs(plane.forward(*for_all.T, index=rows) - xy[rows]).max() < 1e-8
    low, high = np.moveaxis(plane.limits_of(rows), -1, 0)
    assert ((for_all >= low) & (for_all <= high)).all()
    # and the one that was asked for is found: 0.01 deg where an arm that is nearly straight hides digits
    near = plane.inverse(xy, near_deg=angles)
    assert near.reachable.all()
    off = np.column_stack([near.alpha_deg, near.beta_deg]) - angles
    folded = np.abs(np.sin(np.radians(angles[:, 1] + np.degrees(plane.beta_off_rad)))) < 1e-3
    assert np.abs((off[~folded] + 180.0) % 360.0 - 180.0).max(initial=0.0) < 0.01


def test_each_elbow_is_the_one_that_the_instrument_has():
    xy = {
        name: plane.centres_mm + np.array([0.0, 0.6 * plane.instrument.reach_mm[1]])
        for name, plane in PLANES.items()
    }
    beta = {name: PLANES[name].solutions(xy[name]).angles_deg[:, 0, 1] for name in PLANES}
    assert all((beta[name] > 0.0).all() for name in ("sdssv", "desi", "lamost", "moons"))
    assert all((beta[name] < 0.0).all() for name in ("pfs", "megara"))
    count = {name: PLANES[name].solutions(xy[name]).count for name in PLANES}
    assert (count["moons"] == 2).sum() > 10  # alpha lacks 21 deg of a turn
    assert (count["sdssv"] == 1).all()
    assert (count["desi"] <= 2).all()


def test_of_two_turns_the_nearer_one_is_taken():
    plane = PLANES["desi"]
    xy = plane.forward(-185.0, 90.0)
    assert (plane.solutions(xy).count == 2).all()
    for asked in (-185.0, 175.0):
        found = plane.inverse(xy, near_deg=np.tile([asked, 90.0], (plane.n, 1)))
        # both are the same place: which turn it is, the caller's side of it decides
        assert np.abs((found.alpha_deg - asked + 180.0) % 360.0 - 180.0).max() < 1e-6


def narrow(plane):
    """Alpha of the first positioner turns by 60 deg only."""
    targets, stops = plane.limits_of().copy(), plane.stops_of().copy()
    targets[0, 0], stops[0, 0] = (10.0, 70.0), (8.0, 72.0)
    return replace(plane, ranges=Ranges(targets, stops))


def test_a_unit_keeps_to_its_own_range():
    plane = narrow(PLANES["sdssv"])
    xy = plane.forward(200.0, 90.0)
    assert plane.inverse(xy).reachable.tolist() == [False] + [True] * 18
    assert plane.inverse(xy).gap_mm[0] == 0.0  # only its limits stand in the way
    assert plane.inverse(plane.forward(40.0, 90.0)).reachable.all()
    assert plane.select([1, 0]).stops_of()[1, 0].tolist() == [8.0, 72.0]


def test_ranges_are_kept_in_files_and_in_the_mark(tmp_path):
    plane = narrow(PLANES["sdssv"])
    assert plane.config_hash() != PLANES["sdssv"].config_hash()
    write_layout(plane, tmp_path)
    again = read_layout(tmp_path, plane.instrument)
    assert again.config_hash() == plane.config_hash()
    np.testing.assert_array_equal(again.stops_of(), plane.stops_of())


@pytest.mark.parametrize(
    ("targets", "words"),
    [([0.0, 361.0], "within the stops"), ([5.0, 5.0], "must rise"), ([np.nan, 5.0], "must rise")],
)
def test_ranges_that_cannot_be_are_refused(targets, words):
    both = np.array([[[0.0, 360.0], [0.0, 180.0]]])
    bad = both.copy()
    bad[0, 0] = targets
    with pytest.raises(InputError, match=f"row 0, alpha: targets .*{words}"):
        Ranges(bad, both)
