"""The commands, response codes and status bits of the SDSS-V positioners, listed once.

Numbers, payloads and timeouts follow firmware 04.01.21 as the SDSS-V client uses it. All integers
are little endian. Angles travel in 2^30 counts per turn of the arm, times in ticks of 0.5 ms.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from fiberloom import units
from fiberloom.errors import InputError


class Response(IntEnum):
    """The response code of a reply."""

    ACCEPTED = 0
    VALUE_OUT_OF_RANGE = 1
    INVALID_TRAJECTORY = 2
    ALREADY_IN_MOTION = 3
    DATUM_NOT_INITIALIZED = 4
    INCORRECT_AMOUNT_OF_DATA = 5
    CALIBRATION_MODE_ACTIVE = 6
    MOTOR_NOT_CALIBRATED = 7
    COLLISION_DETECTED = 8
    HALL_SENSOR_DISABLED = 9
    INVALID_BROADCAST_COMMAND = 10
    INVALID_BOOTLOADER_COMMAND = 11
    INVALID_COMMAND = 12
    UNKNOWN_COMMAND = 13
    DATUM_NOT_CALIBRATED = 14
    HALL_SENSORS_DISABLED = 15


class Status(IntFlag):
    """The 64-bit status word of firmware 4.1 and later."""

    SYSTEM_INITIALIZED = 1 << 0
    CONFIG_CHANGED = 1 << 1
    BSETTINGS_CHANGED = 1 << 2
    DATA_STREAMING = 1 << 3
    RECEIVING_TRAJECTORY = 1 << 4
    TRAJECTORY_ALPHA_RECEIVED = 1 << 5
    TRAJECTORY_BETA_RECEIVED = 1 << 6
    LOW_POWER_AFTER_MOVE = 1 << 7
    DISPLACEMENT_COMPLETED = 1 << 8
    DISPLACEMENT_COMPLETED_ALPHA = 1 << 9
    DISPLACEMENT_COMPLETED_BETA = 1 << 10
    COLLISION_ALPHA = 1 << 11
    COLLISION_BETA = 1 << 12
    CLOSED_LOOP_ALPHA = 1 << 13
    CLOSED_LOOP_BETA = 1 << 14
    PRECISE_POSITIONING_ALPHA = 1 << 15
    PRECISE_POSITIONING_BETA = 1 << 16
    COLLISION_DETECT_ALPHA_DISABLE = 1 << 17
    COLLISION_DETECT_BETA_DISABLE = 1 << 18
    MOTOR_CALIBRATION = 1 << 19
    MOTOR_ALPHA_CALIBRATED = 1 << 20
    MOTOR_BETA_CALIBRATED = 1 << 21
    DATUM_CALIBRATION = 1 << 22
    DATUM_ALPHA_CALIBRATED = 1 << 23
    DATUM_BETA_CALIBRATED = 1 << 24
    DATUM_INITIALIZATION = 1 << 25
    DATUM_ALPHA_INITIALIZED = 1 << 26
    DATUM_BETA_INITIALIZED = 1 << 27
    HALL_ALPHA_DISABLE = 1 << 28
    HALL_BETA_DISABLE = 1 << 29
    COGGING_CALIBRATION = 1 << 30
    COGGING_ALPHA_CALIBRATED = 1 << 31
    COGGING_BETA_CALIBRATED = 1 << 32
    ESTIMATED_POSITION = 1 << 33
    POSITION_RESTORED = 1 << 34
    SWITCH_OFF_AFTER_MOVE = 1 << 35
    CALIBRATION_SAVED = 1 << 36
    PRECISE_MOVE_IN_OPEN_LOOP_ALPHA = 1 << 37
    PRECISE_MOVE_IN_OPEN_LOOP_BETA = 1 << 38
    SWITCH_OFF_HALL_AFTER_MOVE = 1 << 39
    UNKNOWN = 1 << 40
    HOST_TIMEOUT = 1 << 41
    STORAGE_FAILED = 1 << 42

    COLLISION = COLLISION_ALPHA | COLLISION_BETA
    DATUMS_INITIALIZED = DATUM_ALPHA_INITIALIZED | DATUM_BETA_INITIALIZED


class Command(IntEnum):
    """Command numbers."""

    GET_ID = 1
    GET_FIRMWARE_VERSION = 2
    GET_STATUS = 3
    SEND_NEW_TRAJECTORY = 10
    SEND_TRAJECTORY_DATA = 11
    TRAJECTORY_DATA_END = 12
    SEND_TRAJECTORY_ABORT = 13
    START_TRAJECTORY = 14
    STOP_TRAJECTORY = 15
    COLLISION_DETECTED = 18
    GO_TO_DATUMS = 20
    GO_TO_DATUM_ALPHA = 21
    GO_TO_DATUM_BETA = 22
    START_DATUM_CALIBRATION = 23
    START_DATUM_CALIBRATION_ALPHA = 24
    START_DATUM_CALIBRATION_BETA = 25
    START_MOTOR_CALIBRATION = 26
    START_MOTOR_CALIBRATION_ALPHA = 27
    START_MOTOR_CALIBRATION_BETA = 28
    GO_TO_ABSOLUTE_POSITION = 30
    GO_TO_RELATIVE_POSITION = 31
    GET_ACTUAL_POSITION = 32
    SET_ACTUAL_POSITION = 33
    GET_OFFSETS = 34
    SET_OFFSETS = 35
    SET_SPEED = 40
    SET_CURRENT = 41
    GET_HALL_CALIB_ERROR = 45
    START_COGGING_CALIBRATION = 47
    START_COGGING_CALIBRATION_ALPHA = 48
    START_COGGING_CALIBRATION_BETA = 49
    SAVE_INTERNAL_CALIBRATION = 53
    GET_CURRENT = 56
    GET_ALPHA_HALL_CALIB = 104
    GET_BETA_HALL_CALIB = 105
    SET_INCREASE_COLLISION_MARGIN = 111
    SET_HOLDING_CURRENT = 112
    GET_HOLDING_CURRENT = 113
    HALL_ON = 116
    HALL_OFF = 117
    ALPHA_CLOSED_LOOP_COLLISION_DETECTION = 118
    ALPHA_CLOSED_LOOP_WITHOUT_COLLISION_DETECTION = 119
    ALPHA_OPEN_LOOP_COLLISION_DETECTION = 120
    ALPHA_OPEN_LOOP_WITHOUT_COLLISION_DETECTION = 121
    BETA_CLOSED_LOOP_COLLISION_DETECTION = 122
    BETA_CLOSED_LOOP_WITHOUT_COLLISION_DETECTION = 123
    BETA_OPEN_LOOP_COLLISION_DETECTION = 124
    BETA_OPEN_LOOP_WITHOUT_COLLISION_DETECTION = 125
    SWITCH_LED_ON = 126
    SWITCH_LED_OFF = 127
    SWITCH_ON_PRECISE_MOVE_ALPHA = 128
    SWITCH_OFF_PRECISE_MOVE_ALPHA = 129
    SWITCH_ON_PRECISE_MOVE_BETA = 130
    SWITCH_OFF_PRECISE_MOVE_BETA = 131
    GET_RAW_TEMPERATURE = 132
    GET_NUMBER_TRAJECTORIES = 139
    SET_NUMBER_TRAJECTORIES = 140
    START_FIRMWARE_UPGRADE = 200
    SEND_FIRMWARE_DATA = 201
    # this firmware's own (docs/firmware.md): parameters, and for a bench
    GET_PARAMETER_TABLE = 230
    BEGIN_PARAMETERS = 231
    SET_PARAMETER_ALPHA = 232
    SET_PARAMETER_BETA = 233
    COMMIT_PARAMETERS = 234
    GET_PARAMETER_ALPHA = 235
    GET_PARAMETER_BETA = 236
    BENCH_TRACE_START = 240
    BENCH_TRACE_STATE_ALPHA = 241
    BENCH_TRACE_STATE_BETA = 242
    BENCH_TRACE_READ_ALPHA = 243
    BENCH_TRACE_READ_BETA = 244
    BENCH_TORQUE_STEP_ALPHA = 245
    BENCH_TORQUE_STEP_BETA = 246


class CommandFlag(IntFlag):
    """What a command is and may."""

    NONE = 0
    BROADCAST = 1  # may be addressed to all positioners
    SAFE = 2  # may be sent to a collided or locked array
    MOVE = 4  # starts or prepares motion
    REPEATABLE = 8  # sending it twice does what sending it once does: may be retried


@dataclass(frozen=True, slots=True)
class CommandSpec:
    """One row of the command table; `request` and `reply` are struct formats without byte order."""

    command: Command
    flags: CommandFlag
    request: str = ""
    reply: str = ""
    timeout_s: float = 5.0

    def pack(self, *values: int) -> bytes:
        """The request payload; a value that does not fit is an InputError."""
        try:
            return struct.pack("<" + self.request, *values)
        except struct.error as error:
            raise InputError(
                f"{self.command.name}: values {values} do not fit the payload '{self.request}' ({error})"
            ) from None

    @property
    def layout(self) -> struct.Struct:
        """Of a reply's payload."""
        return _LAYOUTS[self.reply]

    def unpack(self, data: bytes) -> tuple[int, ...] | None:
        """The values of a reply, or None when its payload is shorter than the table says."""
        layout = self.layout
        return layout.unpack_from(data) if len(data) >= layout.size else None


B, S, M, R = CommandFlag.BROADCAST, CommandFlag.SAFE, CommandFlag.MOVE, CommandFlag.REPEATABLE
NONE = CommandFlag.NONE
C = Command

# command, flags, request payload, reply payload, reply timeout in s (default 5). A row is
# repeatable when a second copy finds the positioner as the first left it; trajectory data and
# relative moves are not, and a move may answer the copy with ALREADY_IN_MOTION.
_TABLE = [
    CommandSpec(C.GET_ID, B | S | R, "", "I", 1.0),
    CommandSpec(C.GET_FIRMWARE_VERSION, B | S | R, "", "BBB", 2.0),
    CommandSpec(C.GET_STATUS, B | S | R, "", "Q", 1.0),
    CommandSpec(C.SEND_NEW_TRAJECTORY, M, "II"),
    CommandSpec(C.SEND_TRAJECTORY_DATA, M, "ii"),
    CommandSpec(C.TRAJECTORY_DATA_END, M),
    CommandSpec(C.SEND_TRAJECTORY_ABORT, S | R, "", "", 0.5),
    CommandSpec(C.START_TRAJECTORY, B | S | M, "", "", 1.0),
    CommandSpec(C.STOP_TRAJECTORY, B | S | R, "", "", 1.0),
    CommandSpec(C.COLLISION_DETECTED, NONE),
    CommandSpec(C.GO_TO_DATUMS, M),
    CommandSpec(C.GO_TO_DATUM_ALPHA, M),
    CommandSpec(C.GO_TO_DATUM_BETA, M),
    CommandSpec(C.START_DATUM_CALIBRATION, M),
    CommandSpec(C.START_DATUM_CALIBRATION_ALPHA, M),
    CommandSpec(C.START_DATUM_CALIBRATION_BETA, M),
    CommandSpec(C.START_MOTOR_CALIBRATION, M),
    CommandSpec(C.START_MOTOR_CALIBRATION_ALPHA, M),
    CommandSpec(C.START_MOTOR_CALIBRATION_BETA, M),
    CommandSpec(C.GO_TO_ABSOLUTE_POSITION, M, "ii", "ii"),
    CommandSpec(C.GO_TO_RELATIVE_POSITION, M, "ii", "ii"),
    CommandSpec(C.GET_ACTUAL_POSITION, S | R, "", "ii", 1.0),
    CommandSpec(C.SET_ACTUAL_POSITION, S | M | R, "ii"),
    CommandSpec(C.GET_OFFSETS, S | R, "", "ii"),
    CommandSpec(C.SET_OFFSETS, S | R, "ii"),
    CommandSpec(C.SET_SPEED, S | R, "II"),
    CommandSpec(C.SET_CURRENT, S | M | R, "II"),
    CommandSpec(C.GET_HALL_CALIB_ERROR, S | R, "", "ii"),
    CommandSpec(C.START_COGGING_CALIBRATION, M),
    CommandSpec(C.START_COGGING_CALIBRATION_ALPHA, M),
    CommandSpec(C.START_COGGING_CALIBRATION_BETA, M),
    CommandSpec(C.SAVE_INTERNAL_CALIBRATION, R),
    CommandSpec(C.GET_CURRENT, S | R, "", "ii"),
    CommandSpec(C.GET_ALPHA_HALL_CALIB, S | R, "", "HHHH"),
    CommandSpec(C.GET_BETA_HALL_CALIB, S | R, "", "HHHH"),
    CommandSpec(C.SET_INCREASE_COLLISION_MARGIN, R, "i"),
    CommandSpec(C.SET_HOLDING_CURRENT, S | R, "II"),
    CommandSpec(C.GET_HOLDING_CURRENT, S | R, "", "ii"),
    CommandSpec(C.HALL_ON, S | R),
    CommandSpec(C.HALL_OFF, S | R),
    *(CommandSpec(C(number), R) for number in range(118, 126)),
    CommandSpec(C.SWITCH_LED_ON, S | R),
    CommandSpec(C.SWITCH_LED_OFF, R),
    *(CommandSpec(C(number), S | R) for number in range(128, 132)),
    CommandSpec(C.GET_RAW_TEMPERATURE, S | R, "", "I"),
    CommandSpec(C.GET_NUMBER_TRAJECTORIES, S | R, "", "I"),
    CommandSpec(C.SET_NUMBER_TRAJECTORIES, R, "I"),
    CommandSpec(C.START_FIRMWARE_UPGRADE, S, "II", "", 15.0),
    CommandSpec(C.SEND_FIRMWARE_DATA, S, "", "", 15.0),  # request: 1 to 8 raw bytes
    CommandSpec(C.GET_PARAMETER_TABLE, S | R, "", "II"),
    CommandSpec(C.BEGIN_PARAMETERS, R, "I"),
    *(CommandSpec(c, R, "BI") for c in (C.SET_PARAMETER_ALPHA, C.SET_PARAMETER_BETA)),
    CommandSpec(C.COMMIT_PARAMETERS, NONE, "I"),
    *(CommandSpec(c, S | R, "B", "BI") for c in (C.GET_PARAMETER_ALPHA, C.GET_PARAMETER_BETA)),
    CommandSpec(C.BENCH_TRACE_START, R, "H"),
    *(CommandSpec(c, S | R, "", "HHi") for c in (C.BENCH_TRACE_STATE_ALPHA, C.BENCH_TRACE_STATE_BETA)),
    *(CommandSpec(c, S | R, "H", "ih") for c in (C.BENCH_TRACE_READ_ALPHA, C.BENCH_TRACE_READ_BETA)),
    *(CommandSpec(c, M, "hhHH") for c in (C.BENCH_TORQUE_STEP_ALPHA, C.BENCH_TORQUE_STEP_BETA)),
]

COMMANDS: dict[Command, CommandSpec] = {spec.command: spec for spec in _TABLE}
"""Every command the host can send or receive."""

_LAYOUTS = {spec.reply: struct.Struct("<" + spec.reply) for spec in _TABLE}

MAX_SPEED_RPM = 5000


def counts_of_deg(angle_deg: float) -> int:
    """Wire position of an output angle, rounded to the nearest of 2^30 counts per turn.

    The wire holds 32 bits: angles outside [-720, 720) deg are an InputError.
    """
    counts = round(angle_deg * units.COUNTS_PER_DEG) if abs(angle_deg) < 721.0 else 1 << 31
    if not -(1 << 31) <= counts < 1 << 31:
        raise InputError(f"position {angle_deg} deg does not fit on the wire: -720 to 720 deg")
    return counts


def goto_duration_s(distance_deg: float, speed_rpm: float) -> float:
    """How long a goto takes about: the distance at the motor's speed and 0.25 s for the ramps."""
    return abs(distance_deg) * units.GEAR / (6.0 * speed_rpm) + 0.25


# time on the wire

BITRATE_KBIT = 1000.0
"""What the positioners listen to."""

_FRAME_BITS = 67.0  # of an extended frame without data, with the gap behind it
_STUFFING = 1.04  # assumed: one stuff bit in 25; at random bits one in 32, at worst one in 4


def frame_s(data_bytes: int) -> float:
    """Seconds that an extended frame with so many bytes of data (0 to 8) takes at 1 Mbit/s."""
    return (_FRAME_BITS + 8.0 * data_bytes) * _STUFFING / (BITRATE_KBIT * 1e3)
