"""The touch watch: a load that grows beyond its mean, before the feedback has answered it."""

import struct

import numpy as np
import pytest

import rig
from fiberloom._core import firmware as fw
from rig import Rig

# the twin's gains for alpha, on both axes alike; Eq. 22 and the contact watch out of the way
GAINS = {"k_p": 1.3e-4, "k_i": 2.85e-3, "collision_torque": 2.9e-4, "settle_gain": 1.0}
TOUCH_NM = 8e-7
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
    # 10 ms of the observer, 0.8 uNm / 0.54 uNm/ms, and what the mean follows
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


POLE, TICK_S = np.exp(-300 / 2000), 1 / 2000
W0_RAD_S = 209.44


def motor(damping_per_s):
    """Error, its rate and the load over the inertia, a tick on: the rate decays by c/J."""
    k = damping_per_s * TICK_S
    return np.array([[1, TICK_S * (1 - k / 2), TICK_S**2 / 2], [0, 1 - k, TICK_S], [0, 0, 1]])


def gains_at(ahead):
    """Ackermann's formula: what of an error of the first state corrects all three, poles at POLE."""
    seen = np.vstack([np.linalg.matrix_power(ahead, k)[0] for k in range(3)])
    wanted = np.linalg.matrix_power(ahead - POLE * np.eye(3), 3)
    return np.linalg.solve(ahead, wanted @ np.linalg.solve(seen, [0, 0, 1]))


class Reference:
    """The touch watch as fl_touch.h and fl_ripple.h have it, in float64."""

    def __init__(self, p):
        self.v = dict(zip(rig.NAMES, p.astype(float), strict=True))
        self.x, self.late, self.mean, self.mean_speed = np.zeros(3), np.zeros(3), 0.0, 0.0
        self.follow = self.surge = self.unrest = self.way = self.closed_s = self.sure = self.calm = (
            self.dip
        ) = 0.0
        self.scatter, self.share, self.rise, self.limit = 3 * self.v["touch_torque"], 1 / 32, 0.0, 0.0
        self.learnt, self.shown = np.zeros(4), (0.0, 0.0, 0.0, 0.0, np.zeros(2))

    def ripple(self, row):
        """What of the load repeats with the rotor: learnt from what the last tick showed."""
        error, beyond, excess, velocity, direction, *_, sine, cosine = row
        j, c = self.v["inertia"], self.v["drag"] + excess
        before, step_before, beyond_before, beyond_sum, unit = self.shown
        step = error - before
        shown = j * (step - step_before) / TICK_S**2 + beyond_sum / 2 + c * (step + step_before) / TICK_S / 2
        known = direction * (self.mean + excess * (abs(velocity) - self.mean_speed))
        news = shown - known if abs(shown - known) < 3e5 * j else 0.0
        learnt = self.learnt + self.calm * news * self.waves(unit)
        self.learnt = learnt if np.linalg.norm(learnt) < 3000 * j else self.learnt
        half = velocity * TICK_S / 2
        unit = np.array([sine + half * cosine, cosine - half * sine])
        repeats = min((velocity / W0_RAD_S) ** 2, 4) * (self.learnt @ self.waves(unit))
        self.shown = (error, step, beyond - repeats, beyond - repeats + beyond_before, unit)
        return repeats

    def waves(self, unit):
        """Sine and cosine of orders 1 and 2, of those of the rotor, which are nearly on the circle."""
        sine, cosine = unit
        return np.array([sine, cosine, 2 * sine * cosine, 1 - 2 * sine**2])

    def watches(self, velocity, direction, touching):
        """Far enough one way, or since the teeth met."""
        drives = abs(velocity) >= 50 and direction * self.way >= 0
        self.way = self.way + velocity * TICK_S if drives else 0.0
        self.closed_s = touching * (self.closed_s + TICK_S) if drives else 0.0
        far = abs(self.way) > 16
        self.sure = 1.0 if far else self.sure
        return far or self.sure * self.closed_s > 0.01975

    def observe(self, row, repeats):
        """The load that resists: J e'' = L - (T - T_ff) - c e', three poles at 300 rad/s."""
        error, beyond, _, _, direction, *_ = row
        j = self.v["inertia"]
        ahead = motor(self.v["drag"] / j)
        self.x = self.x + gains_at(ahead) * (error - self.x[0])
        load = self.x[2] * j * direction
        known = np.array([0, 0, (beyond - repeats) / j])
        self.x = ahead @ (self.x - known) + known
        return load

    def step(self, row):
        """Rise, limit, whether it is a touch, and what is learnt."""
        _, _, excess, velocity, direction, acceleration, doubt, touching, *_ = row
        watched = self.watches(velocity, direction, touching)
        load = self.observe(row, self.ripple(row))
        speed, drag = abs(velocity), self.v["drag"]
        self.surge = max(abs(acceleration), 0.97 * self.surge)
        for k in range(3):
            self.late[k] += (1 - POLE) * ((self.late[k - 1] if k else speed) - self.late[k])
        faster, more = self.late[2] - self.mean_speed, load - self.mean
        self.rise = more - excess * faster
        self.unrest = max(0.0 if watched else abs(more), 0.985 * self.unrest)
        self.dip = max(-self.rise if watched else 0.0, 0.998 * self.dip)
        pace = min(speed / W0_RAD_S, 1)
        coarse = 1 + 5 * (1 - pace)
        scale = pace**2 if self.share > 1 / 256 else coarse
        usual = max(8.5 * scale * self.scatter, 1.5 * coarse * self.dip)
        known = max(coarse * self.v["touch_torque"], usual)
        allowed = self.unrest + 3 * doubt * drag * abs(faster) + 0.12 * self.v["inertia"] * self.surge
        self.limit = known + allowed
        self.follow = max(1 / 120, 0.98 * self.follow) if watched else 0.1
        self.calm = 0.0
        if watched and allowed < 2 * known and speed > 180:
            self.scatter += self.share * (abs(self.rise) - self.scatter)
            self.share = max(1 / 512, 0.99 * self.share)
            self.calm = self.share if self.rise < 0.5 * self.limit else 0.0
        self.mean, self.mean_speed = self.mean + self.follow * more, self.mean_speed + self.follow * faster
        return [self.rise, self.limit, watched and self.rise > self.limit, *self.learnt]


def driven_rows(seed, ticks=6000):
    """Forth and back at changing speeds, the noise of the sensors, a push now and then in the last half."""
    rng = np.random.default_rng(seed)
    corners = np.arange(0, ticks + 1, 500)
    corner_rad_s = rng.uniform(70, 230, corners.size) * np.where((corners // 2000) % 2, -1, 1)
    speed = np.interp(np.arange(ticks), corners, corner_rad_s)
    time_s = np.arange(ticks) * TICK_S
    push = (time_s > 1.4) * (np.sin(15 * time_s + seed) > 0.97)
    angle = np.cumsum(speed) * TICK_S
    rows = np.zeros((ticks, 10))
    rows[:, 0] = 2e-4 * np.sin(40 * time_s) + rng.normal(0, 1e-6, ticks)
    rows[:, 1] = 3e-5 * push * np.sign(speed) + 4e-7 * np.sin(2 * angle + 1)
    rows[:, 2] = rng.uniform(-3e-8, 3e-8)
    rows[:, 3], rows[:, 4], rows[:, 5] = speed, np.where(speed < 0, -1, 1), np.gradient(speed) / TICK_S
    rows[:, 6] = np.linspace(0.4, 0.05, ticks)
    rows[:, 7] = np.abs(speed) > 60
    rows[:, 8], rows[:, 9] = np.sin(angle), np.cos(angle)
    return rows


# seed 3 has a tick whose rise is half the limit to the last bit of float32
@pytest.mark.parametrize("seed", [0, 1, 2, 4])
def test_the_watch_is_the_rule_of_its_header(seed):
    p = rig.alpha_params(touch_torque=TOUCH_NM)
    rows, reference = driven_rows(seed), Reference(rig.alpha_params(touch_torque=TOUCH_NM))
    got, want = fw.touch(p, rows), np.array([reference.step(row) for row in rows])
    assert 0 < want[:, 2].sum() < 0.1 * len(rows)
    assert (got[:, 2] == want[:, 2]).all()
    # float32: 1e-7 of loads up to 3e-5 Nm and of limits ten times as large, and some sums of it
    assert np.abs(got - want)[:, 0].max() < 5e-11
    assert np.abs(got - want)[:, 1].max() < 1e-9
    assert np.abs(got - want)[:, 3:].max() < 5e-11


def test_a_dip_fades_to_nothing_that_slows_a_processor():
    """Subnormal floats do, and short moves leave a dip behind that none of them renews."""
    rows = np.zeros((50_000, 10))
    rows[:, 0] = np.random.default_rng(0).normal(0.0, 1e-6, len(rows))  # as sensors are never without noise
    rows[:2000, 3], rows[:, 4] = 100.0, 1.0
    rows[1000:1100, 1] = -1e-6
    fw.subnormals_met()
    limit_Nm = fw.touch(rig.alpha_params(touch_torque=1e-9), rows)[:, 1]
    assert not fw.subnormals_met()
    assert limit_Nm[1100:2000].max() > 3.0 * limit_Nm[900:1000].max() > 0.0


# what repeats with the rotor's turn: firmware/law/fl_ripple.h

LEARNT = ("once_sin", "once_cos", "twice_sin", "twice_cos")


def rows_of(speed_rad_s, load_Nm):
    """What the watch is told of a motor that follows exactly: the whole load is in the torque beyond."""
    speed = np.asarray(speed_rad_s, dtype=float)
    angle = np.cumsum(speed) * TICK_S
    rows = np.zeros((len(speed), 10))
    # a tick is from here to the next: the load in its middle
    rows[:, 1] = load_Nm(angle + speed * TICK_S / 2)
    rows[:, 3], rows[:, 4], rows[:, 5] = speed, np.where(speed < 0, -1, 1), np.gradient(speed) / TICK_S
    rows[:, 6], rows[:, 8], rows[:, 9] = 0.05, np.sin(angle), np.cos(angle)
    return rows


def learnt_from(rows):
    out = fw.touch(rig.alpha_params(touch_torque=TOUCH_NM), rows)
    return out[:, :3], {name: 1e6 * out[:, 3 + k] for k, name in enumerate(LEARNT)}


def wrong(angle):
    """uNm: cogging identified wrongly, and hall offsets and amplitudes, at 2000 rpm."""
    return 0.9 * np.sin(2 * angle + 0.6) + 0.3 * np.sin(angle - 1.0)


@pytest.mark.parametrize("turns", [1.0, -1.0])
def test_what_repeats_is_found_to_the_last_percent(turns):
    speed = turns * np.full(12000, W0_RAD_S)
    watch, got = learnt_from(rows_of(speed, lambda angle: 1e-6 * wrong(angle)))
    assert got["twice_sin"][-1] == pytest.approx(0.9 * np.cos(0.6), abs=0.02)
    assert got["twice_cos"][-1] == pytest.approx(0.9 * np.sin(0.6), abs=0.02)
    assert got["once_sin"][-1] == pytest.approx(0.3 * np.cos(1.0), abs=0.02)
    assert got["once_cos"][-1] == pytest.approx(-0.3 * np.sin(1.0), abs=0.02)
    # and nothing of it is left in the rise: 0.3 uNm of it would be, behind the poles of the observer
    assert np.abs(watch[-200:, 0]).max() < 5e-9


def test_what_the_sensor_is_wrong_by_is_a_quarter_at_half_the_speed():
    speed = W0_RAD_S * np.repeat([1.0, 0.5], [8000, 3000])
    pace = (speed / W0_RAD_S) ** 2
    watch, got = learnt_from(rows_of(speed, lambda angle: 1e-6 * pace * np.sin(2 * angle)))
    assert got["twice_sin"][7999] == pytest.approx(1.0, abs=0.02)
    assert got["twice_sin"][-1] == got["twice_sin"][8100]
    assert np.abs(watch[-2000:, 0]).max() < 5e-9


@pytest.mark.parametrize("rate_uNm_ms", [0.1, 0.5, 4.0])
def test_a_touch_is_not_learnt_within_its_16_ms(rate_uNm_ms):
    speed = np.full(8000, W0_RAD_S)
    met = 6000

    def load(angle):
        return 1e-6 * (wrong(angle) + rate_uNm_ms * np.maximum(np.arange(8000) - met, 0) / 2)

    watch, got = learnt_from(rows_of(speed, load))
    assert not watch[:met, 2].any()
    found = met + np.argmax(watch[met:, 2])
    assert found > met
    before, after = (np.array([got[name][at] for name in LEARNT]) for at in (met, min(found, met + 32)))
    # a twentieth of the threshold, and of a wall's 64 uNm no more than the header says
    assert np.abs(after - before).max() < (0.04 if rate_uNm_ms < 1.0 else 0.1)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e30, np.inf, np.nan])
def test_whatever_comes_it_stays_within_bounds(seed, size):
    rng = np.random.default_rng(seed)
    inertia = float(rig.alpha_params()[rig.NAMES.index("inertia")])
    speed = np.full(4000, W0_RAD_S)
    rows = rows_of(speed, lambda angle: 1e-6 * np.sin(angle))
    rows[1000::37, rng.integers(0, 2)] = size
    rows[1500::41, 8:] = size
    _, got = learnt_from(rows)
    for name in LEARNT:
        assert np.abs(got[name]).max() <= 1e6 * 3000 * inertia * 1.0001, name


def test_what_repeats_is_no_touch_before_it_is_learnt():
    """A channel that has faded by 2 % since its calibration, at power-up: 6 uNm of order 2 at 2000 rpm."""
    speed = W0_RAD_S * np.tile(np.repeat([1.0, 0.7], 400), 5)
    watch, _ = learnt_from(rows_of(speed, lambda angle: 6e-6 * (speed / W0_RAD_S) ** 2 * np.sin(2 * angle)))
    assert not watch[:, 2].any()


def test_what_comes_and_goes_with_the_rotor_is_no_touch_where_it_is_not_learnt():
    """A channel fades while the motor drives slower than the ripple is learnt at: 8 uNm within a second."""
    speed = W0_RAD_S * np.repeat([1.0, 0.85], [4000, 4000])
    fades = np.clip((np.arange(8000) - 5000) / 2000, 0.0, 1.0)
    watch, _ = learnt_from(rows_of(speed, lambda angle: 8e-6 * fades * np.sin(2 * angle)))
    # 0.27 of it is left behind the observer's poles, and the threshold is 1.4 uNm at that speed
    assert watch[:, 0].max() > 1.5e-6
    assert not watch[:, 2].any()


def test_it_learns_nothing_where_nothing_is_watched():
    """Slower than 500 rpm, and on the way that closes the backlash."""
    for speed in (np.full(4000, 45.0), np.resize(np.repeat([150.0, -150.0], 150), 4000)):
        _, got = learnt_from(rows_of(speed, lambda angle: 1e-6 * wrong(angle)))
        assert all(not got[name].any() for name in LEARNT)
