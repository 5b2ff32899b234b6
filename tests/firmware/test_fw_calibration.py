"""Self-calibrations, datum search, storage over power cuts, bootloader."""

import struct
import zlib

import numpy as np
import pytest

import rig
from fiberloom._core import firmware as fw
from rig import ACCEPTED, NAMES, Rig, pair

STOP_DEG = -4.0  # datum_position


def with_stops(unit, stop_deg=STOP_DEG):
    for axis in (0, 1):
        unit.unit.set_plant(axis, "stop_rad", np.deg2rad(stop_deg) * 1024)
    return unit


def value(unit, axis, name):
    return float(unit.unit.params(axis)[NAMES.index(name)])


@pytest.mark.parametrize(("command", "moves"), [(20, (True, True)), (21, (True, False)), (22, (False, True))])
def test_the_datum_search_finds_the_stop_and_goes_to_zero(command, moves):
    unit = with_stops(Rig(position_deg=(3.0, 2.0), known=True))
    assert unit.code(command) == ACCEPTED
    # the bit is clear by the time the command is answered: hosts poll at once
    assert not unit.status("completed")
    assert unit.status("homing")
    unit.wait()
    for axis, (name, moved) in enumerate(zip(("datum_alpha", "datum_beta"), moves, strict=True)):
        assert unit.status(name)
        if moved:
            assert unit.position_deg[axis] == pytest.approx(0, abs=1e-3)
            # the stop is at the calibrated reference: zero is where it was declared
            assert unit.true_deg()[axis] == pytest.approx(0, abs=1e-3)
    assert not unit.unsolicited
    assert not unit.status("homing")


def test_the_datum_is_the_same_turn_however_hard_the_stop_was_pressed():
    zeros = []
    for torque in (3e-5, 5.5e-5, 1.5e-4):
        unit = with_stops(Rig(position_deg=(3.0, 2.0), collision_torque=torque))
        unit.code(20)
        unit.wait()
        zeros.append(unit.true_deg()[0] * 1024)
    assert np.ptp(zeros) < 1.0  # motor degrees


def test_without_a_stop_the_search_gives_up():
    unit = Rig(datum_speed=3000, position_min=-4, position_max=30)
    assert unit.code(20) == ACCEPTED
    unit.wait()
    assert unit.status("datum_alpha", "datum_beta") == (False, False)
    assert unit.goto(10, 10) == rig.NOT_INITIALIZED


def test_a_stopped_search_leaves_the_datum_unknown():
    unit = with_stops(Rig())
    unit.code(20)
    unit.unit.tick(200)
    assert unit.code(15) == ACCEPTED
    unit.wait()
    assert unit.status("datum_alpha", "datum_beta") == (False, False)
    assert unit.code(14) == ACCEPTED


def test_datum_calibration_makes_the_search_possible_on_a_new_unit():
    unit = with_stops(Rig(position_deg=(3.0, 2.0), known=False))
    assert unit.code(20) == rig.DATUM_NOT_CALIBRATED
    assert unit.code(23) == ACCEPTED
    assert unit.status("datum_calibration")
    unit.wait()
    assert unit.status("datum_calibrated_alpha", "datum_alpha", "datum_beta") == (True, True, True)
    # rigid stop of the bench: the reference is where it stood
    first = unit.true_deg()
    assert first == pytest.approx((0, 0), abs=0.02)
    assert unit.goto(5, 5) == ACCEPTED
    unit.wait()
    assert unit.code(20) == ACCEPTED
    unit.wait()
    assert unit.true_deg() == pytest.approx(first, abs=1e-3)


def test_offsets_move_the_zero_of_the_next_search():
    unit = with_stops(Rig(position_deg=(3.0, 2.0)))
    assert unit.code(35, pair(1.0, -0.5)) == ACCEPTED
    # whole turns of the motor (0.35 deg) keep the reference, the rest is the new one
    assert unit.code(23) == ACCEPTED
    unit.wait()
    assert unit.true_deg() == pytest.approx((-1.0, 0.5), abs=0.02)


TRUE_HALL = {
    "hall_offset_a": 2010.0,
    "hall_offset_b": 2100.0,
    "hall_amplitude_a": 1450.0,
    "hall_amplitude_b": 1580.0,
    "hall_phase": 0.06,
}


@pytest.mark.parametrize(("command", "axes"), [(26, (0, 1)), (27, (0,)), (28, (1,))])
def test_hall_calibration_finds_the_channels(command, axes):
    """The bench's sensors keep the factory values; the firmware starts with wrong ones."""
    unit = Rig(position_deg=(100.0, 200.0), **TRUE_HALL)
    wrong = {"hall_offset_a": 40, "hall_offset_b": -50, "hall_amplitude_a": -80, "hall_phase": -0.06}
    for axis in (0, 1):
        row = unit.unit.params(axis).copy()
        for name, change in wrong.items():
            row[NAMES.index(name)] += change
        assert unit.unit.set_params(axis, row)
    unit.unit.declare_position()
    assert unit.code(command) == ACCEPTED
    assert unit.status("motor_calibration")
    took = unit.wait()
    assert 1 < took < 5
    for axis in axes:
        for name, true in TRUE_HALL.items():
            tolerance = 2e-3 if name == "hall_phase" else 1.0  # counts
            assert value(unit, axis, name) == pytest.approx(true, abs=tolerance), name
        high = struct.unpack("<4H", unit.ask(104 + axis)[1])
        assert high == pytest.approx((3460, 3680, 560, 520), abs=2)
        # residual: 2 counts of noise on 1500 are 0.08 degrees
        assert 20 < struct.unpack("<ii", unit.ask(45)[1])[axis] < 200
    assert unit.status("motor_alpha", "config_changed") == (True, True)
    # the place is kept but for what the wrong sensors had made of it (2.5 motor degrees)
    assert unit.position_deg == pytest.approx(unit.true_deg(), abs=8 / 1024)


def test_cogging_calibration_is_section_2_4():
    """Coulomb, spring and cogging of Eq. 9 to 11, found by moving; then used."""
    true = {"coulomb": 2.3e-5, "cogging_torque": 1.3e-5, "cogging_phase": 0.7, "spring_torque": 5e-6}
    unit = Rig(position_deg=(100.0, 200.0))
    for axis, scale in ((0, 1.0), (1, 0.1)):
        for name, v in true.items():
            unit.unit.set_plant(axis, name, v if name.endswith("phase") else v * scale)
    assert unit.code(47) == ACCEPTED
    assert unit.status("cogging_calibration")
    before = unit.position_deg
    unit.wait()
    assert unit.status("cogging_alpha", "cogging_beta") == (True, True)
    for axis, scale in ((0, 1.0), (1, 0.1)):
        assert value(unit, axis, "coulomb") == pytest.approx(2.3e-5 * scale, rel=0.02)
        assert value(unit, axis, "cogging_torque") == pytest.approx(1.3e-5 * scale, rel=0.03)
        assert value(unit, axis, "cogging_phase") == pytest.approx(0.7, abs=0.04)
        # the spring at output zero: the measured one here and the known rate
        assert value(unit, axis, "spring_torque") == pytest.approx(5e-6 * scale, abs=3e-7 * scale)
    assert unit.position_deg == pytest.approx(before, abs=3e-3)


def test_a_blocked_cogging_calibration_ends_as_a_collision_and_changes_nothing():
    unit = Rig()
    before = unit.unit.params(0)
    unit.code(48)
    unit.unit.tick(1000)
    unit.unit.set_plant(0, "blocked", 1)
    unit.wait()
    assert unit.status("collision_alpha", "cogging_alpha") == (True, False)
    assert (unit.unit.params(0) == before).all()


def calibrated():
    unit = with_stops(Rig(position_deg=(3.0, 2.0)))
    unit.code(35, pair(1.0, 2.0))
    unit.code(140, struct.pack("<I", 7))
    unit.code(49)
    unit.wait()
    return unit


def test_calibrations_survive_a_power_cycle_once_saved():
    unit = calibrated()
    found = unit.unit.params(1)
    assert unit.status("config_changed", "saved") == (True, False)
    assert unit.code(53) == ACCEPTED
    assert unit.status("config_changed", "saved") == (False, True)
    unit.unit.power_up()
    assert (unit.unit.params(1) == found).all()
    assert unit.status("saved", "cogging_beta", "cogging_alpha") == (True, True, False)
    assert unit.ask(34)[1] == pair(1.0, 2.0)
    assert unit.ask(139)[1] == struct.pack("<I", 7)


def test_what_was_not_saved_is_forgotten():
    unit = calibrated()
    unit.unit.power_up()
    assert unit.status("saved", "cogging_beta") == (False, False)
    assert unit.ask(139)[1] == bytes(4)


def test_a_power_cut_at_any_byte_of_a_save_loses_nothing():
    unit = calibrated()
    assert unit.code(53) == ACCEPTED
    old = unit.unit.storage
    size = 600  # a record is shorter
    for cut in range(0, size, 7):
        unit.unit.storage = old
        unit.unit.power_up()
        unit.code(140, struct.pack("<I", 1000))
        unit.unit.write_budget = cut
        saved = unit.code(53)
        unit.unit.write_budget = -1
        unit.unit.power_up()
        trajectories = struct.unpack("<I", unit.ask(139)[1])[0]
        assert unit.status("saved")
        assert trajectories == (1000 if saved == ACCEPTED else 7)
    assert saved == ACCEPTED  # the last one was not cut


def test_a_flipped_bit_in_one_copy_is_noticed():
    unit = calibrated()
    for count in (1, 2):
        unit.code(140, struct.pack("<I", count))
        assert unit.code(53) == ACCEPTED
    rng = np.random.default_rng(2)
    good = unit.unit.storage
    for bit in rng.integers(0, 300 * 8, 40):
        broken = bytearray(good)
        broken[bit // 8] ^= 1 << bit % 8
        unit.unit.storage = bytes(broken)
        unit.unit.power_up()
        assert struct.unpack("<I", unit.ask(139)[1])[0] in (1, 2)


def test_storage_that_takes_nothing_is_reported():
    unit = Rig()
    unit.unit.write_budget = 0
    assert unit.code(53) == rig.INVALID
    assert not unit.status("saved")


def test_the_position_at_rest_survives_a_power_cut():
    unit = Rig()
    unit.goto(13, 17)
    unit.wait()
    # inside the backlash the rotor may fall back to a cogging rest without current
    unit.unit.set_plant(0, "theta_rad", unit.unit.plant(0, "theta_rad") + 1.2)
    unit.unit.power_up()
    assert unit.status("restored", "estimated", "datum_alpha", "datum_beta") == (True, False, True, True)
    assert unit.position_deg == pytest.approx((13, 17), abs=1e-3)
    assert unit.goto(12, 18) == ACCEPTED
    unit.wait()
    assert unit.true_deg() == pytest.approx((12, 18), abs=1e-3)


def test_a_power_cut_in_motion_leaves_a_guess_and_asks_for_the_datum():
    unit = with_stops(Rig())
    unit.goto(60, 70)
    unit.unit.tick(1000)
    unit.unit.power_up()
    assert unit.status("restored", "estimated", "datum_alpha", "datum_beta") == (False, True, False, False)
    assert unit.position_deg == pytest.approx((10, 20), abs=1e-3)
    assert unit.goto(12, 18) == rig.NOT_INITIALIZED
    # found at the stop, it is a guess no longer
    assert unit.code(23) == ACCEPTED
    unit.wait(60)
    assert unit.status("restored", "estimated", "datum_alpha", "datum_beta") == (False, False, True, True)
    assert unit.goto(12, 18) == ACCEPTED


@pytest.mark.parametrize("budget", range(0, 70, 3))
def test_nothing_moves_that_a_power_cut_would_place_wrongly(budget):
    """The storage takes only some bytes: whatever is known after a power cut is so."""
    unit = with_stops(Rig())
    unit.unit.write_budget = budget
    code = unit.goto(60, 70)
    unit.unit.tick(1000)
    moved = abs(unit.true_deg()[0] - 10) > 0.1
    assert moved == (code == ACCEPTED)
    assert unit.status("storage_failed") == (code == rig.INVALID)
    unit.unit.write_budget = -1
    unit.unit.power_up()
    known, estimated = unit.status("datum_alpha", "estimated")
    assert known != estimated
    assert not known or unit.position_deg == pytest.approx(unit.true_deg(), abs=0.01)


def test_a_start_that_cannot_be_noted_is_refused_and_what_is_loaded_is_dropped():
    unit = Rig()
    unit.load([(0.0, 10.0), (2.0, 12.0)], [(0.0, 20.0), (2.0, 21.0)])
    unit.unit.write_budget = 0
    assert unit.code(14) == rig.INVALID
    unit.unit.write_budget = -1
    assert unit.code(14) == ACCEPTED  # nothing is loaded: nothing moves
    unit.unit.tick(1000)
    assert unit.true_deg() == pytest.approx((10, 20), abs=0.01)
    assert unit.goto(12, 21) == ACCEPTED
    assert not unit.status("storage_failed")


def test_without_a_record_that_could_mislead_storage_that_fails_stops_nobody():
    unit = Rig(known=False)
    unit.unit.write_budget = 0
    assert unit.code(23) == ACCEPTED
    assert unit.status("storage_failed")


def test_a_position_that_cannot_be_noted_is_not_declared():
    unit = Rig()
    unit.unit.write_budget = 0
    counts = struct.pack("<ii", *(round(a * rig.COUNTS_PER_DEG) for a in (40, 50)))
    assert unit.code(33, counts) == rig.INVALID
    assert unit.position_deg == pytest.approx((10, 20), abs=0.01)
    unit.unit.power_up()
    assert unit.position_deg == pytest.approx((10, 20), abs=0.01)


def test_no_storage_at_all_starts_as_new():
    unit = Rig(known=False)
    assert unit.status("restored", "estimated", "saved", "datum_alpha") == (False,) * 4


def upgrade(unit, image, crc=None, size=None):
    header = struct.pack("<II", size or len(image), zlib.crc32(image) if crc is None else crc)
    assert unit.code(200, header) == ACCEPTED
    return [unit.code(201, image[k : k + 8]) for k in range(0, len(image), 8)]


def boot_status(unit):
    code, data = unit.ask(3)
    assert code == ACCEPTED
    assert len(data) == 4
    return struct.unpack("<I", data)[0]


def in_bootloader():
    unit = Rig()
    unit.unit.enter_bootloader()
    return unit


def test_the_bootloader_takes_an_image_with_its_crc():
    unit = in_bootloader()
    assert unit.ask(2)[1] == bytes([21, 80, 4, 0])
    assert boot_status(unit) == 0x1
    image = bytes(np.random.default_rng(4).integers(0, 256, 2003, dtype=np.uint8))
    assert set(upgrade(unit, image)) == {ACCEPTED}
    assert boot_status(unit) == 0x1 | 0x1000000 | 0x2000000


def test_a_bad_image_is_refused_at_its_last_frame():
    unit = in_bootloader()
    codes = upgrade(unit, b"firmware" * 10, crc=1)
    assert codes == [ACCEPTED] * 9 + [rig.OUT_OF_RANGE]
    assert boot_status(unit) & 0x4000000
    # too many bytes likewise
    codes = upgrade(unit, b"firmware" * 2, size=12)
    assert codes == [ACCEPTED, rig.OUT_OF_RANGE]


def test_the_bootloader_refuses_everything_else():
    unit = in_bootloader()
    for number in (10, 13, 15, 20, 30, 32, 53, 118):
        assert unit.code(number) == rig.INVALID_BOOTLOADER
    assert unit.code(99) == rig.UNKNOWN
    assert unit.code(201, b"x") == rig.INVALID  # out of sequence
    assert unit.code(200, struct.pack("<II", 0, 0)) == rig.OUT_OF_RANGE
    assert unit.code(201, b"") == rig.WRONG_LENGTH


def test_outside_the_bootloader_its_commands_are_invalid():
    unit = Rig()
    assert unit.code(200, bytes(8)) == rig.INVALID
    assert unit.code(201, b"x") == rig.INVALID


def test_after_ten_seconds_the_main_firmware_starts():
    unit = in_bootloader()
    assert not unit.unit.at_rest()
    unit.unit.tick(19_990)
    assert unit.ask(2)[1][1] == 80
    unit.unit.tick(20)
    assert unit.ask(2)[1] == bytes([21, 1, 4, 0])
    assert unit.goto(11, 21) == ACCEPTED
    # an image under way keeps it waiting
    unit = in_bootloader()
    unit.code(200, struct.pack("<II", 100, 0))
    unit.unit.tick(30_000)
    assert unit.unit.state == fw.STATES["BOOTLOADER"]
