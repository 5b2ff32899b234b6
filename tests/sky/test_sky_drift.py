"""Drift during an exposure: the published table, its closed form, and the longest exposure."""

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.instruments import load_instrument
from fiberloom.sky import Chain, SkyPointing, SkySite, SkyTime
from fiberloom.sky.drift import beside, drift, field_grid, longest_s

TIME = SkyTime.of("2024-04-26T06:00:00", "utc")


def at(dec_deg, hour_angle_h, site="apo", instrument="sdssv"):
    """A field with this observed hour angle."""
    model = load_instrument(instrument)
    place = SkySite.of(model, site)
    gmst = 15.0 * ((TIME.day - 2451545.0 + TIME.part) * 24.06570982441908 + 18.697374558)
    ra = (gmst + place.longitude_deg - 15.0 * hour_angle_h) % 360.0
    for _ in range(3):
        chain = Chain(model, SkyPointing(ra, dec_deg, TIME), place)
        ra = (ra + chain.view.hour_angle_deg - 15.0 * hour_angle_h) % 360.0
    return Chain(model, SkyPointing(ra, dec_deg, TIME), place)


TABLE = [
    (0, 0, 1.19, (2.0, 1.9), (4.0, 3.7), (8.6, 7.6)),
    (0, 1, 1.23, (3.4, 2.3), (7.0, 4.7), (15, 10)),
    (0, 2, 1.37, (6.6, 3.9), (14, 8.1), (31, 18)),
    (0, 3, 1.68, (16, 8.6), (34, 18), (78, 42)),
    (0, 3.55, 2.0, (29, 16), (63, 34), (152, 81)),
    (30, 0, 1.00, (1.4, 0.5), (2.9, 0.9), (6.0, 2.0)),
    (30, 2, 1.11, (3.4, 1.7), (7.1, 3.5), (15, 7.6)),
    (30, 3, 1.27, (6.3, 3.3), (13, 6.8), (29, 15)),
    (60, 0, 1.12, (5.2, 1.5), (10, 3.0), (21, 6.0)),
    (60, 2, 1.20, (6.1, 2.1), (12, 4.3), (25, 8.9)),
    (60, 3, 1.31, (7.4, 2.9), (15, 6.0), (31, 13)),
]
"""dec, hour angle, airmass, then um before / after guiding in 15, 30, 60 min: BOSS at APO, radius 1.5 deg."""


@pytest.mark.parametrize(("dec", "hour_angle", "airmass", "m15", "m30", "m60"), TABLE)
def test_every_cell_of_the_published_table(dec, hour_angle, airmass, m15, m30, m60):
    chain = at(dec, hour_angle)
    assert chain.airmass == pytest.approx(airmass, abs=0.011)
    for minutes, published in ((15, m15), (30, m30), (60, m60)):
        found = drift(chain, field_grid(chain), 60.0 * minutes, "BOSS").largest_um
        # the table's own digits, another choice of stars and places
        assert found == pytest.approx(published, rel=0.10, abs=0.3)


@pytest.mark.parametrize(
    ("dec", "hour_angle", "minutes5", "minutes10"), [(30, 0, 121, 192), (0, 3.55, 5, 10)]
)
def test_the_longest_exposure(dec, hour_angle, minutes5, minutes10):
    chain = at(dec, hour_angle)
    grid = field_grid(chain)
    for limit_um, minutes in ((5.0, minutes5), (10.0, minutes10)):
        longest = longest_s(chain, grid, limit_um, "BOSS")
        assert longest / 60.0 == pytest.approx(minutes, rel=0.05, abs=0.5)
        assert drift(chain, grid, longest, "BOSS").largest_um[1] <= limit_um
        assert drift(chain, grid, 1.03 * longest, "BOSS").largest_um[1] > limit_um


def test_what_guiding_leaves_is_the_quadrupole_of_refraction():
    """r abs(Q(t) - Q(0)) with Q = (A / 2) tan^2 z exp(2 i q) gives most of the guided drift."""
    chain = at(0, 3)
    found = drift(chain, field_grid(chain), 1800.0, "BOSS").largest_um[1]

    def quadrupole(c):
        zenith, q = np.radians(90.0 - c.altitude_deg), np.radians(c.view.parallactic_deg)
        return 0.5 * 203e-6 * np.tan(zenith) ** 2 * np.exp(2j * q)

    turned = max(abs(quadrupole(chain.at(TIME.later(s))) - quadrupole(chain)) for s in (-900.0, 900.0))
    edge_um = 1e3 * np.hypot(*chain.place(beside(chain, np.array([[0.0, 1.5]])), "BOSS").xy_mm[0])
    assert 0.70 < edge_um * turned / found < 0.90


def test_east_and_west_drift_alike():
    east, west = (drift(c, field_grid(c), 1800.0, "BOSS").largest_um for c in (at(30, -3), at(30, 3)))
    assert east == pytest.approx(west, rel=0.02)


def test_one_place_per_colour_and_how_far_they_are_apart():
    """Shift along the vertical against the guide wavelength at airmass 1.41: 13 and -32 um, published."""
    chain = at(0, 2.12)
    centre = beside(chain, np.zeros((1, 2)))
    places = {f: chain.place(centre, f).xy_mm[0] for f in ("BOSS", "APOGEE", "metrology")}
    up = {f: 1e3 * np.hypot(*(places[f] - places["metrology"])) for f in ("BOSS", "APOGEE")}
    assert up["BOSS"] == pytest.approx(13, abs=1.5)
    assert up["APOGEE"] == pytest.approx(32, abs=1.5)
    opposite = (places["BOSS"] - places["metrology"]) @ (places["APOGEE"] - places["metrology"])
    assert opposite < 0.0


def test_a_field_that_sets_ends_the_exposure():
    chain = at(-20, 3)
    assert longest_s(chain, field_grid(chain), 1e6, "BOSS") < 5.0 * 3600.0


def test_a_limit_of_nothing():
    chain = at(30, 0)
    with pytest.raises(InputError, match="limit 0 um: must be above 0"):
        longest_s(chain, field_grid(chain), 0.0, "BOSS")
