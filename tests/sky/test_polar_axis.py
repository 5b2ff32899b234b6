"""A mount whose polar axis is beside the pole turns the field: against rotations of vectors."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fiberloom.instruments import load_instrument
from fiberloom.sky import Chain, SkyPointing, SkyTime
from fiberloom.sky.drift import field_grid
from fiberloom.sky.guiding import fit_guiding

LATITUDE_DEG = 31.96403
LOW, EAST = -120.0, -2.0


def desi(low=LOW, east=EAST):
    model = load_instrument("desi")
    axis = {"mount_pole_low_arcsec": low, "mount_pole_east_arcsec": east}
    site = model.sky.sites["kpno"].model_copy(update=axis)
    return model.model_copy(update={"sky": model.sky.model_copy(update={"sites": {"kpno": site}})})


def chain(model, dec, hour, pa=0.0):
    time = SkyTime.of("2024-04-26T06:00:00", "utc")
    at_zero = Chain(model, SkyPointing(180.0, 60.0, time))
    ra = 180.0 + at_zero.view.hour_angle_deg - 15.0 * hour
    return Chain(model, SkyPointing(ra % 360.0, dec, time, pa))


def vector(ha_deg, dec_deg):
    ha, dec = np.radians([ha_deg, dec_deg])
    return np.array([np.cos(dec) * np.cos(ha), np.cos(dec) * np.sin(ha), np.sin(dec)])


def ha_dec(v):
    return np.degrees(np.arctan2(v[1], v[0])), np.degrees(np.arcsin(v[2] / np.linalg.norm(v)))


def turn_of(ha_deg, dec_deg):
    """deg by which north turns at a place of the sky, when the mount's pole is brought to the pole on the
    shortest way: from the rotation of two vectors there."""
    alt, az = np.radians([LATITUDE_DEG - LOW / 3600.0, EAST / 3600.0])
    lat = np.radians(LATITUDE_DEG)
    north, zenith = np.array([-np.sin(lat), 0, np.cos(lat)]), np.array([np.cos(lat), 0, np.sin(lat)])
    west = np.array([0.0, 1.0, 0.0])  # hour angles grow to the west
    pole = np.cos(alt) * (np.cos(az) * north - np.sin(az) * west) + np.sin(alt) * zenith
    axis = np.cross(pole, [0.0, 0.0, 1.0])
    mount = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.arcsin(np.linalg.norm(axis)))
    here, above = vector(ha_deg, dec_deg), vector(ha_deg, dec_deg + 1e-4)
    (ha, dec), (ha_up, dec_up) = (ha_dec(mount.apply(v)) for v in (here, above))
    east = -(ha_up - ha) * np.cos(np.radians(dec))
    return float(np.degrees(np.arctan2(east, dec_up - dec)))  # of the true north, in the mount's frame


@pytest.mark.parametrize(("dec", "hour"), [(0, -4), (0, 0), (30, 3), (60, 0), (60, 2), (60, -3), (-10, 1)])
def test_the_field_turns_as_the_vectors_do(dec, hour):
    beside, straight = chain(desi(), dec, hour), chain(desi(0.0, 0.0), dec, hour)
    view = straight.view
    expected = turn_of(view.hour_angle_deg, view.dec_deg)
    assert 3600.0 * (view.pa_deg - beside.view.pa_deg) == pytest.approx(3600.0 * expected, abs=0.01)


def test_places_turn_and_nothing_else():
    """3600" * 150" at 400 mm are 290 um; a rotation takes all of it off."""
    beside, straight = chain(desi(), 60, 3), chain(desi(0.0, 0.0), 60, 3)
    stars = field_grid(straight)
    a, b = straight.place(stars).xy_mm, beside.place(stars).xy_mm
    assert 200.0 < 1e3 * np.abs(b - a).max() < 500.0
    fit = fit_guiding(a, b)
    assert np.max(fit.residual_um) < 1e-6
    assert fit.scale == pytest.approx(1.0, abs=1e-12)


def test_the_preset_of_desi_has_the_published_axis_and_others_have_none():
    site = load_instrument("desi").sky.sites["kpno"]
    assert (site.mount_pole_low_arcsec, site.mount_pole_east_arcsec) == (LOW, EAST)
    sites = [s for name in ("sdssv", "pfs") for s in load_instrument(name).sky.sites.values()]
    assert all(s.mount_pole_low_arcsec == s.mount_pole_east_arcsec == 0.0 for s in sites)


def test_places_lead_back_to_the_sky():
    beside = chain(desi(), 60, 3, pa=25.0)
    stars = field_grid(beside)
    back = beside.sky(beside.place(stars).xy_mm, 6400.0)
    off = 3.6e6 * (back - np.column_stack([stars.ra_deg, stars.dec_deg]))
    assert np.abs((off[:, 0] + 6.48e8) % 1.296e9 - 6.48e8).max() < 0.1
    assert np.abs(off[:, 1]).max() < 0.1
