"""The touch watch: a load that grows beyond its mean, before the feedback has answered it."""

import struct

import numpy as np
import pytest

import rig
from fiberloom._core import firmware as fw
from rig import Rig

# the twin's gains for alpha, on both axes alike; Eq. 22 and the contact watch out of the way
GAINS = {"k_p": 1.3e-4, "k_i": 2.85e-3, "collision_torque": 2.9e-4, "settle_gain": 1.0}
TOUCH_NM = 2.4e-6
NEIGHBOUR_NM_S = 2.7e-4  # tip on tip: 22 mm of lever, both arms give way, one drives at 2000 rpm


def moving_unit(target_deg, **changes):
    """At full speed, the drag learnt."""
    unit = Rig(position_deg=(100.0, 100.0), **{"touch_torque": TOUCH_NM, **GAINS, **changes})
    unit.goto(60, 100)
    unit.wait()
    assert not unit.unsolicited
    unit.goto(target_deg, 100)
    unit.unit.tick(1200)
    return unit


def found_ms(unit, rate_Nm_s, limit_ms=60):
    """How long a load grew until the unit stopped; None if it did not."""
    for tick in range(2 * limit_ms):
        unit.unit.set_plant(0, "external_torque", rate_Nm_s * tick / rig.TICKS_PER_S)
        unit.unit.tick()
        if unit.unit.state == fw.STATES["STOPPING"]:
            return tick / 2.0
    return None


@pytest.mark.parametrize(("target", "sign"), [(20.0, 1.0), (100.0, -1.0)])
def test_arms_that_meet_are_found_within_16_ms(target, sign):
    # 6.7 ms of the observer, 2.4 uNm / 0.54 uNm/ms, and what the mean follows
    assert 8.0 < found_ms(moving_unit(target), 2.0 * sign * NEIGHBOUR_NM_S) <= 16.0
    # with one of them at rest the load grows half as fast
    assert found_ms(moving_unit(target), sign * NEIGHBOUR_NM_S) <= 22.0
    # ten times the load, a wall, is found as soon as the observer sees it
    assert found_ms(moving_unit(target), sign * 10.0 * NEIGHBOUR_NM_S) < 7.0


@pytest.mark.parametrize(("target", "sign"), [(20.0, -1.0), (100.0, 1.0)])
def test_a_load_that_helps_is_no_touch(target, sign):
    assert found_ms(moving_unit(target), sign * NEIGHBOUR_NM_S) is None


def test_what_changes_slowly_is_the_spring_and_the_grease():
    # 0.01 uNm/ms: the mean of 60 ms lags by 0.6 uNm
    assert found_ms(moving_unit(20.0), 1e-5, limit_ms=500) is None


@pytest.mark.parametrize("left_out", ["use_speed", "use_break_away", "use_inertia", "touch_torque"])
def test_without_a_whole_model_nothing_is_told_from_the_load(left_out):
    unit = moving_unit(20.0, **{left_out: 0.0}, collision_torque=1.0)
    assert found_ms(unit, NEIGHBOUR_NM_S) is None


def test_the_margin_widens_it():
    unit = Rig(position_deg=(100.0, 100.0), touch_torque=TOUCH_NM, **GAINS)
    assert unit.code(111, struct.pack("<i", 1)) == rig.ACCEPTED  # k_p times a degree: 2.3 uNm more
    unit.goto(20, 100)
    unit.unit.tick(1600)
    later = found_ms(unit, NEIGHBOUR_NM_S)
    assert later == pytest.approx(found_ms(moving_unit(20.0), NEIGHBOUR_NM_S) + 9.0, abs=4.0)


def test_grease_and_reversals_are_no_touch():
    for factor in (0.6, 1.0, 1.4):
        unit = Rig(position_deg=(50.0, 60.0), touch_torque=TOUCH_NM, **GAINS)
        for axis in (0, 1):
            unit.unit.set_plant(axis, "drag", unit.unit.plant(axis, "drag") * factor)
        turns = np.cumsum([0.0, 5.0, -5.0, 5.0, 1.0, -8.0])
        points = [(0.1 + 0.45 * k, 50.0 + x) for k, x in enumerate(turns)]
        unit.follow(points, [(t, x + 10.0) for t, x in points])
        unit.wait()
        assert not unit.unsolicited
