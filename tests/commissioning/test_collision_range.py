"""Eq. 23 in open loop: from 90 motor degrees of lag a rotor no longer follows, at 180 it turns back."""

import numpy as np
import pytest

from fiberloom.calibration.commissioning.checks import _collision


@pytest.mark.parametrize(("lag_deg", "well"), [(89.0, False), (91.0, True), (179.0, True), (181.0, False)])
def test_a_collision_is_told_between_losing_step_and_turning_back(lag_deg, well):
    k_p, integral = 2e-3, 1e-4
    values = {
        "k_p": k_p,
        "integral_limit": integral,
        "collision_torque": integral + k_p * np.radians(lag_deg),
    }
    check = _collision("alpha", values)
    assert check.value == pytest.approx(lag_deg)
    assert (check.reason == "") is well
