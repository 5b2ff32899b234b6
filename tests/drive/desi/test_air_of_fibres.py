"""Air is taken off an image, and nothing else: errors of units are their own, and stay."""

import numpy as np

from fiberloom.drive.desi.maps.air import LEAST_FIBRES, StillPoints, air_of
from fiberloom.twin.camera.air import air_shift_mm

RNG = np.random.default_rng(0)
PLACES = RNG.uniform(-150.0, 150.0, (1500, 2))
POINTS = RNG.uniform(-150.0, 150.0, (60, 2))
EVERY = np.ones(len(PLACES), dtype=bool)
CAMERA_MM = 0.001


def image(error_um, air_um=5.0, seed=0):
    """Air at fibres and what they and standing points show, for errors of units in um per coordinate."""
    rng = np.random.default_rng(seed)
    both = air_shift_mm(np.vstack([PLACES, POINTS]), air_um, 50.0, rng)
    air, on_points = both[: len(PLACES)], both[len(PLACES) :]
    error = 1e-3 * error_um * rng.standard_normal(PLACES.shape)
    noise = CAMERA_MM * rng.standard_normal(both.shape)
    seen = air + error + noise[: len(PLACES)]
    standing = StillPoints(POINTS, on_points + noise[len(PLACES) :], CAMERA_MM)
    return air, error, seen, standing


def rms_um(off_mm):
    return 1e3 * np.sqrt(np.mean(off_mm**2))


def test_fibres_whose_places_are_known_show_the_air():
    air, _, seen, _ = image(error_um=3.0)
    found = air_of(PLACES, seen, np.full(len(PLACES), 0.0032), EVERY)
    assert rms_um(found.shift_mm - air) < 0.3 * rms_um(air)
    # it knows how well it knows it: within a third
    assert 0.67 < rms_um(found.shift_mm - air) / rms_um(found.sigma_mm) < 1.5


def test_errors_of_units_are_not_taken_for_air():
    """What is left is the errors and the noise, no less."""
    _, error, seen, standing = image(error_um=10.0)
    found = air_of(PLACES, seen, np.full(len(PLACES), 0.0101), EVERY, standing)
    left = seen - found.shift_mm
    assert rms_um(left) > 0.97 * np.hypot(rms_um(error), 1e3 * CAMERA_MM)
    # along the errors themselves nothing is lost: a slope of 1 within 3 %
    assert np.sum(left * error) / np.sum(error**2) > 0.97


def test_maps_that_are_worse_than_they_say_tell_less():
    air, _, seen, standing = image(error_um=40.0)
    trusted = np.full(len(PLACES), 0.002)
    found = air_of(PLACES, seen, trusted, EVERY, standing)
    alone = air_of(PLACES, seen, np.full(len(PLACES), 0.04), EVERY, standing)
    assert rms_um(found.shift_mm - air) < 1.2 * rms_um(alone.shift_mm - air)


def test_still_air_is_left_alone():
    _, _, seen, standing = image(error_um=10.0, air_um=0.0)
    found = air_of(PLACES, seen, np.full(len(PLACES), 0.0101), EVERY, standing)
    assert rms_um(found.shift_mm) < 0.5


def test_too_few_fibres_tell_nothing():
    _, _, seen, _ = image(error_um=3.0)
    told = np.arange(len(PLACES)) < LEAST_FIBRES - 1
    found = air_of(PLACES, seen, np.full(len(PLACES), 0.003), told)
    assert not found.shift_mm.any()
