"""Every command and every malformed kind of it: the right code, one reply, nothing changed."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rig
from fiberloom._core import firmware as fw
from rig import ACCEPTED, Rig, pair, point

TABLE = {row["number"]: row for row in fw.command_table()}
NUMBERS = sorted(TABLE)
JAEGER = [
    1, 2, 3, 10, 11, 12, 13, 14, 15, 18, 20, 21, 22, 23, 24, 25, 26, 27, 28, 30, 31, 32, 33, 34, 35,
    40, 41, 45, 47, 48, 49, 53, 56, 104, 105, 111, 112, 113, 116, 117, 118, 119, 120, 121, 122, 123,
    124, 125, 126, 127, 128, 129, 130, 131, 132, 139, 140, 200, 201,
]  # fmt: skip
PARAMS = [230, 231, 232, 233, 234, 235, 236]  # beyond what jaeger sends
BENCH = [240, 241, 242, 243, 244, 245, 246]
BROADCAST = {1, 2, 3, 14, 15}


def payload(number):
    return b"\0" * TABLE[number]["length"][1]


def test_the_table_has_every_command_of_the_protocol_in_order():
    assert NUMBERS == JAEGER + PARAMS + BENCH
    assert [row["number"] for row in fw.command_table()] == NUMBERS


def test_only_five_commands_can_be_broadcast():
    assert {n for n in NUMBERS if TABLE[n]["broadcast"]} == BROADCAST
    assert {n for n in NUMBERS if TABLE[n]["bootloader"]} == {1, 2, 3, 200, 201}


def test_an_unknown_command_is_named_so():
    unit = Rig()
    before = unit.unit.memory
    for number in sorted(set(range(256)) - set(NUMBERS)):
        assert unit.code(number) == rig.UNKNOWN
        assert unit.code(number, b"12345678", to=0) == rig.UNKNOWN
        assert changed_only_by_sending(before, unit.unit.memory)


def changed_only_by_sending(before, after):
    """The queue's ring keeps what was sent, and any request is a sign of life: compare all but these."""
    return mask(before) == mask(after)


def mask(memory):
    for offset, size in (fw.TX_QUEUE, fw.HEARD_TICK):
        memory = memory[:offset] + bytes(size) + memory[offset + size :]
    return memory


@pytest.mark.parametrize("number", NUMBERS)
def test_a_wrong_length_is_refused_and_changes_nothing(number):
    low, high = TABLE[number]["length"]
    unit = Rig()
    before = unit.unit.memory
    for length in set(range(9)) - set(range(low, high + 1)):
        assert unit.code(number, b"\1" * length) == rig.WRONG_LENGTH
        assert changed_only_by_sending(before, unit.unit.memory)


@pytest.mark.parametrize("number", NUMBERS)
def test_a_broadcast_that_is_not_allowed_is_refused(number):
    unit = Rig()
    before = unit.unit.memory
    code, data = unit.ask(number, payload(number), to=0)
    if number in BROADCAST:
        assert code == ACCEPTED
    else:
        assert code == rig.INVALID_BROADCAST
        assert data == b""
        assert changed_only_by_sending(before, unit.unit.memory)


@pytest.mark.parametrize("number", NUMBERS)
def test_frames_for_others_and_replies_are_not_answered(number):
    unit = Rig()
    before = unit.unit.memory
    unit.unit.receive(fw.encode_identifier(6, number, 1), payload(number))
    unit.unit.receive(fw.encode_identifier(5, number, 1, 3), payload(number))
    unit.unit.receive(1 << 29 | fw.encode_identifier(5, number, 1), payload(number))
    assert unit.unit.take_frames() == []
    assert unit.unit.memory == before


# what each motion or rest-only command answers in a state, by the class of the protocol's section 14
REST_ONLY = [n for n in NUMBERS if TABLE[n]["input"] not in
             {fw.INPUTS[i] for i in ("QUERY", "STOP", "BOOT", "IMPOSSIBLE")}]  # fmt: skip


@pytest.mark.parametrize("number", REST_ONLY)
def test_while_moving(number):
    unit = Rig()
    assert unit.goto(30, 40) == ACCEPTED
    unit.unit.tick(50)
    before = unit.unit.memory
    assert unit.code(number, payload(number)) == rig.IN_MOTION
    assert changed_only_by_sending(before, unit.unit.memory)


@pytest.mark.parametrize("start", [20, 23, 26, 47])
@pytest.mark.parametrize("number", REST_ONLY)
def test_while_calibrating(start, number):
    unit = Rig()
    assert unit.code(start) == ACCEPTED
    unit.unit.tick(20)
    before = unit.unit.memory
    assert unit.code(number, payload(number)) == rig.CALIBRATING
    assert changed_only_by_sending(before, unit.unit.memory)


def collided():
    unit = Rig()
    unit.goto(30, 40)
    unit.unit.tick(600)
    unit.unit.set_plant(0, "blocked", 1)
    unit.wait()
    unit.unit.set_plant(0, "blocked", 0)
    assert unit.status("collision_alpha")
    return unit


@pytest.mark.parametrize("number", [10, 14, 20, 21, 22, 23, 24, 25, 26, 27, 28, 30, 31, 47, 48, 49])
def test_while_collided(number):
    unit = collided()
    before = unit.unit.memory
    assert unit.code(number, payload(number)) == rig.COLLISION
    assert changed_only_by_sending(before, unit.unit.memory)


def test_stop_clears_a_collision_and_abort_keeps_it():
    unit = collided()
    assert unit.code(13) == ACCEPTED
    assert unit.status("collision_alpha")
    assert unit.code(15, to=0) == ACCEPTED
    assert not unit.status("collision_alpha")
    assert unit.goto(30, 40) == ACCEPTED


@pytest.mark.parametrize(("number", "code"), [(10, 4), (30, 4), (31, 4), (47, 4), (20, 14), (14, 0)])
def test_without_a_datum(number, code):
    unit = Rig(known=False)
    before = unit.unit.memory
    data = struct.pack("<II", 2, 2) if number == 10 else payload(number)
    assert unit.code(number, data) == code
    assert changed_only_by_sending(before, unit.unit.memory)


@pytest.mark.parametrize(("number", "code"), [(10, 7), (30, 7), (20, 7), (23, 7), (26, 0), (47, 7)])
def test_without_hall_calibration(number, code):
    unit = Rig()
    unit.unit.forget_calibration(1, hall=True)
    data = struct.pack("<II", 2, 2) if number == 10 else payload(number)
    assert unit.code(number, data) == code


def test_only_the_axes_of_a_command_must_be_calibrated():
    unit = Rig()
    unit.unit.forget_calibration(1, hall=True, datum=True)
    assert unit.code(22) == rig.MOTOR_NOT_CALIBRATED
    assert unit.code(21) == ACCEPTED


def u32(*values):
    return struct.pack("<" + "I" * len(values), *values)


OUT_OF_RANGE = [
    (10, u32(0, 2)),
    (10, u32(2, 0)),
    (10, u32(1001, 2)),
    (10, u32(2, 2**32 - 1)),
    (30, pair(-4.1, 20)),
    (30, pair(20, 364.1)),
    (30, struct.pack("<ii", 2**31 - 1, 0)),
    (30, struct.pack("<ii", 0, -(2**31))),
    (31, pair(-14.1, 0)),
    (31, struct.pack("<ii", 2**31 - 1, 0)),
    (33, pair(-14.1, 0)),
    (33, pair(0, 374.1)),
    (35, pair(10.1, 0)),
    (40, u32(0, 100)),
    (40, u32(100, 5001)),
    (40, u32(2**32 - 1, 100)),
    (41, u32(101, 50)),
    (112, u32(50, 101)),
    (111, struct.pack("<i", -61)),
    (111, struct.pack("<i", 361)),
]


@pytest.mark.parametrize(("number", "data"), OUT_OF_RANGE)
def test_values_out_of_range(number, data):
    unit = Rig()
    before = unit.unit.memory
    assert unit.code(number, data) == rig.OUT_OF_RANGE
    assert changed_only_by_sending(before, unit.unit.memory)


@pytest.mark.parametrize(
    "data", [point(1, -4.1), point(1, 364.1), struct.pack("<ii", 0, -1), struct.pack("<ii", 0, 2**30)]
)
def test_points_out_of_range(data):
    unit = Rig()
    assert unit.code(10, u32(2, 2)) == ACCEPTED
    before = unit.unit.memory
    assert unit.code(11, data) == rig.OUT_OF_RANGE
    assert changed_only_by_sending(before, unit.unit.memory)


def test_limits_themselves_are_legal():
    unit = Rig()
    assert unit.goto(364, -4) == ACCEPTED


@pytest.mark.parametrize(
    ("alpha", "beta"),
    [
        ([(0.5, 10), (0.5, 11)], [(1, 20)]),  # time does not grow
        ([(0.5, 10), (0.4, 11)], [(1, 20)]),
        ([(0.5, 10), (0.6, 20)], [(1, 20)]),  # 100 deg/s
        ([(0.5, 30), (1.6, 30)], [(1, 20)]),  # 20 degrees away in half a second
        ([(0.5, 10)], [(0.0, 25)]),
    ],
)
def test_a_bad_trajectory_is_refused_at_the_end_and_again_at_the_start(alpha, beta):
    unit = Rig()
    assert unit.load(alpha, beta) == rig.INVALID_TRAJECTORY
    assert unit.code(14, to=0) == rig.INVALID_TRAJECTORY
    assert unit.code(11, point(2, 10)) == rig.INVALID_TRAJECTORY
    assert unit.status("completed")
    # STOP drops it: START then has nothing to do
    assert unit.code(15) == ACCEPTED
    assert unit.code(14, to=0) == ACCEPTED
    assert unit.load([(0.5, 10), (1, 11)], [(1, 20)]) == ACCEPTED


def test_too_few_and_too_many_points():
    unit = Rig()
    assert unit.code(10, u32(2, 1)) == ACCEPTED
    assert unit.code(11, point(0.5, 10)) == ACCEPTED
    assert unit.code(12) == rig.INVALID_TRAJECTORY
    assert unit.code(10, u32(1, 1)) == ACCEPTED
    assert unit.code(11, point(0.5, 10)) == ACCEPTED
    assert unit.code(11, point(0.5, 20)) == ACCEPTED
    before = unit.unit.memory
    assert unit.code(11, point(0.9, 20)) == rig.INVALID_TRAJECTORY
    assert changed_only_by_sending(before, unit.unit.memory)
    assert unit.code(12) == ACCEPTED


def test_a_thousand_points_an_axis_are_taken():
    unit = Rig()
    assert unit.code(10, u32(1000, 1000)) == ACCEPTED
    for position in (10, 20):
        for k in range(1000):
            assert unit.code(11, struct.pack("<ii", int(position * rig.COUNTS_PER_DEG), 100 * k)) == 0
    assert unit.code(12) == ACCEPTED


def test_a_moved_axis_makes_a_loaded_trajectory_invalid():
    unit = Rig()
    assert unit.load([(0.5, 10), (1, 11)], [(1, 20)]) == ACCEPTED
    assert unit.code(33, pair(50, 20)) == ACCEPTED
    assert unit.code(14) == rig.INVALID_TRAJECTORY
    assert unit.status("completed")


def test_status_while_loading():
    unit = Rig()
    names = ("receiving", "alpha_received", "beta_received")
    assert unit.status(*names) == (False, False, False)
    unit.code(10, u32(1, 1))
    assert unit.status(*names) == (True, False, False)
    unit.code(11, point(0.5, 10))
    assert unit.status(*names) == (True, True, False)
    unit.code(11, point(0.5, 20))
    assert unit.status(*names) == (True, True, True)
    unit.code(12)
    assert unit.status(*names) == (False, True, True)
    unit.code(13)
    assert unit.status(*names) == (False, False, False)


def test_queries():
    unit = Rig()
    assert unit.ask(1) == (ACCEPTED, u32(5))
    assert unit.ask(2) == (ACCEPTED, bytes([21, 1, 4, 0]))
    assert len(unit.ask(3)[1]) == 8
    code, data = unit.ask(32)
    assert code == ACCEPTED
    alpha, beta = struct.unpack("<ii", data)
    assert alpha / rig.COUNTS_PER_DEG == pytest.approx(10, abs=1e-3)
    assert beta / rig.COUNTS_PER_DEG == pytest.approx(20, abs=1e-3)
    assert unit.ask(34) == (ACCEPTED, bytes(8))
    assert unit.ask(45) == (ACCEPTED, bytes(8))
    assert unit.ask(56) == (ACCEPTED, u32(100, 100))
    assert unit.ask(113) == (ACCEPTED, u32(0, 0))
    assert unit.ask(104) == (ACCEPTED, struct.pack("<4H", 3548, 3548, 548, 548))
    assert len(unit.ask(132)[1]) == 4
    assert unit.ask(139) == (ACCEPTED, u32(0))


def test_settings_come_back():
    unit = Rig()
    assert unit.ask(35, pair(1, -2)) == (ACCEPTED, b"")
    assert unit.ask(34)[1] == pair(1, -2)
    assert unit.ask(41, u32(80, 60)) == (ACCEPTED, b"")
    assert unit.ask(56)[1] == u32(80, 60)
    assert unit.ask(112, u32(30, 20)) == (ACCEPTED, b"")
    assert unit.ask(113)[1] == u32(30, 20)
    assert unit.ask(140, u32(77)) == (ACCEPTED, b"")
    assert unit.ask(139)[1] == u32(77)
    assert unit.status("config_changed")
    assert unit.ask(40, u32(1000, 500)) == (ACCEPTED, b"")


def test_modes_show_in_the_status():
    unit = Rig()
    assert unit.status("closed_alpha", "closed_beta", "detect_off_alpha") == (True, True, False)
    assert unit.code(121) == ACCEPTED
    assert unit.status("closed_alpha", "closed_beta", "detect_off_alpha") == (False, True, True)
    assert unit.code(118) == ACCEPTED
    assert unit.status("closed_alpha", "detect_off_alpha") == (True, False)
    assert unit.status("precise_alpha", "precise_beta") == (False, False)
    assert unit.code(130) == ACCEPTED
    assert unit.status("precise_alpha", "precise_beta") == (False, True)
    assert unit.code(131) == ACCEPTED
    assert not unit.status("precise_beta")
    assert unit.code(117) == ACCEPTED
    assert unit.status("hall_off")
    assert unit.code(116) == ACCEPTED
    assert not unit.status("hall_off")
    assert unit.code(126) == unit.code(127) == ACCEPTED


def test_replies_wait_for_the_mailbox_and_keep_their_order():
    unit = Rig()
    unit.unit.mailbox_open = False
    for uid in range(1, 41):
        unit.unit.receive(fw.encode_identifier(5, 1, uid))
    assert not unit.unit.at_rest()
    unit.unit.mailbox_open = True
    unit.unit.tick()
    # sixteen fit; what could not be answered was not carried out either
    assert [r[1] for r in unit.frames()] == list(range(1, 17))
    assert unit.unit.at_rest()


def test_bad_parameters_are_seen_and_nothing_moves():
    unit = Rig(k_p=-1.0)
    assert not unit.status("initialized")
    assert unit.goto(12, 22) == rig.INVALID
    assert unit.code(20) == rig.INVALID
    assert unit.status("completed")


@given(
    st.lists(
        st.tuples(
            st.sampled_from([*NUMBERS, 0, 16, 222]), st.binary(max_size=8), st.booleans(), st.integers(0, 40)
        ),
        max_size=40,
    )
)
@settings(max_examples=150, deadline=None)
def test_any_frames_in_any_order_get_one_reply_each_and_never_break_it(frames):
    unit = Rig()
    for number, data, broadcast, ticks in frames:
        code, reply = unit.ask(number, data, to=0 if broadcast else None)
        assert 0 <= code <= 15
        assert code == ACCEPTED or reply == b""
        unit.unit.tick(ticks)
    assert unit.code(15) == ACCEPTED
    unit.wait(5)
    assert unit.unit.state == fw.STATES["IDLE"]


# Of three frames out of the commands of motion, all that may move something: GOTO, datum search and
# calibrations. START alone, points, ends: never.
@given(
    st.lists(
        st.sampled_from([1, 2, 3, 10, 11, 12, 13, 14, 15, 18, 32, 33, 40, 53, 111, 118, 125, 200, 201]),
        max_size=12,
    )
)
@settings(max_examples=100, deadline=None)
def test_nothing_moves_without_a_valid_sequence(numbers):
    unit = Rig()
    off = unit.unit.duty(0)
    for number in numbers:
        unit.ask(number, payload(number))
        unit.unit.tick(3)
        assert unit.unit.duty(0) == off == (0, 0, 0)
        assert unit.status("completed")
