"""Commands 230 to 236: parameters are set in a copy, and take effect together or not at all."""

import struct
import zlib

import numpy as np
import pytest

import rig
from fiberloom._core import firmware as fw
from fiberloom.bus.parameters import table_crc
from rig import ACCEPTED, NAMES, Rig

TABLE, BEGIN, SET_ALPHA, SET_BETA, COMMIT, GET_ALPHA, GET_BETA = range(230, 237)
SAVE = 53


def begin(unit):
    return unit.code(BEGIN, struct.pack("<I", table_crc()))


def put(unit, axis, name, value):
    return unit.code(SET_ALPHA + axis, struct.pack("<Bf", NAMES.index(name), value))


def commit(unit, rows):
    return unit.code(COMMIT, struct.pack("<I", zlib.crc32(rows.tobytes())))


def get(unit, axis, name):
    code, data = unit.ask(GET_ALPHA + axis, bytes([NAMES.index(name)]))
    assert code == ACCEPTED
    index, value = struct.unpack("<Bf", data)
    assert NAMES[index] == name
    return value


def state(unit):
    """CRC-32 of the table and of the values in force."""
    code, data = unit.ask(TABLE)
    assert code == ACCEPTED
    return struct.unpack("<II", data)


def changed(**changes):
    """Parameters of both axes with some of alpha's and beta's changed: name=(alpha, beta)."""
    rows = rig.params()
    for name, pair in changes.items():
        rows[:, NAMES.index(name)] = pair
    return rows


def test_both_sides_compute_the_same_checksums():
    assert state(Rig()) == (table_crc(), zlib.crc32(rig.params().tobytes()))


def test_every_parameter_is_read_by_its_index():
    unit, rows = Rig(), rig.params()
    for axis in (0, 1):
        for k, name in enumerate(NAMES):
            assert get(unit, axis, name) == rows[axis, k]
        assert unit.code(GET_ALPHA + axis, bytes([len(NAMES)])) == rig.OUT_OF_RANGE


def test_what_was_set_takes_effect_at_the_commit_and_drives_the_motor():
    unit, rows = Rig(), changed(coulomb=(1.5e-5, 2.5e-6), drag=(9e-7, 9e-8))
    assert begin(unit) == ACCEPTED
    for axis in (0, 1):
        for name in ("coulomb", "drag"):
            assert put(unit, axis, name, rows[axis, NAMES.index(name)]) == ACCEPTED
    before = state(unit)[1]
    assert before == zlib.crc32(rig.params().tobytes())
    assert commit(unit, rows) == ACCEPTED
    assert state(unit)[1] == zlib.crc32(rows.tobytes()) != before
    assert unit.status("config_changed")
    assert unit.goto(12.0, 22.0) == ACCEPTED
    unit.wait()
    assert np.abs(np.subtract(unit.true_deg(), (12.0, 22.0))).max() < 0.002


def test_a_feedforward_set_over_the_bus_is_the_one_that_is_used():
    """10 uNm more of Coulomb friction are 10 uNm more of feedforward; the parameters are not just stored."""
    feedforward = []
    for coulomb in (2e-5, 3e-5):
        unit = Rig(noise_cnt=0.0, drag_learning_time=0.0)
        rows = changed(coulomb=(coulomb, 2e-6), drag_learning_time=(0.0, 0.0))
        assert begin(unit) == put(unit, 0, "coulomb", coulomb) == commit(unit, rows) == ACCEPTED
        assert unit.goto(20.0, 20.0) == ACCEPTED
        feedforward.append(unit.unit.run(1000, 0)[700:, 4].mean())
    # cogging averages out to some percent over six motor turns
    assert feedforward[1] - feedforward[0] == pytest.approx(1e-5, rel=0.1)


def test_a_lost_frame_makes_the_commit_fail_and_the_old_ones_go_on():
    unit, rows = Rig(), changed(coulomb=(1.5e-5, 2e-6), drag=(9e-7, 8e-8))
    before = state(unit)
    assert begin(unit) == put(unit, 0, "coulomb", 1.5e-5) == ACCEPTED  # that of the drag is lost
    assert commit(unit, rows) == rig.INVALID
    assert state(unit) == before
    assert put(unit, 0, "drag", 9e-7) == commit(unit, rows) == ACCEPTED


def test_another_table_may_not_write():
    unit = Rig()
    assert unit.code(BEGIN, struct.pack("<I", table_crc() ^ 1)) == rig.OUT_OF_RANGE
    assert put(unit, 0, "coulomb", 1.5e-5) == rig.INVALID
    assert commit(unit, rig.params()) == rig.INVALID


@pytest.mark.parametrize("name", NAMES)
def test_the_range_of_every_parameter_is_kept(name):
    unit = Rig()
    begin(unit)
    _, _, low, high, *_ = fw.AXIS_PARAMS[NAMES.index(name)]
    low, high = np.float32(low), np.float32(high)
    for good in (low, high):
        assert put(unit, 1, name, good) == ACCEPTED
    below, above = np.nextafter(low, np.float32(-np.inf)), np.nextafter(high, np.float32(np.inf))
    for bad in (below, above, float("nan"), float("inf")):
        assert put(unit, 1, name, bad) == rig.OUT_OF_RANGE


def test_no_index_beyond_the_table():
    unit = Rig()
    begin(unit)
    for index in (len(NAMES), 255):
        assert unit.code(SET_ALPHA, struct.pack("<Bf", index, 0.0)) == rig.OUT_OF_RANGE


@pytest.mark.parametrize(
    ("name", "value"), [("position_max", -10.0), ("collision_torque", 1e-7), ("speed_default", 5500.0)]
)
def test_values_that_do_not_go_together_are_refused_as_a_whole(name, value):
    unit, rows = Rig(), rig.params()
    before = state(unit)
    rows[0, NAMES.index(name)] = value
    assert begin(unit) == put(unit, 0, name, value) == ACCEPTED
    assert commit(unit, rows) == rig.OUT_OF_RANGE
    assert state(unit) == before
    assert unit.status("initialized")


def test_nothing_is_set_in_motion():
    unit, rows = Rig(), changed(coulomb=(1.5e-5, 2e-6))
    assert begin(unit) == put(unit, 0, "coulomb", 1.5e-5) == ACCEPTED
    assert unit.goto(60.0, 60.0) == ACCEPTED
    unit.unit.tick(100)
    assert begin(unit) == put(unit, 0, "coulomb", 1e-5) == commit(unit, rows) == rig.IN_MOTION
    assert unit.code(TABLE) == rig.IN_MOTION
    assert get(unit, 0, "coulomb") == np.float32(2e-5)
    unit.wait()
    assert commit(unit, rows) == ACCEPTED


def test_a_loaded_trajectory_was_judged_by_the_old_ones():
    unit, rows = Rig(), changed(coulomb=(1.5e-5, 2e-6))
    assert begin(unit) == put(unit, 0, "coulomb", 1.5e-5) == ACCEPTED
    assert unit.load([(1.0, 10.0)], [(1.0, 20.0)]) == ACCEPTED
    assert commit(unit, rows) == rig.INVALID


def test_saved_ones_outlive_a_power_cut_and_others_do_not():
    unit, rows = Rig(), changed(coulomb=(1.5e-5, 2e-6))
    factory = state(unit)
    assert begin(unit) == put(unit, 0, "coulomb", 1.5e-5) == commit(unit, rows) == ACCEPTED
    unit.unit.power_up()
    assert state(unit) == factory
    assert begin(unit) == put(unit, 0, "coulomb", 1.5e-5) == commit(unit, rows) == ACCEPTED
    assert unit.code(SAVE) == ACCEPTED
    unit.unit.power_up()
    assert state(unit)[1] == zlib.crc32(rows.tobytes())


def test_a_power_cut_forgets_a_begun_copy():
    unit = Rig()
    assert begin(unit) == put(unit, 0, "coulomb", 1.5e-5) == ACCEPTED
    unit.unit.power_up()
    assert put(unit, 0, "coulomb", 1.5e-5) == rig.INVALID
