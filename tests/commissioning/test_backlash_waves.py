"""The backlash as the firmware is told it: from maps over a whole turn or half of one."""

import numpy as np
import pytest

from fiberloom.calibration.commissioning.backlash import (
    BACKLASH_WAVES,
    fitted_waves,
    tells_waves,
    wave_parameters,
)

MEAN = 140.0
WAVES = np.array([[30.0, -20.0], [5.0, 12.0], [-8.0, 3.0], [6.0, 2.0]])  # of cosine and sine, motor deg


def backlash(theta_deg, *, mean=MEAN, waves=WAVES):
    theta = np.deg2rad(theta_deg)
    parts = [
        a * np.cos(m * theta) + b * np.sin(m * theta)
        for m, (a, b) in zip(BACKLASH_WAVES.values(), waves, strict=True)
    ]
    return mean + np.sum(parts, axis=0)


def told(parameters, theta_deg):
    """As fl_teeth_backlash puts it together."""
    theta = np.deg2rad(theta_deg)
    waves = [parameters[n] * np.sin(m * theta + parameters[f"{n}_phase"]) for n, m in BACKLASH_WAVES.items()]
    return parameters["backlash"] + np.sum(waves, axis=0)


def test_parameters_are_amplitudes_and_phases_of_sines():
    theta = np.linspace(0.0, 360.0, 77)
    assert np.abs(told(wave_parameters(MEAN, WAVES), theta) - backlash(theta)).max() < 1e-9


@pytest.mark.parametrize(("last_deg", "within"), [(360.0, 0.1), (180.0, 0.6)])
def test_a_map_gives_them_back(last_deg, within):
    """Half a turn (beta) tells slow waves apart less well: it is the curve that must be right, where it was
    measured; the weight that holds the waves takes 1e-4 of them."""
    theta = np.linspace(0.0, last_deg, 1000)
    found = fitted_waves(theta, backlash(theta))
    assert np.abs(told(found, theta) - backlash(theta)).max() < within


def test_noise_of_a_map_is_averaged():
    """1.8 motor degrees a point, as of a camera with 0.67 um; nine numbers from 200 points: 0.4 rms."""
    rng = np.random.default_rng(3)
    theta = np.linspace(0.0, 360.0, 200)
    found = fitted_waves(theta, backlash(theta) + rng.normal(0.0, 1.8, 200))
    off = told(found, theta) - backlash(theta)
    assert 0.1 < np.sqrt(np.mean(off**2)) < 0.8


def test_a_coarse_map_tells_no_waves():
    """Of 16 points over half a turn a wave of 347 motor degrees about a mean of 0 was made."""
    assert not tells_waves(np.linspace(0.0, 180.0, 16))
    assert not tells_waves(np.array([]))
    assert tells_waves(np.linspace(0.0, 180.0, 100))
    assert tells_waves(np.linspace(0.0, 360.0, 200))


def test_a_gear_without_backlash_is_told_none():
    assert wave_parameters(-0.4, 0.0 * WAVES)["backlash"] == 0.0
