"""Coverage against areas, published figures and the ways in which a lattice can fail."""

import math

import numpy as np
import pytest

from fiberloom.design.coverage import array_coverage, best_pattern, broken_plane, coverage, covers, fillings
from fiberloom.design.lattice import Lattice, Pattern
from fiberloom.errors import InputError
from fiberloom.instruments import generate, instrument_names, load_instrument

SHARE_TOL = 0.006
"""Four standard errors of a share on 100000 points; the figures are rounded to 0.001 besides."""

TABLE = {
    # arms, pitch; mean, least and most, share with 2, 3, 4 or more: 400000 points, an independent count
    "desi": ((3.0, 3.0, 10.4), 1.207, (0, 2), (0.207, 0.0, 0.0)),
    "pfs": ((2.375, 2.375, 8.0), 1.279, (1, 3), (0.275, 0.003, 0.0)),
    "lamost": ((8.25, 8.25, 25.6), 1.507, (1, 3), (0.457, 0.049, 0.0)),
    "megara": ((5.803, 5.803, 20.1), 1.210, (1, 3), (0.209, 0.0, 0.0)),  # 3 on a micrometre: points miss it
    "sdssv": ((7.4, 15.0, 22.4), 3.210, (2, 4), (1.0, 0.910, 0.300)),
    "moons": ((8.0, 17.0, 25.0), 3.157, (2, 4), (1.0, 0.892, 0.266)),
}


@pytest.mark.parametrize("name", TABLE)
def test_counts_are_those_of_the_six_instruments(name):
    lengths, mean, extremes, shares = TABLE[name]
    found = coverage(Lattice(*lengths))
    assert found.mean_exact == pytest.approx(mean, abs=6e-4)
    assert found.mean == pytest.approx(mean, abs=0.01)
    assert (found.least, found.most) == extremes
    assert found.at_least[2:] == pytest.approx(shares, abs=SHARE_TOL)


def test_equal_arms_need_the_point_amid_three():
    """R = p/sqrt(3) is the limit, to a tenth of a micrometre on either side."""
    reach_mm = 10.4 / math.sqrt(3.0)
    assert covers(Lattice(reach_mm / 2 + 1e-4, reach_mm / 2 + 1e-4, 10.4))
    assert not covers(Lattice(reach_mm / 2 - 1e-4, reach_mm / 2 - 1e-4, 10.4))


def test_desi_has_holes_of_4_um_and_a_pitch_fills_them():
    lattice = Lattice(3.0, 3.0, 10.4)
    assert coverage(lattice, n=1000).hole_um == pytest.approx(1e3 * (10.4 / math.sqrt(3.0) - 6.0), abs=1e-6)
    (filling,) = fillings(lattice)
    assert filling.length == "pitch_mm"
    # the search stops 1e-6 of the pitch from the limit
    assert filling.to_mm == pytest.approx(6.0 * math.sqrt(3.0), abs=2e-5)


def test_the_real_fibre_of_sdssv_misses_the_centres_by_30_um():
    lattice = Lattice.of(load_instrument("sdssv"), "BOSS")
    found = coverage(lattice, n=1000)
    assert found.least == 0
    assert found.hole_um == pytest.approx(1e3 * (22.4 - 7.4 - math.hypot(14.965, 0.376)), abs=1e-6)
    for filling in fillings(lattice):
        assert covers(lattice.changed(**{filling.length: filling.to_mm}))


@pytest.mark.parametrize(
    ("carried", "period", "one", "two"),
    [(1, 2, 0.985, 0.62), (3, 5, 0.994, 0.75), (2, 3, 1.000, 0.83), (1, 3, 0.861, 0.21)],
)
def test_fibres_on_a_part_of_the_units(carried, period, one, two):
    lattice = Lattice(7.4, 15.0, 22.4)
    found = coverage(lattice, best_pattern(lattice, carried, period))
    assert found.at_least[1] == pytest.approx(one, abs=SHARE_TOL)
    assert found.at_least[2] == pytest.approx(two, abs=SHARE_TOL)
    assert found.mean == pytest.approx(lattice.mean * carried / period, abs=0.01)


def test_units_that_share_nothing_have_no_corners():
    """Reach of 4 mm at a pitch of 9: discs of their own, and a hole up to the point amid three."""
    found = coverage(Lattice(2.0, 2.0, 9.0))
    assert (found.least, found.most) == (0, 1)
    assert found.at_least[1] == pytest.approx(16.0 * math.pi / (81.0 * math.sqrt(0.75)), abs=SHARE_TOL)
    assert found.hole_um == pytest.approx(1e3 * (9.0 / math.sqrt(3.0) - 4.0), abs=1e-6)


def test_a_pattern_repeats_and_carries_its_share():
    q, r = (a.ravel() for a in np.meshgrid(np.arange(30), np.arange(30)))
    for pattern in (Pattern(5, 2, (0, 1, 3)), Pattern(2, 1, (0,), staggered=True)):
        carried = pattern.carries(q, r)
        assert carried.mean() == pytest.approx(pattern.share, abs=1e-12)
        assert np.array_equal(carried, pattern.carries(q + pattern.period, r))


def test_ranges_take_away_what_the_annulus_has():
    """Half a turn of alpha and one elbow reach half the annulus."""
    whole = Lattice(3.0, 3.0, 10.4)
    half = whole.changed(alpha_range_deg=(0.0, 180.0))
    points = whole.random_points_mm(20000, 0)
    share = half.count(points, free=False).mean() / whole.count(points).mean()
    assert share == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("name", instrument_names())
def test_every_preset_has_a_coverage(name):
    instrument = load_instrument(name)
    for fibre in instrument.science_fibres:
        found = coverage(Lattice.of(instrument, fibre), n=4000)
        assert found.mean <= found.mean_exact + 0.05  # ranges take away; 4000 points scatter by 0.02
        assert found.at_least[1] > 0.999


def test_broken_units_and_fiducials_leave_holes():
    plane = generate(load_instrument("sdssv"), 0, n_positioners=61)
    sound = array_coverage(plane, "BOSS")
    worse = array_coverage(broken_plane(plane, 12, seed=1), "BOSS")
    assert 0.9 < sound.covered < 1.0
    assert worse.covered < sound.covered
    assert worse.number.sum() == pytest.approx(sound.number.sum() * 49 / 61, rel=0.1)
    assert (sound.number[sound.blocked] == 0).all()
    per_fiducial_mm2 = math.pi * 5.0**2  # radius 3 and the arm's 2
    inside = np.linalg.norm(plane.fiducials[:, :2], axis=1) < 60.0  # not at the edge
    assert sound.blocked.sum() * sound.step_mm**2 >= 0.9 * inside.sum() * per_fiducial_mm2


def test_bad_arms_are_refused_with_numbers():
    with pytest.raises(InputError, match="l_alpha_mm -1"):
        Lattice(-1.0, 15.0, 22.4)
    with pytest.raises(InputError, match="make the arms shorter"):
        Lattice(300.0, 300.0, 22.4)
    with pytest.raises(InputError, match="as in 3/5"):
        best_pattern(Lattice(3.0, 3.0, 10.4), 7, 5)
    with pytest.raises(InputError, match="has"):
        Lattice.of(load_instrument("pfs"), "none")
