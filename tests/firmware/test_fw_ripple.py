"""What repeats with the rotor's turn is learnt and taken off (firmware/law/fl_ripple.h)."""

import numpy as np
import pytest

import rig
from fiberloom._core import firmware as fw

TOUCH_NM = 8e-7
W0_RAD_S = 209.44
TICK_S = 1 / 2000
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


def test_it_learns_nothing_where_nothing_is_watched():
    """Slower than 500 rpm, and on the way that closes the backlash."""
    for speed in (np.full(4000, 45.0), np.resize(np.repeat([150.0, -150.0], 150), 4000)):
        _, got = learnt_from(rows_of(speed, lambda angle: 1e-6 * wrong(angle)))
        assert all(not got[name].any() for name in LEARNT)
