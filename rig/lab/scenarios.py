"""What is run on every target: each scenario checks what it sees, and two targets must see the same.

A scenario is a function of a unit that has just been made; all of them speak CAN frames only. Limits
are those of the firmware's own tests (tests/firmware), with the twin's plant instead of a rigid rotor.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable

import numpy as np

from fiberloom.twin import Units
from lab.unit import COUNTS_PER_DEG, NUMBER, PARAMETERS, Truth, Unit, drawn

ACCEPTED, OUT_OF_RANGE, INVALID_TRAJECTORY, IN_MOTION, NOT_INITIALIZED = range(5)
WRONG_LENGTH, COLLISION, INVALID_BROADCAST, INVALID_BOOTLOADER, INVALID, UNKNOWN = 5, 8, 10, 11, 12, 13
COMPLETED, COLLISION_ALPHA, COLLISION_BETA = 1 << 8, 1 << 11, 1 << 12
MOTORS = 3 << 20
DATUMS_CALIBRATED, DATUMS = 3 << 23, 3 << 26
COGGING = 3 << 31
ESTIMATED, RESTORED, SAVED = 1 << 33, 1 << 34, 1 << 36
HOST_TIMEOUT = 1 << 41
STORAGE_FAILED = 1 << 42
BOOT_OK, BOOT_BAD = 1 << 25, 1 << 26
MOTOR_DEG = 1.0 / 1024.0
"""A degree of the motor as an angle of the output."""

SCENARIOS: dict[str, Callable[[Unit], None]] = {}


def scenario(function: Callable[[Unit], None]) -> Callable[[Unit], None]:
    """Registers a scenario by its name."""
    SCENARIOS[function.__name__] = function
    return function


def pair(alpha_deg: float, beta_deg: float) -> bytes:
    """Wire positions of both axes, as the eight bytes of a frame."""
    return struct.pack("<ii", round(alpha_deg * COUNTS_PER_DEG), round(beta_deg * COUNTS_PER_DEG))


def u32(*values: int) -> bytes:
    """Unsigned 32-bit numbers as the bytes of a frame; each in 0 to 2^32 - 1, else struct.error."""
    return struct.pack("<" + "I" * len(values), *values)


def has(unit: Unit, bits: int) -> bool:
    """Whether all of these `bits` of the status are set."""
    return unit.status() & bits == bits


def accepted(unit: Unit, command: int, data: bytes = b"") -> None:
    """Sends a command with its `data`, which the unit must accept."""
    code = unit.code(command, data)
    assert code == ACCEPTED, f"command {command}: code {code}"


def known_unit(unit: Unit, start_deg: tuple[float, float] = (40.0, 90.0)) -> None:
    """Starts a unit at `start_deg` of its arms with its position known to the firmware."""
    unit.begin(drawn(), start_deg)


def arrived(unit: Unit, target_deg: tuple[float, float], within_deg: float) -> Truth:
    """Checks that the unit is at rest at wire positions `target_deg`, to `within_deg`, without collision."""
    truth = unit.look()
    assert has(unit, COMPLETED)
    assert not unit.unsolicited
    for axis in (0, 1):
        # beyond the target counts as arrived: the backlash lies between it and any way back
        off = truth.position_deg(axis) - target_deg[axis]
        assert abs(off) < within_deg, f"axis {axis}: {off:.4f} deg off"
    return truth


# -- calibrations ------------------------------------------------------------------------------------

HALL = ("hall_offset_a", "hall_offset_b", "hall_amplitude_a", "hall_amplitude_b")


@scenario
def hall_calibration(unit: Unit) -> None:
    """26 with wrong sensors in the firmware: finds those of the plant."""
    units = drawn()
    units.firmware["hall_offset_a"] += 40.0
    units.firmware["hall_amplitude_a"] -= 80.0
    units.firmware["hall_phase"] -= 0.06
    unit.begin(units, (40.0, 90.0))
    accepted(unit, 26)
    unit.rest()
    truth = unit.look()
    for axis in (0, 1):
        for name in HALL:
            # 3 counts of noise in some thousands of samples
            assert abs(truth.params[axis][name] - units.plant[0, axis][name]) < 1.5, name
        assert abs(truth.params[axis]["hall_phase"] - units.plant[0, axis]["hall_phase"]) < 2e-3
    assert has(unit, MOTORS | COMPLETED)


@scenario
def datum_search(unit: Unit) -> None:
    """23 and 20 on a unit that does not know where it is: the stop is the datum, both times the same."""
    search_datum(unit, drawn())


def search_datum(unit: Unit, units: Units) -> None:
    """The search, by what these units' firmware is told."""
    units.firmware["datum_speed"] = 1200.0
    stops = tuple(float(np.rad2deg(units.plant[0, axis]["stop_min"])) for axis in (0, 1))
    unit.begin(units, (stops[0] + 1.2, stops[1] + 0.9), known=False)
    assert unit.code(20) == 14  # the datum is not calibrated
    accepted(unit, 23)
    unit.rest()
    assert has(unit, DATUMS_CALIBRATED | DATUMS)
    first = arrived(unit, (0.0, 0.0), 2 * MOTOR_DEG)
    accepted(unit, 30, pair(0.5, 0.5))
    unit.rest()
    accepted(unit, 20)
    unit.rest()
    second = arrived(unit, (0.0, 0.0), 2 * MOTOR_DEG)
    for axis in (0, 1):
        # the gear, for without current the rotor falls back inside the backlash
        assert abs(first.gear_rad[axis] - second.gear_rad[axis]) < np.deg2rad(3.0)


@scenario
def cogging_calibration(unit: Unit) -> None:
    """47: the break-away torque of Section 2.4 of the paper, found by moving."""
    calibrate_cogging(unit, drawn())


def calibrate_cogging(unit: Unit, units: Units) -> None:
    """The calibration, with friction and cogging told wrong."""
    units.firmware["coulomb"] *= 0.8
    units.firmware["cogging_torque"] *= 1.3
    units.firmware["landing_speed"] = 100.0  # twice as fast as usual: it is eleven turns of the motor
    unit.begin(units, (40.0, 90.0))
    accepted(unit, 47)
    unit.rest()
    truth = unit.look()
    assert has(unit, COGGING | COMPLETED)
    for axis in (0, 1):
        plant = units.plant[0, axis]
        coulomb = plant["coulomb_motor"] + plant["coulomb_gear"]
        assert abs(truth.params[axis]["coulomb"] / coulomb - 1.0) < 0.1
        assert abs(truth.params[axis]["cogging_torque"] / plant["cogging_2"] - 1.0) < 0.2


# -- storage -----------------------------------------------------------------------------------------


@scenario
def save_and_restore(unit: Unit) -> None:
    """53 over a power cycle; what was not saved is forgotten; the position at rest is restored."""
    known_unit(unit)
    accepted(unit, 35, pair(1.0, -2.0))
    accepted(unit, 140, u32(7))
    accepted(unit, 53)
    accepted(unit, 140, u32(8))
    accepted(unit, 30, pair(40.4, 89.7))
    unit.rest()
    before = unit.look()
    unit.tell("power")
    assert has(unit, SAVED | RESTORED | DATUMS)
    assert unit.ask(34)[1] == pair(1.0, -2.0)
    assert unit.ask(139)[1] == u32(7)
    assert unit.look().position_cnt == before.position_cnt
    accepted(unit, 30, pair(40.0, 90.0))
    unit.rest()
    arrived(unit, (40.0, 90.0), 2 * MOTOR_DEG)


RECORD_BYTES = 520
"""A little more than the calibration record."""


@scenario
def power_loss_in_a_save(unit: Unit) -> None:
    """The power fails after every single byte of a save: the old or the new settings, nothing else."""
    known_unit(unit)
    accepted(unit, 140, u32(7))
    accepted(unit, 53)
    last = 7
    for cut in range(RECORD_BYTES):
        accepted(unit, 140, u32(1000 + cut))
        unit.tell(f"cut {cut}")
        saved = unit.code(53) == ACCEPTED
        unit.tell("cut -1", "power")
        last = 1000 + cut if saved else last
        assert has(unit, SAVED | RESTORED)
        assert unit.ask(139)[1] == u32(last)
    assert last > 7  # the last ones were not cut


POSITION_BYTES = 36


@scenario
def power_loss_while_a_position_is_noted(unit: Unit) -> None:
    """The storage takes some bytes of the note at the start of a motion, every number of them, then the power
    fails: what is not noted does not begin."""
    known_unit(unit)
    before = unit.look().position_deg(0)
    for cut in range(POSITION_BYTES + 1):
        unit.tell(f"cut {cut}")
        whole = unit.code(30, pair(60.0, 80.0)) == ACCEPTED
        assert has(unit, STORAGE_FAILED) != whole
        unit.tell("cut -1", "power")
        assert has(unit, ESTIMATED) == whole != has(unit, RESTORED)
        assert whole or abs(unit.look().position_deg(0) - before) < MOTOR_DEG
        if whole:
            break
    assert cut > 30  # only a whole record counts
    assert unit.code(30, pair(41.0, 90.0)) == NOT_INITIALIZED


# -- moves -------------------------------------------------------------------------------------------


@scenario
def go_to(unit: Unit) -> None:
    """30 both ways and 31; the arms are where the gear puts them."""
    known_unit(unit)
    for target in ((42.0, 88.5), (41.0, 89.5)):
        accepted(unit, 30, pair(*target))
        assert not has(unit, COMPLETED)
        assert unit.code(30, pair(*target)) == IN_MOTION
        unit.rest()
        arrived(unit, target, 2 * MOTOR_DEG)
    accepted(unit, 31, pair(-0.25, 0.5))
    unit.rest()
    truth = arrived(unit, (40.75, 90.0), 4 * MOTOR_DEG)
    # non-linearity of the gear 0.6 deg, backlash 0.25 deg: the wire angle is not the arm's
    assert abs(np.rad2deg(truth.output_rad[0]) - 40.75) < 1.0


def load(unit: Unit, points: list[list[tuple[int, int]]]) -> int:
    """Sends a trajectory by 10, 11 and 12; the response code of 12.

    `points`: of alpha and of beta, each a wire position in counts and a time in ticks of 0.5 ms.
    """
    accepted(unit, 10, u32(len(points[0]), len(points[1])))
    frames = [struct.pack("<ii", *point) for axis in points for point in axis]
    assert all(unit.code(11, frame) == ACCEPTED for frame in frames)
    return unit.code(12)


def wave(here_cnt: int, swing_deg: float, step_ticks: int, count: int) -> list[tuple[int, int]]:
    """A trajectory of one axis: one and a half swings about a position, slow at both ends.

    `here_cnt`: the position, counts on the wire; `swing_deg`: largest deviation from it, deg on the wire,
    of either sign; `step_ticks`: time between points, ticks of 0.5 ms, 1 or more; `count`: points, 2 or
    more. Returns positions in counts and times in ticks, the first at tick 200.
    """
    share = np.arange(count) / (count - 1)
    ease = share * share * (3.0 - 2.0 * share)
    way_deg = swing_deg * np.sin(3.0 * np.pi * ease)
    ticks = 200 + step_ticks * np.arange(count)
    positions = here_cnt + np.rint(way_deg * COUNTS_PER_DEG).astype(int)
    return [(int(position), int(tick)) for position, tick in zip(positions, ticks, strict=True)]


@scenario
def trajectory_of_a_thousand_points(unit: Unit) -> None:
    """10, 11 two thousand times, 12, 14: both axes follow to the end."""
    known_unit(unit)
    here = unit.look().position_cnt
    points = [wave(here[0], 3.0, 10, 1000), wave(here[1], -2.5, 10, 1000)]
    assert load(unit, points) == ACCEPTED
    unit.cost()
    accepted(unit, 14)
    unit.run(2500)
    unit.look()
    unit.rest()
    arrived(unit, (points[0][-1][0] / COUNTS_PER_DEG, points[1][-1][0] / COUNTS_PER_DEG), 2 * MOTOR_DEG)


@scenario
def precise_trajectory(unit: Unit) -> None:
    """The approach of Section 3.3 at the end: always in the negative direction, against the spring."""
    known_unit(unit)
    accepted(unit, 128)
    accepted(unit, 130)
    here = unit.look().position_cnt
    assert load(unit, [wave(here[0], 1.0, 40, 40), wave(here[1], -1.0, 40, 40)]) == ACCEPTED
    accepted(unit, 14)
    unit.rest()
    truth = arrived(unit, (here[0] / COUNTS_PER_DEG, here[1] / COUNTS_PER_DEG), 2 * MOTOR_DEG)
    for axis in (0, 1):  # negative contact: the gear is where the rotor is, but for its fall-back
        assert abs(truth.theta_rad[axis] - truth.gear_rad[axis]) < 0.6


@scenario
def host_watch(unit: Unit) -> None:
    """A trajectory whose host falls silent slows down on its way; under polls the next runs to its end."""
    units = drawn()
    units.firmware["host_timeout_ms"] = 400.0
    unit.begin(units, (40.0, 90.0))
    here = unit.look().position_cnt
    points = [wave(here[0], 3.0, 40, 100), wave(here[1], -2.5, 40, 100)]
    assert load(unit, points) == ACCEPTED
    accepted(unit, 14)
    unit.rest()
    assert has(unit, HOST_TIMEOUT | COMPLETED | DATUMS)
    assert not unit.unsolicited
    assert unit.look().position_cnt != [points[0][-1][0], points[1][-1][0]]
    here = unit.look().position_cnt
    assert load(unit, [wave(here[0], 1.0, 40, 40), wave(here[1], -1.0, 40, 40)]) == ACCEPTED
    accepted(unit, 14)
    for _ in range(6):
        unit.run(600)
        unit.status()
    assert not has(unit, HOST_TIMEOUT)
    arrived(unit, (here[0] / COUNTS_PER_DEG, here[1] / COUNTS_PER_DEG), 2 * MOTOR_DEG)


@scenario
def collision(unit: Unit) -> None:
    """A rotor is held in mid-move: both axes stop, frame 18, nothing moves until STOP_TRAJECTORY."""
    known_unit(unit)
    accepted(unit, 30, pair(60.0, 70.0))
    unit.run(700)
    unit.tell("block 1 1")
    unit.run(40)  # 20 ms; the paper allows 16
    assert len(unit.unsolicited) == 1
    unit.rest()
    assert has(unit, COLLISION_BETA | COMPLETED)
    assert not has(unit, COLLISION_ALPHA)
    assert unit.code(30, pair(50.0, 80.0)) == COLLISION
    unit.tell("block 1 0")
    accepted(unit, 15)
    assert not has(unit, COLLISION_BETA)
    accepted(unit, 31, pair(0.5, 0.5))
    unit.rest()
    assert has(unit, COMPLETED)


@scenario
def arm_against_a_stop(unit: Unit) -> None:
    """The arm runs into its hard stop at 2000 rpm: the gear winds up, the load is seen, both axes stop."""
    units = drawn()
    stop_rad = np.deg2rad(48.0)
    units.plant[0, 0]["stop_max"] = stop_rad
    unit.begin(units, (40.0, 90.0))
    accepted(unit, 30, pair(60.0, 70.0))
    unit.rest()
    assert len(unit.unsolicited) == 1
    assert has(unit, COLLISION_ALPHA | COMPLETED)
    truth = unit.look()
    # the arm is at the stop, wound up by less than a motor turn (0.35 deg)
    assert abs(np.rad2deg(truth.output_rad[0]) - 48.0) < 0.1
    assert abs(truth.position_deg(0) - 48.0) < 1.0  # the gear is not linear
    assert truth.position_deg(1) > 71.0


@scenario
def bench_trace(unit: Unit) -> None:
    """240 to 246: what a bench records of a move and of a torque step."""
    known_unit(unit)
    accepted(unit, 240, struct.pack("<H", 8))
    accepted(unit, 31, pair(1.0, -1.0))
    unit.rest()
    accepted(unit, 245, struct.pack("<hhHH", 20000, -20000, 60, 60))
    unit.rest()
    for command in (241, 242):
        count = struct.unpack("<H", unit.ask(command)[1][:2])[0]
        assert count > 50
        for index in range(0, count, 10):
            accepted(unit, command + 2, struct.pack("<H", index))
    assert has(unit, COMPLETED)


@scenario
def parameters(unit: Unit) -> None:
    """230 to 236: read, set in a copy, taken as a whole or not at all, saved, and there after a power cut."""
    known_unit(unit)
    table, before = checksums(unit)
    values = bytearray(read_parameters(unit))
    assert zlib.crc32(values) == before
    accepted(unit, 231, u32(table))
    for axis in (0, 1):
        at = len(values) // 2 * axis + 4 * 9  # the tenth: Coulomb friction
        new = struct.pack("<f", 1.1 * struct.unpack_from("<f", values, at)[0])
        values[at : at + 4] = new
        accepted(unit, 232 + axis, bytes([9]) + new)
    assert unit.code(234, u32(zlib.crc32(values) ^ 1)) == INVALID
    assert checksums(unit) == (table, before)
    accepted(unit, 234, u32(zlib.crc32(values)))
    assert checksums(unit) == (table, zlib.crc32(values))
    accepted(unit, 53)
    unit.tell("power")
    assert read_parameters(unit) == bytes(values)
    accepted(unit, 31, pair(1.0, -1.0))
    unit.rest()
    assert has(unit, COMPLETED)


def checksums(unit: Unit) -> tuple[int, int]:
    """CRC-32 of the parameter table, and of the values in force."""
    code, data = unit.ask(230)
    assert code == ACCEPTED
    first, second = struct.unpack("<II", data)
    return first, second


def read_parameters(unit: Unit) -> bytes:
    """The bytes of all values in force: those of alpha, then those of beta."""
    out = b""
    for command in (235, 236):
        for index in range(len(PARAMETERS)):
            code, data = unit.ask(command, bytes([index]))
            assert code == ACCEPTED
            assert data[0] == index
            out += data[1:]
    return out


# -- frames ------------------------------------------------------------------------------------------


def identifier(command: int, to: int = NUMBER, uid: int = 1, code: int = 0) -> int:
    """The 29-bit identifier of a frame; nothing is checked, so that wrong ones can be made too.

    `command`: its number, 0 to 255; `to`: number of the positioner, 0 to 2047, 0 for all; `uid`: number
    of the request, 0 to 63; `code`: response code, 0 to 15, 0 in a request.
    """
    return to << 18 | command << 10 | uid << 4 | code


@scenario
def bad_frames(unit: Unit) -> None:
    """Frames with each kind of error: the right code, and nothing moves."""
    known_unit(unit)
    assert unit.code(99) == UNKNOWN
    assert unit.code(30, b"1234567") == WRONG_LENGTH
    assert unit.code(30, pair(10.0, 10.0), to=0) == INVALID_BROADCAST
    assert unit.code(30, pair(400.0, 10.0)) == OUT_OF_RANGE
    assert unit.code(10, u32(1001, 1)) == OUT_OF_RANGE
    assert unit.code(11, bytes(8)) == INVALID_TRAJECTORY
    assert unit.code(12) == INVALID_TRAJECTORY
    assert unit.code(18) == INVALID
    assert unit.code(200, u32(8, 0)) == INVALID
    assert unit.code(14) == ACCEPTED  # a START for the others
    # to another positioner, replies, and more than 29 bits: no answer
    assert unit.send(identifier(3, to=NUMBER + 1)) == []
    assert unit.send(identifier(3, code=3)) == []
    assert unit.send(1 << 29 | identifier(3)) == []
    here = unit.look()
    rng = np.random.default_rng(1)
    for _ in range(400):
        queries = rng.choice([0, 1, 2, 3, 11, 12, 13, 14, 15, 18, 32, 34, 45, 56, 104, 113, 132, 139, 201])
        data = bytes(rng.integers(0, 256, rng.integers(0, 9), dtype=np.uint8))
        unit.ask(int(queries), data)
    unit.run(20)
    assert unit.look().position_cnt == here.position_cnt
    assert has(unit, COMPLETED)


@scenario
def firmware_upgrade(unit: Unit) -> None:
    """200, 201 with the CRC of zlib; a bad image is refused; ten seconds later the firmware starts."""
    known_unit(unit)
    unit.tell("boot")
    assert unit.ask(2)[1] == bytes([21, 80, 4, 0])
    assert unit.code(30, pair(10.0, 10.0)) == INVALID_BOOTLOADER
    image = bytes(np.random.default_rng(4).integers(0, 256, 2003, dtype=np.uint8))
    bites = [image[k : k + 8] for k in range(0, len(image), 8)]
    accepted(unit, 200, u32(len(image), zlib.crc32(image)))
    assert {unit.code(201, bite) for bite in bites} == {ACCEPTED}
    assert has(unit, BOOT_OK)
    accepted(unit, 200, u32(len(image), zlib.crc32(image) ^ 1))
    assert [unit.code(201, bite) for bite in bites] == [ACCEPTED] * (len(bites) - 1) + [OUT_OF_RANGE]
    assert has(unit, BOOT_BAD)
    unit.run(20_001)
    assert unit.ask(2)[1] == bytes([21, 1, 4, 0])
    accepted(unit, 31, pair(0.1, 0.1))
    unit.rest()
    assert has(unit, COMPLETED)


# -- more for the report: what may take long in a tick ------------------------------------------------


def short_moves(unit: Unit) -> None:
    """Go-to and precise moves of a hundredth to a few degrees, both axes at once."""
    known_unit(unit)
    rng = np.random.default_rng(8)
    unit.cost()
    for k in range(24):
        for command in (128, 130) if k % 3 == 0 else (129, 131):
            accepted(unit, command)
        size = 10.0 ** rng.uniform(-2.0, 0.3)
        accepted(unit, 30, pair(*(np.array([40.0, 90.0]) + size * rng.uniform(-1.0, 1.0, 2))))
        unit.rest()
    assert not unit.unsolicited


def open_loop(unit: Unit) -> None:
    """The same with a rotating field."""
    known_unit(unit)
    accepted(unit, 120)
    accepted(unit, 124)
    accepted(unit, 40, u32(400, 400))
    accepted(unit, 30, pair(41.0, 89.0))
    unit.rest()
    arrived(unit, (41.0, 89.0), 30 * MOTOR_DEG)


def by_law_1() -> Units:
    """The same units, told to drive by law 1 (fl_regulator.h)."""
    units = drawn()
    units.firmware["law"] = 1.0
    return units


@scenario
def law_1(unit: Unit) -> None:
    """Go-to and precise moves, short and long, by law 1."""
    unit.begin(by_law_1(), (40.0, 90.0))
    for k, (alpha, beta) in enumerate(((42.0, 88.5), (41.9, 88.6), (41.99, 88.59), (40.0, 90.0))):
        for command in (128, 130) if k % 2 else (129, 131):
            accepted(unit, command)
        accepted(unit, 30, pair(alpha, beta))
        unit.rest()
        arrived(unit, (alpha, beta), (2 if k % 2 else 90) * MOTOR_DEG)


def law_1_datum(unit: Unit) -> None:
    """The datum search by law 1."""
    search_datum(unit, by_law_1())


def law_1_cogging(unit: Unit) -> None:
    """The cogging calibration by law 1."""
    calibrate_cogging(unit, by_law_1())


MORE: dict[str, Callable[[Unit], None]] = {
    "short_moves": short_moves,
    "open_loop": open_loop,
    "law_1_datum": law_1_datum,
    "law_1_cogging": law_1_cogging,
}


def run(name: str, command: list[str]) -> list[str]:
    """Runs the scenario `name` on the rig that `command` starts; the lines of its log."""
    unit = Unit(command)
    try:
        SCENARIOS[name](unit)
    except BaseException:
        unit.kill()
        raise
    unit.close()
    return unit.said
