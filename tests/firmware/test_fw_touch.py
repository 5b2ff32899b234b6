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


POLE = np.exp(-450 / 2000)
OBSERVER = np.array([1 - POLE**3, 1.5 * (1 - POLE) ** 2 * (1 + POLE) * 2000, (1 - POLE) ** 3 * 2000**2])
AHEAD = np.array([[1, 1 / 2000, 0.5 / 2000**2], [0, 1, 1 / 2000], [0, 0, 1]])


def observed_Nm(inertia, drag, rows):
    """The load of J e'' = L - (T - T_ff) - c e', by an observer with three equal poles at 450 rad/s."""
    state, loads = np.zeros(3), []
    for error, beyond, excess, _, direction, *_ in rows:
        state = state + OBSERVER * (error - state[0])
        loads.append(state[2] * inertia * direction)
        known = (beyond + (drag + excess) * state[1]) / inertia
        state = AHEAD @ (state - [0, 0, known]) + [0, 0, known]
    return np.array(loads)


def reference_touch(p, rows):
    """The rise of the load over its mean and what is allowed, as fl_touch.h has it, in float64."""
    v = dict(zip(rig.NAMES, p.astype(float), strict=True))
    late, mean, mean_speed, follow = np.zeros(3), 0.0, 0.0, 0.0
    surge, unrest, way, scatter, out = 0.0, 0.0, 0.0, 3 * v["touch_torque"], []
    loads = observed_Nm(v["inertia"], v["drag"], rows)
    for load, (_, _, excess, velocity, direction, acceleration, doubt) in zip(loads, rows, strict=True):
        speed = abs(velocity)
        way = way + velocity / 2000 if speed >= 50 and direction * way >= 0 else 0.0
        watched = abs(way) > 16
        surge = max(abs(acceleration), 0.97 * surge)
        for k in range(3):
            late[k] += (1 - POLE) * ((late[k - 1] if k else speed) - late[k])
        faster, more = late[2] - mean_speed, load - mean
        rise = more - excess * faster
        unrest = max(0.0 if watched else abs(more), 0.97 * unrest)
        limit = max(v["touch_torque"] * max(1, 2 - speed / 160), 3.5 * scatter) + unrest
        limit += 3 * doubt * v["drag"] * abs(faster) + 0.12 * v["inertia"] * surge
        follow = max(1 / 120, 0.98 * follow) if watched else 0.1
        scatter += (abs(rise) - scatter) / 500 if watched else 0.0
        mean, mean_speed = mean + follow * more, mean_speed + follow * faster
        out.append((rise, limit, watched and rise > limit))
    return np.array(out)


def driven_rows(seed, ticks=6000):
    """Forth and back at changing speeds, the noise of the sensors, a push now and then in the last half."""
    rng = np.random.default_rng(seed)
    corners = np.arange(0, ticks + 1, 500)
    corner_rad_s = rng.uniform(70, 209, corners.size) * np.where((corners // 2000) % 2, -1, 1)
    speed = np.interp(np.arange(ticks), corners, corner_rad_s)
    time_s = np.arange(ticks) / 2000
    push = (time_s > 1.4) * (np.sin(15 * time_s + seed) > 0.97)
    rows = np.zeros((ticks, 7))
    rows[:, 0] = 2e-3 * np.sin(40 * time_s) + rng.normal(0, 1e-6, ticks)
    rows[:, 1] = 1e-5 * push * np.sign(speed)
    rows[:, 2] = rng.uniform(-3e-8, 3e-8)
    rows[:, 3], rows[:, 4], rows[:, 5] = speed, np.where(speed < 0, -1, 1), np.gradient(speed) * 2000
    rows[:, 6] = np.linspace(0.4, 0.05, ticks)
    return rows


@pytest.mark.parametrize("seed", range(4))
def test_the_watch_is_the_rule_of_its_header(seed):
    p = rig.alpha_params(touch_torque=TOUCH_NM)
    rows = driven_rows(seed)
    got, want = fw.touch(p, rows), reference_touch(p, rows)
    assert 0 < want[:, 2].sum() < 0.1 * len(rows)
    assert (got[:, 2] == want[:, 2]).all()
    # float32: 1e-7 of loads up to 8e-6 Nm and of limits ten times as large, and some sums of it
    assert np.abs(got - want)[:, 0].max() < 1e-11
    assert np.abs(got - want)[:, 1].max() < 3e-10
