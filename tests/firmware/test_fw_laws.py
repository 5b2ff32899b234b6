"""Laws against float64 references, each with its own tolerance."""

import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom._core import firmware as fw
from rig import MOTOR_DEG, NAMES, alpha_params

TURN = 2**20
CNT_PER_RAD = TURN / (2 * np.pi)
angles = st.integers(-(2**31), 2**31 - 1)


@pytest.mark.parametrize("least", [1e-30, 1e-18])
def test_what_fades_stops_before_its_digits_are_lost(least):
    """A subnormal float costs a processor a hundred times as long, and twins slow down."""
    x = np.float32(3e5)
    for _ in range(10_000):
        before, x = x, np.float32(fw.fade(float(x), 0.97, least))
        assert x == before * np.float32(0.97) or before < 1e10 * least
    assert x == pytest.approx(least / 0.03, rel=1e-3)


@pytest.mark.parametrize("begin", [209.0, -209.0])
def test_a_lag_comes_to_rest_beside_its_target(begin):
    """And what it differs by is never a subnormal float."""
    x, share = np.float32(begin), np.float32(0.139292)
    for _ in range(1000):
        before, x = x, np.float32(fw.follow(float(x), 0.0, float(share)))
        assert x == before + share * (np.float32(0.0) - before) or abs(before) < 1e-9
        assert abs(x) > 1e-30
    assert x == pytest.approx(1e-18 / 0.139292, rel=1e-3)
    assert fw.follow(209.0, 209.0, float(share)) == 209.0


@given(st.integers(0, 2047), st.integers(0, 255), st.integers(0, 63), st.integers(0, 15))
def test_an_identifier_comes_back(positioner, command, uid, code):
    identifier = fw.encode_identifier(positioner, command, uid, code)
    assert identifier == positioner << 18 | command << 10 | uid << 4 | code
    assert fw.decode_identifier(identifier) == (positioner, command, uid, code)


def test_the_identifier_of_the_protocol_notes():
    assert fw.encode_identifier(1, 3, 1) == 0x00040C10


@pytest.mark.parametrize("bad", [(2048, 0, 0, 0), (0, 256, 0, 0), (0, 0, 64, 0), (0, 0, 0, -1)])
def test_a_field_too_wide_is_refused(bad):
    with pytest.raises(ValueError, match="must be 0"):
        fw.encode_identifier(*bad)


def test_sine_and_cosine():
    cnt = np.arange(-TURN, 2 * TURN, 37, dtype=np.int32)
    got = fw.sincos(cnt).astype(np.float64)
    want = np.stack([np.sin(cnt / CNT_PER_RAD), np.cos(cnt / CNT_PER_RAD)], axis=1)
    # polynomial 5.9e-7 (fit), the rest rounding of float32
    assert np.abs(got - want).max() < 8e-7


def test_angle_of_a_vector():
    theta = np.linspace(-np.pi, np.pi, 100_003)
    for radius in (1e-3, 1.0, 2.0):
        s, c = (radius * np.sin(theta)).astype(np.float32), (radius * np.cos(theta)).astype(np.float32)
        error = fw.atan2_cnt(s, c) - np.arctan2(s.astype(float), c.astype(float)) * CNT_PER_RAD
        folded = (error + TURN / 2) % TURN - TURN / 2
        # half a count of rounding, 0.28 of the polynomial, the rest float32
        assert np.abs(folded).max() < 1.1


def test_the_angle_of_nothing_is_zero():
    assert fw.atan2_cnt(np.zeros(1, np.float32), np.zeros(1, np.float32))[0] == 0


@given(st.floats(1e-30, 1e30))
def test_square_root(x):
    assert fw.sqrt(np.array([x], np.float32))[0] == pytest.approx(np.sqrt(np.float32(x)), rel=3e-7)


@pytest.mark.parametrize("x", [0.0, -0.0, -1.0, -1e30, np.nan])
def test_the_root_of_nothing_and_less_is_zero(x):
    assert fw.sqrt(np.array([x], np.float32))[0] == 0.0


@given(st.binary(max_size=100))
def test_crc_is_that_of_zip(data):
    assert fw.crc32(data) == zlib.crc32(data)


def adc(theta, offset=(2048, 2048), amplitude=(1500, 1500), phase=0.0):
    a = offset[0] + amplitude[0] * np.sin(theta)
    b = offset[1] + amplitude[1] * np.cos(theta + phase)
    return np.round(np.stack([a, b], axis=1)).astype(np.uint16)


@given(
    st.floats(1900, 2200),
    st.floats(1900, 2200),
    st.floats(1000, 1800),
    st.floats(1000, 1800),
    st.floats(-0.4, 0.4),
)
@settings(max_examples=30)
def test_hall_angle_corrects_offset_gain_and_phase(oa, ob, aa, ab, phase):
    theta = np.linspace(0.3, 40 * np.pi, 4001)  # away from the wrap of the first sample
    p = alpha_params(
        hall_offset_a=oa, hall_offset_b=ob, hall_amplitude_a=aa, hall_amplitude_b=ab, hall_phase=phase
    )
    got = fw.hall_angle(p, adc(theta, (oa, ob), (aa, ab), phase)) / CNT_PER_RAD
    # rounding of the converter: 0.5/1000 on each channel, mixed by the phase correction
    assert np.abs(got - theta).max() < 1.3e-3


def test_turns_are_counted_both_ways_without_drift():
    rng = np.random.default_rng(3)
    steps = rng.uniform(-0.45, 0.45, 200_000) * 2 * np.pi
    theta = np.cumsum(steps)
    theta -= theta[0]
    got = fw.hall_angle(alpha_params(), adc(theta)) / CNT_PER_RAD
    assert np.abs(theta).max() > 50 * 2 * np.pi
    # as far off after 200 000 samples as after one: a converter step is 6.7e-4 rad
    assert np.abs(got - theta).max() < 1e-3


def test_a_dead_sensor_keeps_the_last_angle():
    samples = np.concatenate([adc(np.array([1.0])), np.full((5, 2), 2048, np.uint16)])
    got = fw.hall_angle(alpha_params(), samples)
    assert np.ptp(got) == 0


def field(duty):
    """Strength and angle of the field of Eq. 18 from the duties."""
    c = 4 / 3 * (duty[:, 2] - (duty[:, 0] + duty[:, 1]) / 2)
    s = (duty[:, 1] - duty[:, 0]) / (np.sqrt(3) / 2)
    return np.hypot(s, c), np.arctan2(s, c)


def test_rotating_field_is_equation_18():
    cnt = np.arange(0, TURN, 1111, dtype=np.int32)
    theta = cnt / CNT_PER_RAD
    for u in (0.1, 1.0):
        duty = fw.rotating_field(u, cnt)
        want = 0.5 * u * (1 + np.cos(theta[:, None] + np.deg2rad([120, -120, 0])))
        assert np.abs(duty - want).max() < 1e-6
        # the check of Eq. 18: u_B - u_A = sqrt(3)/2 u sin(theta)
        assert np.abs(duty[:, 1] - duty[:, 0] - np.sqrt(3) / 2 * u * np.sin(theta)).max() < 1e-6


@given(st.floats(-1, 1), st.floats(0.95, 1.05))
@settings(max_examples=50)
def test_torque_has_the_sign_of_the_command_at_every_angle(voltage, sensor_gain):
    theta = np.linspace(0, 2 * np.pi, 721)
    rotor = (sensor_gain * np.stack([np.sin(theta), np.cos(theta)], axis=1)).astype(np.float32)
    duty = fw.commutate(np.full(len(theta), voltage, np.float32), rotor).astype(float)
    assert duty.min() >= 0
    assert duty.max() <= 1
    strength, angle = field(duty)
    torque = strength * np.sin(angle - theta)  # Eq. 19 in units of torque per volt
    # a sensor 5 % too large leaves 0.4 % after one Newton step; clamping at 0 and 1 the rest
    assert np.abs(torque - voltage).max() < 0.006 * abs(voltage) + 1e-6
    if abs(voltage) > 1e-3:
        assert (np.sign(torque) == np.sign(voltage)).all()


@pytest.mark.parametrize("strength", [-0.5, 0.3, 1.0, 1.5])
def test_every_phase_is_that_of_equation_18_within_the_supply(strength):
    field_cnt = np.arange(0, TURN, 1009, dtype=np.int32)
    angle = field_cnt[:, None] / CNT_PER_RAD + np.deg2rad([120, -120, 0])
    want = np.clip(strength / 2 * (1 + np.cos(angle)), 0, 1)
    # the sine is good to 8e-7
    assert np.abs(fw.rotating_field(strength, field_cnt) - want).max() < 2e-6


def test_the_lead_turns_the_field_on():
    theta = np.linspace(0, 2 * np.pi, 97)
    rotor = np.stack([np.sin(theta), np.cos(theta)], axis=1).astype(np.float32)
    _, angle = field(fw.commutate(np.ones(97, np.float32), rotor, 0.1).astype(float))
    lead = (angle - theta - np.pi / 2 + np.pi) % (2 * np.pi) - np.pi
    # atan(0.1) instead of 0.1: 3e-4
    assert np.abs(lead - 0.1).max() < 5e-4


def reference_servo(p, rows, settling):
    """Eq. 21 in float64."""
    v = dict(zip(NAMES, p.astype(float), strict=True))
    integral, direction, scale, out = 0.0, 0.0, 1.0, []
    gain = v["settle_gain"] if settling else 1.0
    for command, measured, speed, acceleration in rows:
        e = (command - measured) / CNT_PER_RAD
        theta = command / CNT_PER_RAD
        direction = np.sign(speed) if speed else direction
        charge = v["k_i"] * gain * 0.0005 * (np.clip(e, -0.05, 0.05) if settling else e)
        integral = np.clip(integral + charge, -v["integral_limit"], v["integral_limit"])
        watched = v["k_p"] * e + integral
        pace = np.clip(speed, -209.44, 209.44)
        if v["drag_learning_time"]:
            scale += 0.0005 * pace * watched / (v["drag_learning_time"] * v["drag"] * 209.44**2)
        scale = np.clip(scale, 0.5, 2.0)
        feedforward = (
            v["coulomb"] * direction
            - v["spring_torque"]
            - v["spring_rate"] * theta
            + v["cogging_torque"] * np.sin(2 * theta + v["cogging_phase"])
            + v["drag"] * scale * speed
            + v["inertia"] * acceleration
        )
        out.append((v["k_p"] * e * gain + integral + feedforward, feedforward, watched, scale))
    return np.array(out)


@given(st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from([0.0, 0.1]))
@settings(max_examples=25)
def test_servo_is_equation_21(seed, settling, learning):
    rng = np.random.default_rng(seed)
    p = alpha_params(cogging_phase=rng.uniform(-3, 3), drag_learning_time=learning)
    command = np.cumsum(rng.integers(-30_000, 30_000, 300)) + rng.integers(0, 2**30)
    measured = command - rng.integers(-100_000, 100_000, 300)
    rows = np.stack(
        [command, measured, rng.uniform(-300, 300, 300), rng.uniform(-2e4, 2e4, 300)], axis=1
    ).astype(float)
    got = fw.servo(p, rows, settling)[:, :4]
    want = reference_servo(p, rows, settling)
    # float32 of torques up to 5e-4 Nm, the integral a sum of 300
    assert np.abs(got - want)[:, :3].max() < 1e-9
    assert np.abs(got - want)[:, 3].max() < 1e-4


@pytest.mark.parametrize(
    ("switch", "row"),
    [("use_break_away", (0, 0, 0, 0)), ("use_speed", (0, 0, 200, 0)), ("use_inertia", (0, 0, 0, 1e4))],
)
def test_every_feedforward_term_can_be_switched_off(switch, row):
    others = {"use_break_away", "use_speed", "use_inertia"} - {switch}
    rows = np.array([row], float)
    on = fw.servo(alpha_params(**dict.fromkeys(others, 0.0)), rows)[0, 1]
    off = fw.servo(alpha_params(**dict.fromkeys(others, 0.0), **{switch: 0.0}), rows)[0, 1]
    assert abs(on) > 5e-6
    assert off == 0


@pytest.mark.parametrize(("error_cnt", "bound"), [(20_000, 2.0), (-20_000, 0.5)])
@pytest.mark.parametrize("speed_rad_s", [200.0, -200.0])
def test_grease_is_learnt_up_to_half_or_twice_as_stiff(error_cnt, bound, speed_rad_s):
    """A rotor that lags at speed, on and on, needs more than is fed forward; one that leads less."""
    rows = np.tile([np.copysign(1, speed_rad_s) * error_cnt, 0.0, speed_rad_s, 0.0], (20_000, 1))
    scale = fw.servo(alpha_params(drag_learning_time=0.1, k_i=0.0), rows)[:, 3]
    assert scale[0] != bound
    assert scale[-1] == bound


def test_the_integral_is_bounded():
    p = alpha_params(integral_limit=1.5e-5)
    rows = np.tile([10.0 * TURN, 0.0, 0.0, 0.0], (20_000, 1))
    got = fw.servo(p, rows)
    proportional = p[NAMES.index("k_p")] * 10 * 2 * np.pi
    assert np.abs(got[:, 2] - proportional).max() < 1.5e-5 * 1.001


def test_collision_between_the_errors_of_equation_23():
    p = alpha_params()
    v = dict(zip(NAMES, p.astype(float), strict=True))
    lowest = np.rad2deg((v["collision_torque"] - v["integral_limit"]) / v["k_p"])
    highest = np.rad2deg((v["collision_torque"] + v["integral_limit"]) / v["k_p"])
    assert lowest == pytest.approx(120, abs=1)

    def first_hit(error_deg):
        rows = np.tile([error_deg * MOTOR_DEG, 0.0, 0.0, 0.0], (4000, 1))
        hits = np.flatnonzero(fw.servo(p, rows)[:, 4])
        return hits[0] if len(hits) else None

    assert first_hit(lowest - 1) is None  # not even with the integral full
    assert first_hit(lowest + 1) > 0  # once the integral is full
    assert first_hit(highest + 1) == 0  # at once: the integral cannot hide it
    assert first_hit(20) is None


# of a drive at speed: T_threshold and 8 % of the drag; a contact on the resisting side, 80 % more of it at
# standstill, and 40 % of the drag while that is not learnt
def most_feedback_Nm(speed_rad_s, feedback_sign, threshold=9e-5, contact=2e-5, drag=8e-7):
    drag_Nm = drag * abs(speed_rad_s)
    stuck_Nm = threshold + 0.08 * drag_Nm
    if feedback_sign * speed_rad_s <= 0:
        return stuck_Nm
    slow = max(1 - abs(speed_rad_s) / 100, 0)
    return min(stuck_Nm, contact * (1 + 0.8 * slow) + 0.4 * drag_Nm)


@pytest.mark.parametrize("speed_rad_s", [-150.0, -60.0, -10.0, 0.0, 10.0, 60.0, 150.0])
@pytest.mark.parametrize("feedback_sign", [-1.0, 1.0])
def test_the_collision_threshold_at_every_speed_and_on_both_sides(speed_rad_s, feedback_sign):
    p = alpha_params(collision_torque=9e-5, contact_torque=2e-5, drag=8e-7, k_i=0.0, drag_learning_time=0.0)
    least = most_feedback_Nm(speed_rad_s, feedback_sign)
    for share, hit in ((0.999, False), (1.001, True)):
        error_cnt = feedback_sign * share * least / p[NAMES.index("k_p")] * CNT_PER_RAD
        row = np.array([[round(error_cnt), 0.0, speed_rad_s, 0.0]])
        assert fw.servo(p, row)[0, 4] == hit


@pytest.mark.parametrize("turned", [False, True])
def test_what_was_learnt_one_way_is_doubted_the_other_way(turned):
    """An error of the spring is learnt as drag, and is the opposite after a turn: 5 % doubted, 12 % then."""
    p = alpha_params(collision_torque=1e-3, contact_torque=2e-5, drag=8e-7, k_i=0.0, drag_learning_time=0.1)
    learnt = np.tile([0.0, 0.0, 200.0, 0.0], (4000, 1))
    speed = -200.0 if turned else 200.0
    for share, hit in ((0.045, False), (0.055, not turned), (0.115, not turned), (0.125, True)):
        feedback_Nm = 2e-5 + share * 8e-7 * abs(speed)
        error_cnt = np.sign(speed) * feedback_Nm / p[NAMES.index("k_p")] * CNT_PER_RAD
        rows = np.vstack([learnt, [round(error_cnt), 0.0, speed, 0.0]])
        assert fw.servo(p, rows)[-1, 4] == hit, share


LEVEL = st.integers(1 - 2**30, 2**30 - 1)  # a step between two of them fits an int32


@given(st.lists(LEVEL, min_size=1, max_size=8), LEVEL)
def test_smoothing_arrives_exactly_and_never_overshoots(levels, start):
    raw = np.repeat(np.array(levels, np.int32), 40)
    got = fw.smooth(raw, start)
    position = got[:, 0]
    assert position[0] == start
    lowest, highest = min([start, *levels]), max([start, *levels])
    assert position.min() >= lowest
    assert position.max() <= highest
    # 32 ticks after the last step it is there, to the count
    assert position[-7] == levels[-1]


@given(st.lists(st.integers(-(2**20), 2**20), min_size=1, max_size=80), st.integers(-(2**20), 2**20))
def test_smoothing_is_the_mean_of_32_to_the_nearest_count(raw, start):
    got = fw.smooth(np.array(raw, np.int32), start)
    padded = np.concatenate([np.full(32, start), raw])
    # position is at the begin of a tick, raw at its end; sums of integers, halves upwards
    mean = [int(np.floor((2 * padded[k : k + 32].sum() + 32) / 64)) for k in range(len(raw))]
    np.testing.assert_array_equal(got[:, 0], mean)
    # speed and acceleration are differences of that mean, from a standstill on
    rad_s = np.array([padded[k + 32] - padded[k] for k in range(len(raw))]) / 32 * 2000 / CNT_PER_RAD
    np.testing.assert_allclose(got[:, 1], rad_s, rtol=1e-6)
    np.testing.assert_allclose(got[:, 2], np.diff(rad_s, prepend=0.0) * 2000, rtol=1e-5, atol=1.0)


def test_a_command_that_stands_has_no_acceleration():
    assert not fw.smooth(np.full(40, 1234, np.int32), 1234)[:, 1:].any()


def test_smoothing_bounds_acceleration_and_lag():
    speed_cnt = 17_476  # 2000 rpm in counts a tick
    raw = np.concatenate([np.zeros(50), np.arange(1, 200) * speed_cnt]).astype(np.int32)
    got = fw.smooth(raw, 0)
    assert np.abs(got[:, 2]).max() == pytest.approx(209.4 / 0.016, rel=2e-3)
    # raw[i] is the end of tick i, position[i] its beginning
    lag = (np.concatenate([[0], raw[:-1]]) - got[:, 0])[120:]
    assert lag / speed_cnt == pytest.approx(15.5, abs=0.01)  # 7.75 ms


@given(
    st.integers(-(2**30), 2**30),
    st.integers(-(2**30), 2**30),
    st.floats(200, 5000),
    st.floats(200, 5000),
)
@settings(max_examples=60, deadline=None)
def test_a_profile_keeps_its_limits_and_ends_exactly(start, target, rpm, acceleration):
    track = fw.profile(start, target, rpm, acceleration).astype(np.int64)
    if start == target:
        assert len(track) == 0
        return
    assert track[-1] == target
    p = np.concatenate([[start], track])
    step = np.diff(p)
    speed = rpm * 2**20 / 120_000
    a = acceleration / (2 * np.pi) * 2**20 / 4e6
    assert np.abs(step).max() <= speed + 1  # a count of rounding
    # in the middle of ticks: two counts of rounding; the first step is half an acceleration
    assert np.abs(np.diff(step)).max() <= a + 2
    assert np.abs(step[[0, -1]]).max() <= a / 2 + 2
    assert (np.sign(step[step != 0]) == np.sign(target - start)).all()
    # no slower than a trapezoid must be, but for two ticks that are not whole and rounding of float32
    d = abs(target - start)
    ideal = d / speed + speed / a if d > speed**2 / a else 2 * np.sqrt(d / a)
    assert len(track) <= ideal * (1 + 1e-6) + 2


def test_a_short_profile_ramps_in_as_few_ticks_as_the_acceleration_allows():
    acceleration, count_rad = 1000.0, 2 * np.pi / 2**20
    for distance in (50_000, 200_000, 777_777):
        n_ramp = len(fw.profile(0, distance, 5000.0, acceleration)) // 2
        # n^2 a T^2 is the way of two ramps of n ticks
        assert (n_ramp - 1) ** 2 * acceleration * 0.0005**2 < distance * count_rad
        assert n_ramp**2 * acceleration * 0.0005**2 >= distance * count_rad * (1 - 1e-6)


points = st.lists(st.tuples(st.integers(-(2**29), 2**29), st.integers(1, 70_000)), min_size=1, max_size=12)


@given(points, st.integers(-(2**29), 2**29))
@settings(max_examples=60, deadline=None)
def test_a_path_is_straight_between_its_points_and_meets_them(increments, here):
    ticks = np.cumsum([t for _, t in increments]) - 1
    table = np.array([[p, t] for (p, _), t in zip(increments, ticks, strict=True)], np.int32)
    n = min(int(ticks[-1]) + 3, 200_000)
    got, slots, done = fw.path(table, here, n)
    want = np.interp(np.arange(n), np.concatenate([[-1], ticks]), np.concatenate([[here], table[:, 0]]))
    assert np.abs(got - want).max() < 1  # the integer part of the straight line
    for position, tick in table:
        if tick < n:
            assert got[tick] == position
    assert done == (n > ticks[-1])
    assert slots == len(table) + sum(t > 65_535 for t in np.diff(np.concatenate([[-1], ticks])))


def test_a_thousand_points_fit_and_cost_six_bytes():
    ticks = np.arange(1, 1001) * 65_535 - 1
    table = np.stack([np.arange(1000), ticks], axis=1).astype(np.int32)
    got, slots, _ = fw.path(table, 0, 10)
    assert slots == 1000
    assert len(got) == 10


@pytest.mark.parametrize(
    ("short", "long", "taken"),
    [(1024, 0, True), (1025, 0, False), (1022, 1, True), (1023, 1, False), (0, 512, True), (0, 513, False)],
)
def test_a_path_holds_1024_slots_of_which_a_long_gap_takes_two(short, long, taken):
    gaps = np.concatenate([np.full(short, 2), np.full(long, 2**16)])
    points = np.stack([np.arange(gaps.size), np.cumsum(gaps) - 1], axis=1).astype(np.int32)
    if taken:
        assert fw.path(points, 0, 1)[1] == short + 2 * long
    else:
        with pytest.raises(ValueError, match=f"point {gaps.size - 1} "):
            fw.path(points, 0, 1)


def test_a_gap_of_65535_ticks_is_short_and_one_more_is_long():
    slots = [fw.path(np.array([[5, gap - 1]], np.int32), 0, 1)[1] for gap in (2**16 - 1, 2**16)]
    assert slots == [1, 2]


def test_a_path_whose_time_does_not_grow_is_refused():
    with pytest.raises(ValueError, match="point 1"):
        fw.path(np.array([[0, 5], [9, 5]], np.int32), 0, 10)


@given(
    st.floats(1900, 2200),
    st.floats(1900, 2200),
    st.floats(800, 1800),
    st.floats(800, 1800),
    st.floats(-0.4, 0.4),
)
@settings(max_examples=30, deadline=None)
def test_hall_calibration_finds_offset_gain_and_phase(oa, ob, aa, ab, phase):
    rng = np.random.default_rng(1)
    theta = np.linspace(0, 4 * np.pi, 2000)
    clean = np.stack([oa + aa * np.sin(theta), ob + ab * np.cos(theta + phase)], axis=1)
    samples = np.round(clean + rng.normal(0, 3, clean.shape)).astype(np.uint16)
    offset_a, offset_b, amplitude_a, amplitude_b, angle, residual = fw.hall_fit(samples)
    # 3 counts of noise over 2000 samples: 0.1 count each; the fit's bias is noise^2/amplitude
    assert (offset_a, offset_b) == pytest.approx((oa, ob), abs=0.6)
    assert (amplitude_a, amplitude_b) == pytest.approx((aa, ab), abs=0.8)
    assert angle == pytest.approx(phase, abs=1e-3)
    assert residual < 3.5 / 800 + 1e-3


@pytest.mark.parametrize("start", np.deg2rad([-40, 50, 140, 230]))
@pytest.mark.parametrize("phase", [-0.3, 0.3])
def test_hall_calibration_knows_the_ellipse_from_half_of_it(start, phase):
    # the middle of the range is not the centre then, but 40 counts and more beside it on both channels
    theta = np.linspace(start, start + np.pi, 2000)
    samples = adc(theta, (2000, 2100), (1500, 1200), phase)
    middle = (samples.max(axis=0) / 2 + samples.min(axis=0) / 2) - (2000, 2100)
    assert np.abs(middle).min() > 40
    found = fw.hall_fit(samples)
    # rounding of the converter, 0.3 counts rms on 2000 samples, and float32 sums
    assert found[:2] == pytest.approx((2000, 2100), abs=0.5)
    assert found[2:4] == pytest.approx((1500, 1200), abs=0.5)
    assert found[4] == pytest.approx(phase, abs=5e-4)


@pytest.mark.parametrize("start", np.deg2rad(np.arange(0, 360, 30)))
def test_hall_calibration_knows_the_ellipse_from_a_third_of_it(start):
    theta = np.linspace(start, start + 2 * np.pi / 3, 2000)
    found = fw.hall_fit(adc(theta, (2000, 2100), (1500, 1500)))
    # an arc of 120 degrees leaves some times more of the converter's rounding than half a turn
    assert found[:4] == pytest.approx((2000, 2100, 1500, 1500), abs=2.0)
    assert found[4] == pytest.approx(0.0, abs=2e-3)


def test_hall_calibration_refuses_a_dead_channel():
    assert fw.hall_fit(np.full((500, 2), 2048, np.uint16)) is None


@pytest.mark.parametrize("channel", [0, 1])
def test_hall_calibration_refuses_an_amplitude_below_a_hundred_counts(channel):
    amplitude = np.full(2, 1500.0)
    # rounding of the converter: 0.3 counts rms over 2000 samples
    amplitude[channel] = 101.0
    assert fw.hall_fit(adc(np.linspace(0, 4 * np.pi, 2000), amplitude=amplitude)) is not None
    amplitude[channel] = 99.0
    assert fw.hall_fit(adc(np.linspace(0, 4 * np.pi, 2000), amplitude=amplitude)) is None


def test_hall_calibration_refuses_less_than_a_hundred_samples():
    theta = np.linspace(0, 2 * np.pi, 101)[1:]
    assert fw.hall_fit(adc(theta)) is not None
    assert fw.hall_fit(adc(theta[1:])) is None


def sweep(samples, coulomb=2e-5, spring=5e-6, cogging=1e-5, phase=0.7, back=None, turns=4.0):
    """Rows of a sweep of so many turns each way, torque as Eq. 11 and Fig. 11 have it."""
    rows = []
    for direction, count in ((1.0, samples), (-1.0, samples if back is None else back)):
        rotor = np.round(np.arange(count) * (turns * TURN / max(count, 1)))
        angle = 2 * rotor / CNT_PER_RAD + phase
        torque = coulomb * direction - spring + cogging * np.sin(angle)
        rows.append(np.stack([np.full(count, direction), rotor, torque], axis=1))
    return np.concatenate(rows)


@pytest.mark.parametrize(("coulomb", "spring", "cogging", "phase"), [(2e-5, 5e-6, 1e-5, 0.7),
                                                                     (2e-6, -3e-6, 4e-6, -2.5)])  # fmt: skip
def test_friction_fit_tells_friction_spring_and_cogging_apart(coulomb, spring, cogging, phase):
    found = fw.friction_fit(sweep(1000, coulomb, spring, cogging, phase))
    # float32 sums of 2000 terms
    assert found[:3] == pytest.approx((coulomb, spring, cogging), rel=1e-3)
    assert found[3] == pytest.approx(phase, abs=1e-3)


def test_friction_fit_of_few_samples_begins_at_nothing():
    """What is left in the sums from before would weigh as one sample of 200."""
    found = fw.friction_fit(sweep(100))
    assert found[:3] == pytest.approx((2e-5, 5e-6, 1e-5), rel=1e-4)


def test_friction_fit_knows_the_cogging_from_a_twelfth_of_a_turn():
    found = fw.friction_fit(sweep(100, turns=1 / 12))
    # sine and cosine are nearly alike there with the spring: float32 sums leave a thousandth
    assert found[:3] == pytest.approx((2e-5, 5e-6, 1e-5), rel=5e-3)


@pytest.mark.parametrize(("forth", "back", "good"), [(100, 100, True), (99, 100, False), (100, 99, False)])
def test_friction_fit_needs_a_hundred_samples_each_way(forth, back, good):
    assert (fw.friction_fit(sweep(forth, back=back)) is not None) == good


def test_friction_fit_refuses_friction_that_drives_and_a_rotor_that_did_not_turn():
    assert fw.friction_fit(sweep(500, coulomb=-1e-6)) is None
    held = sweep(500)
    held[:, 1] = 1000
    assert fw.friction_fit(held) is None


@pytest.mark.parametrize(("x", "nearest"), [(0.0, 0), (0.49, 0), (0.5, 1), (1.49, 1), (-0.49, 0), (-0.5, -1),
                                            (-1.49, -1), (-1.51, -2), (2.0e9, 2_000_000_000)])  # fmt: skip
def test_rounding_is_to_the_nearest_halves_away_from_zero(x, nearest):
    assert fw.round_i32(x) == nearest


def test_default_parameters_are_good_and_bad_ones_are_named():
    assert fw.params_fault(alpha_params()) == -1
    assert fw.params_fault(alpha_params(k_p=-1.0)) == NAMES.index("k_p")
    assert fw.params_fault(alpha_params(inertia=np.nan)) == NAMES.index("inertia")
    assert fw.params_fault(alpha_params(position_min=50, position_max=40)) == NAMES.index("position_max")
    assert fw.params_fault(alpha_params(collision_torque=1e-6)) == NAMES.index("collision_torque")


def test_parameter_names_are_unique_and_defaults_inside_limits():
    assert len(set(NAMES)) == len(NAMES)
    for name, _unit, low, high, default, _doc in fw.AXIS_PARAMS:
        assert low <= default <= high, name


@pytest.mark.parametrize(
    ("gaps", "n_slots"),
    [([1] * 1024, 1024), ([70_000] * 512, 1024), ([70_000] * 511 + [1, 1], 1024), ([65_535] * 1024, 1024)],
)
def test_a_path_takes_what_its_memory_holds_and_no_more(gaps, n_slots):
    # a gap above 65535 ticks takes two slots of 1024; time begins at -1
    points = np.stack([np.arange(len(gaps)), np.cumsum(gaps) - 1], axis=1).astype(np.int32)
    assert fw.path(points, 0, 1)[1] == n_slots
    one_more = np.vstack([points, points[-1:] + 1]).astype(np.int32)
    with pytest.raises(ValueError, match=f"point {len(gaps)} was not taken"):
        fw.path(one_more, 0, 1)


def test_half_a_long_gap_does_not_fit():
    gaps = [70_000] * 511 + [1, 65_536]
    points = np.stack([np.arange(513), np.cumsum(gaps)], axis=1).astype(np.int32)
    with pytest.raises(ValueError, match="point 512 was not taken"):
        fw.path(points, 0, 1)
